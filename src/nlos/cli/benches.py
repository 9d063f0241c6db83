"""Opens the bench that a command names, with the wire log, and writes what happens on it into a recording."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.preflight import aim_of
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.bench_constants import aiming_constants
from nlos.cli.agreeing import agrees
from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal
from nlos.configs.load import Loaded, load
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.simulated.recorded import RecordedScan
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.trip_latch import TripLatch

if TYPE_CHECKING:
    from nlos.calibration.constants import BenchConstants

DEFAULT_BENCH = "simulated"


def load_bench(word: str | None) -> "Loaded[BenchSettings]":
    """The bench file that `word` means; the simulated bench where none is named. Raises `ConfigError`."""
    return load("bench", DEFAULT_BENCH if word is None else word, BenchSettings)


def twin(loaded: "Loaded[BenchSettings]") -> "Loaded[BenchSettings]":
    """A simulated bench with the limits, geometry and settling of this one; a simulated bench is its own twin."""
    bench = loaded.settings
    if bench.simulated:
        return loaded
    parts = {
        "mirror": bench.mirror.on_simulated_cable(),
        "counter": bench.counter.on_simulated_cable(),
        "simulation": SimulationSettings(),
    }
    return replace(loaded, settings=bench.model_copy(update=parts))


def measured_constants(given: Path | None, bench: "Bench", of: "BenchSettings") -> "BenchConstants | None":
    """The constants to aim bench `of` by, said with what they override; None where there are none.

    `bench`: it or its twin, whose serial numbers tell nothing. Raises `ForeignConstants`, and
    `StaleConstants` where the bench has changed since they were measured.
    """
    roles = {"mirror": bench.mirror.identity, "counter": bench.counter.identity} if of.simulated else {}
    names = {role: who.name for role, who in roles.items()}
    known = aiming_constants(given, of.model_dump_json(), names)
    if known is None:
        return None
    terminal.log(known.said(aim_of(bench)))
    if known.warning:
        terminal.log(f"warning: {known.warning}")
    return known.constants


@contextmanager
def opened(
    loaded: "Loaded[BenchSettings]", scene: Path | None = None, quiet: bool = False, logged: bool = True
) -> Iterator["Bench"]:
    """The open bench; `scene` is a recorded scan that replaces a simulated bench's light. Without `logged` it is left
    out of the wire log: the twin of a real bench, whose bytes go to no device."""
    if scene is not None and not loaded.settings.simulated:
        raise UsageError(
            f"--scene {scene}: {loaded.path} is a real bench, whose light is its own. Use --scene with a simulated "
            "bench, or leave it out."
        )
    latch = TripLatch.of_bench(loaded.settings)
    with (
        wire_logged() if logged else nullcontext() as log,
        open_bench(loaded.settings, scene=_scene(scene), wire_log=log, latch=latch, agree=agrees) as bench,
    ):
        for warning in bench.warnings:
            terminal.log(f"warning: {warning}", 1 if quiet else 0)
        yield bench


@contextmanager
def wire_logged() -> Iterator[Callable[[str, str, bytes], None] | None]:
    """Every byte to and from the devices, one line each: time, device, direction, bytes as Python writes them. A disk
    that fills up ends the log and nothing else."""
    if terminal.wire_log is None:
        yield None
        return
    again = terminal.wire_log_begun
    try:
        file = terminal.wire_log.open("a" if again else "x", encoding="utf-8")
    except FileExistsError as error:
        raise FileExistsError(f"{terminal.wire_log}: exists. Choose another name for --wire-log.") from error
    terminal.wire_log_begun, whole_before = True, terminal.wire_log_whole

    def log(device: str, direction: str, data: bytes) -> None:
        now = datetime.now(UTC).isoformat(timespec="microseconds")
        try:
            file.write(f"{now} {device} {direction} {data!r}\n")
        except OSError:
            terminal.wire_log_whole = False
            raise

    try:
        yield log
    finally:
        try:
            file.close()
        except OSError:
            terminal.wire_log_whole = False
        whole = terminal.wire_log_whole
        what = "every byte to and from the devices" if whole else "not every byte: it could not be written to its end"
        if not again or whole != whole_before:  # else it was said
            terminal.log(f"{'' if whole else 'warning: '}{terminal.wire_log}: {what}")


def _scene(path: Path | None) -> "RecordedScan | None":
    if path is None:
        return None

    with open_checked(path) as recording:
        rows = [(sample.point, sample.histogram) for sample in recording.samples()]
        taken_s = np.array([sample.taken_s for sample in recording.samples()])
        recording.left_aside()
        plan, axis = recording.plan, recording.plan.axis
        holes = [plan[number] for number in recording.missing()]
    if not rows:
        raise InvalidData(f"{path}: holds no intact sample, so no light to simulate")
    return RecordedScan(
        np.stack([histogram.counts for _, histogram in rows]),
        np.array([point.x_m for point, _ in rows]),
        np.array([point.y_m for point, _ in rows]),
        np.array([histogram.live_time_s for _, histogram in rows]),
        axis.bin_width_s,
        axis.offset_s,
        np.array([histogram.total_count for _, histogram in rows]),
        np.array([(point.x_m, point.y_m) for point in holes]).reshape(-1, 2),
        np.array([point.number for point, _ in rows]),
        taken_s - taken_s.min(),
    )
