"""The single checks of `nlos doctor`. Each says PASS, WARN or FAIL in one line, and what to do where it is not PASS."""

import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from nlos.acquisition.sample import Sample
    from nlos.drivers.bench import Bench, BenchSettings
    from nlos.drivers.tcspc.counter import HistogramAxis

_SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
_FREE_GB = 5.0
_DARK_CPS = (2e3, 50e3)
"""Counts per second in the dark from which something is worth a look, and from which something is wrong."""
_AXES = ((1024, 16.0), (1024, 32.0), (1024, 20.0), (1024, 40.0), (1024, 64.0), (1024, 80.0))


@dataclass(frozen=True)
class Finding:
    """One line of the examination."""

    verdict: str
    what: str
    said: str
    remedy: str = ""


def passed(what: str, said: str) -> Finding:
    return Finding("PASS", what, said)


def software() -> Iterator[Finding]:
    """Interpreter, packages, libusb."""
    found = ".".join(map(str, sys.version_info[:3]))
    yield passed("software", f"Python {found}, {_versions('nlos', 'numpy', 'h5py', 'pyserial', 'pyusb')}")
    if find_spec("torch") is None:
        yield Finding("WARN", "software", "torch is not installed: scanning works, reconstruction does not",
                      "pip install 'nlos[recon]'")  # fmt: skip
    else:
        yield passed("software", _versions("torch"))
    from nlos.drivers.errors import DeviceNotFound
    from nlos.drivers.link.usbtmc import available_instruments

    try:
        available_instruments()
    except DeviceNotFound as error:
        yield Finding("WARN", "software", f"{error.what} Only simulated USB instruments can be opened", error.remedy)


def disk(folder: Path) -> Iterator[Finding]:
    """Room for recordings, and whether what is written comes back."""
    free_gb = shutil.disk_usage(folder).free / 1e9
    if free_gb < _FREE_GB:
        yield Finding("WARN", "disk", f"{free_gb:.1f} GB free in {folder.resolve()}", "Make room, or use -o elsewhere.")
    else:
        yield passed("disk", f"{free_gb:.0f} GB free in {folder.resolve()}")
    try:
        with tempfile.NamedTemporaryFile(dir=folder) as file:
            data = os.urandom(1 << 20)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
            file.seek(0)
            came_back = file.read() == data
    except OSError as error:
        yield Finding("FAIL", "disk", f"nothing can be written here ({error})", "Choose another folder.")
        return
    if not came_back:
        yield Finding("FAIL", "disk", "what was written did not come back", "Do not record here; check the disk.")


def absent(settings: "BenchSettings") -> Iterator[Finding]:
    """What a real bench's file names and is not there, or is another one."""
    from nlos.cli.devices import expectations, usb_instruments

    if settings.simulated:
        return
    for item in expectations(settings, *usb_instruments()):
        if not item.found:
            yield Finding("FAIL", item.model, f"{item.role} at {item.address}: {item.what}", item.remedy)


def levels(settings: "BenchSettings") -> Iterator[Finding]:
    """Cables that carry more, or less, than the input at their end takes. Asked before anything is opened."""
    from nlos.drivers.cable_levels import level_conflicts

    if settings.simulated:
        return
    for conflict in level_conflicts(settings.mirror, settings.counter):
        yield Finding("WARN", "levels", conflict.what, conflict.remedy)


def links(bench: "Bench") -> Iterator[Finding]:
    """Round trips, in the bench's own time."""
    start_s = bench.clock.now()
    for _ in range(5):
        bench.counter.kick()
    counter_ms = (bench.clock.now() - start_s) / 5 * 1e3
    start_s = bench.clock.now()
    bench.mirror.park()
    yield passed("links", f"counter answers in {counter_ms:.2f} ms, mirror parks in "
                 f"{(bench.clock.now() - start_s) * 1e3:.1f} ms")  # fmt: skip


def mirror(bench: "Bench") -> Iterator[Finding]:
    """Who it is, how far it reaches, and small moves around the centre. The shutter is closed meanwhile."""
    from nlos.drivers.errors import LimitError
    from nlos.drivers.galvo.mirror import MirrorAngles

    who = bench.mirror.identity
    reach_deg = 0.0
    for degrees in range(1, 90):
        angle = degrees * 0.017453292519943295
        try:
            for x, y in ((angle, 0.0), (-angle, 0.0), (0.0, angle), (0.0, -angle)):
                bench.mirror.check(MirrorAngles(x, y))
        except LimitError:
            break
        reach_deg = degrees
    start_s = bench.clock.now()
    steps = [MirrorAngles(0.01 * x, 0.01 * y) for x in (-1, 1) for y in (-1, 1)]
    for angles in steps:
        bench.mirror.move_to(angles)
    bench.mirror.park()
    each_ms = (bench.clock.now() - start_s) / 5 * 1e3
    wall_m = 2 * bench.settings.geometry.wall_distance_m * _tan_deg(reach_deg)
    yield passed("mirror", f"{who.product} {who.firmware} {who.serial}".rstrip())
    yield passed(
        "mirror", f"reaches +-{reach_deg:.0f} deg ({wall_m:.1f} m of wall); a small move takes {each_ms:.1f} ms"
    )


def counter(bench: "Bench") -> Iterator[Finding]:
    """Who it is, and whether the laser's sync arrives at the rate that the bench file states."""
    who, rates = bench.counter.identity, bench.counter.rates()
    yield passed("counter", f"{who.product} {who.serial}, firmware {who.firmware}")
    stated_hz = bench.settings.laser.repetition_hz
    if rates.sync_hz <= 0:
        yield Finding("FAIL", "counter", "no sync signal", "Check laser, sync cable and the sync input's level.")
    elif abs(rates.sync_hz / stated_hz - 1) > 0.01:
        yield Finding("WARN", "counter", f"sync at {rates.sync_hz / 1e6:.4g} MHz, the bench file says "
                      f"{stated_hz / 1e6:.4g} MHz", "Correct laser.repetition_hz, or the sync level.")  # fmt: skip
    else:
        yield passed("counter", f"sync at {rates.sync_hz / 1e6:.4g} MHz")


def shutter(bench: "Bench") -> Iterator[Finding]:
    """That it is closed, and who else would close it."""
    state = bench.shutter.state()
    if bench.settings.shutter.model == "none":
        yield Finding("WARN", "shutter", "none: nothing here can shut off the light", "Wire one.")
    elif state.commanded_open or state.feedback_open:
        yield Finding("FAIL", "shutter", "open, and it was told to close", "Switch the laser off by hand.")
    elif state.interlock_closed is False:
        yield Finding("FAIL", "shutter", "closed; the interlock loop is open", "Close the loop.")
    elif state.feedback_open is None:
        yield Finding("WARN", "shutter", "commanded closed; nothing reads back whether it is", "Wire its contact.")
    else:
        yield passed("shutter", "closed and read back, interlock closed")
    if not bench.shutter.has_watchdog:
        yield Finding("WARN", "shutter", "no watchdog: if this computer hangs, the shutter stays as it is",
                      "Set safety.watchdog_s with a counter that has one.")  # fmt: skip


def dark_counts(bench: "Bench") -> Iterator[Finding]:
    """The detector with the shutter closed."""
    dark_cps = bench.counter.rates().detector_hz
    said = f"{dark_cps:.0f} counts/s with the shutter closed"
    if dark_cps > _DARK_CPS[1]:
        yield Finding("FAIL", "dark counts", said, "Light comes in or the detector is hot: find out before scanning.")
    elif dark_cps > _DARK_CPS[0]:
        yield Finding("WARN", "dark counts", said, "Dim the room, or cool the detector.")
    else:
        yield passed("dark counts", said)


def small_scan(bench: "Bench", folder: Path) -> Iterator[Finding]:
    """4 x 4 points of 8 ms, recorded, read back, and reconstructed."""
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.planning.preflight import aim_of
    from nlos.acquisition.planning.scan_settings import ScanSettings
    from nlos.acquisition.recording.provenance import Header
    from nlos.acquisition.recording.recording import Recording, Status
    from nlos.acquisition.recording.writer import RecordingWriter
    from nlos.acquisition.scanning.engine import record, scan

    axis = _axis(bench)
    text = {
        "wall": {"width_m": 0.4, "height_m": 0.4, "rows": 4, "cols": 4},
        "pattern": "serpentine",
        "dwell_ms": 8,
        "histogram": {"bins": axis.bins, "bin_width_ps": axis.bin_width_s * 1e12, "offset_ns": axis.offset_s * 1e9},
    }
    plan: ScanPlan = ScanSettings.model_validate(text).plan()
    run = folder / "doctor.h5"
    samples: list[Sample] = []
    with RecordingWriter.create(run, plan, Header()) as writer:
        record(scan(plan, bench), writer, samples.append)
        writer.finish(Status.COMPLETE)
    with Recording.open(run) as recording:
        same = all(
            (a.histogram.counts == b.histogram.counts).all() for a, b in zip(samples, recording.samples(), strict=True)
        )
    counts = sum(sample.histogram.total_count for sample in samples)
    if not same or len(samples) != len(plan):
        yield Finding("FAIL", "scan", "what was recorded is not what was measured", "Check memory and disk.")
        return
    yield passed("scan", f"{len(samples)} points, {counts} photons, recorded and read back")
    yield _direct_light(samples, aim_of(bench).wall_distance_m)
    if find_spec("torch") is not None:
        yield from _reconstruction(run, folder)


def _direct_light(samples: "list[Sample]", wall_distance_m: float) -> Finding:
    """Whether the first arrival is about where the wall is."""
    late_ns = []
    for sample in samples:
        h, p = sample.histogram, sample.point
        # The first peak, not the highest: a hidden surface may return more light than the wall's spot.
        first = int((h.counts >= max(0.3 * h.counts.max(), 1)).argmax())
        arrival_s = h.offset_s + (first + 0.5) * h.bin_width_s
        range_m = (wall_distance_m**2 + p.x_m**2 + p.y_m**2) ** 0.5
        late_ns.append((arrival_s - 2 * range_m / _SPEED_OF_LIGHT_M_PER_S) * 1e9)
    late_ns.sort()
    middle, spread = late_ns[len(late_ns) // 2], late_ns[-2] - late_ns[1]
    said = f"direct light {middle:+.2f} ns from where the wall is, the same within {spread:.2f} ns at all points"
    if spread > 0.5:
        return Finding("WARN", "scan", said, "Check aim and wall_distance_m; run `nlos calibrate`.")
    return passed("scan", said)


def _reconstruction(run: Path, folder: Path) -> Iterator[Finding]:
    from nlos.calibration.errors import InvalidData
    from nlos.chain import reconstruct_file

    try:
        done = reconstruct_file(run, "lct", {}, folder / "doctor")
    except InvalidData as error:
        yield Finding("WARN", "reconstruction", str(error), "The wall may not be in the histograms' time window.")
        return
    yield passed("reconstruction", f"lct in {done.seconds:.2f} s, albedo up to {done.albedo.max():.3g}")


def _axis(bench: "Bench") -> "HistogramAxis":
    """A time axis that this counter can take, from just before the wall's direct light."""
    from nlos.drivers.errors import LimitError
    from nlos.drivers.tcspc.counter import HistogramAxis

    arrival_ns = 2 * bench.settings.geometry.wall_distance_m / _SPEED_OF_LIGHT_M_PER_S * 1e9
    refused: LimitError | None = None
    for bins, width_ps in _AXES:
        offset_ns = max(0.0, (arrival_ns - 3.0) // 8 * 8)
        axis = HistogramAxis(bins, width_ps * 1e-12, offset_ns * 1e-9)
        try:
            bench.counter.check(axis, 8e-3)
        except LimitError as error:
            refused = error
            continue
        return axis
    assert refused is not None
    raise refused


def _versions(*packages: str) -> str:
    found = []
    for package in packages:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            found.append(f"{package} (not installed)")
    return ", ".join(found)


def _tan_deg(degrees: float) -> float:
    from math import radians, tan

    return tan(radians(min(degrees, 80.0)))


BENCH_CHECKS: tuple[Callable[["Bench"], Iterator[Finding]], ...] = (shutter, links, counter, dark_counts, mirror)
"""In this order: what is closed and who answers before anything moves."""
