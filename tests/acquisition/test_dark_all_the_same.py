"""What else fails on the way out keeps no light on: the wire log's disk, who is told of events, another thread."""

import errno
import signal
import subprocess
import sys
from contextlib import nullcontext, suppress
from pathlib import Path

import pytest

from nlos.acquisition.scanning.alarms import AlarmRaised
from nlos.acquisition.scanning.dark import shut
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceLost, SafetyTrip
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.partial_bench import open_partial_bench
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.witnessed_bench import bench_file, witnessed

BENCHES = ("S1, TTL shutter", "S2", "S2, TTL shutter", "S1")


def light(folder: Path) -> list[str]:
    return [line for line in witnessed(folder) if line.startswith("shutter")]


@pytest.mark.parametrize("name", BENCHES)
def test_a_wire_log_whose_disk_is_full_holds_up_no_command(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    full = False

    def log(device: str, direction: str, data: bytes) -> None:
        if full:
            raise OSError(errno.ENOSPC, "No space left on device")

    settings = load("bench", str(bench_file(tmp_path, name)), BenchSettings).settings
    with open_bench(settings, wire_log=log) as bench:
        bench.shutter.open()
        full = True
    assert light(tmp_path)[-2:] == ["shutter open", "shutter closed"]
    assert caplog.text.count("the wire log of") == 2  # each device's, once
    assert "ends here" in caplog.text


@pytest.mark.parametrize("fault", ["A2", "G4", "G9"])
def test_light_is_shut_again_and_again_although_whoever_is_told_fails(tmp_path: Path, fault: str) -> None:
    """The first command to close is lost; the events go to a pipe that nobody reads any more."""

    def tell(kind: str, text: str) -> None:
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")

    settings = load("bench", str(bench_file(tmp_path, "S1, TTL shutter")), BenchSettings).settings
    with pytest.raises(BrokenPipeError), open_bench(settings) as bench:  # noqa: PT012
        bench.shutter.open()
        with suppress(BrokenPipeError):
            bench.on_event = tell
        assert bench.simulated is not None
        bench.simulated.faults.add(Fault(name=fault, after_s=bench.clock.now(), times=2))
    assert light(tmp_path)[-2:] == ["shutter open", "shutter closed"]


@pytest.mark.parametrize(("trip", "stands"), [(AlarmRaised, False), (SafetyTrip, True)])
def test_an_alarm_shuts_the_light_and_a_trip_keeps_it_shut(
    tmp_path: Path, trip: type[SafetyTrip], stands: bool
) -> None:
    settings = load("bench", str(bench_file(tmp_path, "S1")), BenchSettings).settings
    told: list[tuple[str, str]] = []
    with open_bench(settings) as bench:
        bench.on_event = lambda kind, text: told.append((kind, text))
        bench.shutter.open()
        shut(bench, trip("count rate", "too bright.", "Look at the beam."))
        assert light(tmp_path)[-2:] == ["shutter open", "shutter closed"]
        assert [text for kind, text in told if kind == "trip" and "too bright" in text]
        with pytest.raises(SafetyTrip, match="after a trip") if stands else nullcontext():
            bench.shutter.open()
        assert (light(tmp_path)[-1] == "shutter closed") == stands


@pytest.mark.parametrize("name", ["S1, TTL shutter", "S2"])
def test_no_thread_opens_the_shutter_of_a_bench_that_the_end_of_the_program_closes(tmp_path: Path, name: str) -> None:
    child = Path(__file__).with_name("threaded_child.py")
    for seconds in ("0.0", "0.013", "0.03"):
        (tmp_path / "witness.txt").unlink(missing_ok=True)
        command = [sys.executable, str(child), str(bench_file(tmp_path, name)), seconds]
        assert subprocess.run(command, cwd=Path(__file__).parents[2], timeout=240).returncode == 0
        seen = light(tmp_path)
        assert "shutter open" in seen
        assert seen[-1] == "shutter closed"


def test_a_signal_while_a_bench_is_opened_leaves_no_light_on_that_another_program_left(tmp_path: Path) -> None:
    """A program that was killed left a TTL shutter open; the one that would have closed it is told to end before."""
    path = bench_file(tmp_path, "S1, TTL shutter")
    left = "simulation:\n  faults: [{name: A8, parameters: {state: open}}]\n"
    path.write_text(path.read_text().replace("simulation:\n", left))
    settings = load("bench", str(path), BenchSettings).settings
    told = 0

    def end_once(device: str, direction: str, data: bytes) -> None:
        nonlocal told
        if light(tmp_path)[-1:] == ["shutter open"]:
            told += 1
            if told == when:
                signal.raise_signal(signal.SIGTERM)

    for when in (1, 2, 4, 6, 8):
        told = 0
        (tmp_path / "witness.txt").unlink(missing_ok=True)
        with pytest.raises(SystemExit), open_bench(settings, wire_log=end_once):
            pytest.fail("the signal was lost")
        assert light(tmp_path)[-2:] == ["shutter open", "shutter closed"], when


@pytest.mark.parametrize("name", ["S1, TTL shutter", "S2, TTL shutter"])
@pytest.mark.parametrize(
    ("back_after_s", "last"), [(0.1, "shutter closed"), (2.5, "shutter closed"), (60.0, "shutter open")]
)
def test_a_shutters_own_cable_that_only_slipped_carries_the_command_once_it_is_back(
    tmp_path: Path, name: str, back_after_s: float, last: str, caplog: pytest.LogCaptureFixture
) -> None:
    """The controller stays on meanwhile, and its output where it was. 60 s are too long: that is said aloud."""
    settings = load("bench", str(bench_file(tmp_path, name)), BenchSettings).settings
    with pytest.raises(DeviceLost), open_bench(settings) as bench:  # noqa: PT012
        bench.shutter.open()
        assert bench.simulated is not None
        bench.simulated.faults.add(Fault(name="G8", parameters={"replug_after_s": back_after_s}))
        bench.mirror.move_to(MirrorAngles(0.01, 0.01))
    assert light(tmp_path)[-1] == last
    assert "NOT CONFIRMED CLOSED" in caplog.text
    assert ("answers again" in caplog.text) == (last == "shutter closed")


@pytest.mark.parametrize("name", ["S1, TTL shutter", "S2, TTL shutter"])
def test_so_does_that_of_a_bench_in_somebodys_hands(
    tmp_path: Path, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    settings = load("bench", str(bench_file(tmp_path, name)), BenchSettings).settings
    with pytest.raises(DeviceLost), open_partial_bench(settings, {"mirror"}) as bench:  # noqa: PT012
        assert bench.shutter is not None
        assert bench.mirror is not None
        bench.shutter.open()
        assert bench.simulated is not None
        bench.simulated.faults.add(Fault(name="G8", parameters={"replug_after_s": 0.1}))
        bench.mirror.move_to(MirrorAngles(0.01, 0.01))
    assert light(tmp_path)[-1] == "shutter closed"
    assert "answers again" in caplog.text
