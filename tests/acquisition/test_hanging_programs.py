"""A program that hangs with the light on - in a disk, a pipe, a vendor's library - where no instrument watches it: the
table itself says that the light goes off while it still hangs, and nothing taken before is lost or wrong."""

import functools
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

import nlos
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.scanning.engine import scan
from nlos.by_hand.light import LightOnRequest
from nlos.by_hand.stops import Stops
from nlos.configs.load import load
from nlos.drivers import closing
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.clock import Clock, VirtualClock
from nlos.drivers.errors import DeviceError, SafetyTrip
from nlos.drivers.partial_bench import open_partial_bench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.simulated.serial.port import plugged
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from tests.acquisition.fault_cases import plan, settings
from tests.acquisition.witnessed_bench import bench_file, witnessed

SCAN = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 12, cols: 12}
pattern: serpentine
dwell_ms: 2
histogram: {bins: 64, bin_width_ps: %s}
"""
AXIS = {"S3": "320, offset_ns: 9.6"}
TTL = ("S1, TTL shutter", "S2, TTL shutter", "S3")
HANGS_S = 30.0
"""On the bench's clock."""
STOPPED_S, PLACES = 5.0, 3
PATIENCE_S = 60.0
"""Of this machine: by then the light is off, or it stays on."""


def light(folder: Path) -> list[str]:
    return [line for line in witnessed(folder) if line.startswith("shutter")]


def hang(folder: Path, clock: Clock) -> None:
    """Until the table says that it is dark."""
    clock.sleep(HANGS_S)
    until_s = time.monotonic() + PATIENCE_S
    while light(folder)[-1:] != ["shutter closed"]:
        assert time.monotonic() < until_s, "the light stays on"
        with suppress(KeyError):
            plugged("triggerscope").deliver()  # a cable waits for nobody
        time.sleep(0.01)


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> None:
    """The thread that watches real benches watches this one: who hangs moves its time on."""
    monkeypatch.setattr(VirtualClock, "passes_by_itself", True)


def files(folder: Path, name: str) -> Path:
    (folder / "scan.yaml").write_text(SCAN % AXIS.get(name, "256, offset_ns: 10"))
    return bench_file(folder, name)


def counts(samples: Iterator[Any]) -> dict[int, bytes]:
    return {sample.point.number: sample.histogram.counts.tobytes() for sample in samples}


@functools.cache
def undisturbed(name: str, folder: Path) -> dict[int, bytes]:
    with nlos.open_bench(bench_file(folder, name)) as bench:
        return counts(nlos.scan(folder / "scan.yaml", bench))


@pytest.mark.sampled(3)
@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize("name", TTL)
def test_light_goes_off_while_a_network_share_stalls(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    path, run, taken = files(tmp_path, name), tmp_path / "run.h5", 0
    late = pytest.raises(SafetyTrip, match="nothing was heard from this program for 2 s")
    with late, nlos.open_bench(path) as bench:
        for _ in nlos.scan(tmp_path / "scan.yaml", bench, output=run):
            taken += 1
            if taken == 30:
                hang(tmp_path, bench.clock)
    assert light(tmp_path)[-1] == "shutter closed"
    with Recording.open(run) as recording:
        kept = counts(recording.samples())
    (tmp_path / "witness.txt").unlink()
    with pytest.raises(SafetyTrip, match="--clear-trip"), nlos.open_bench(path) as bench:
        list(nlos.scan(tmp_path / "scan.yaml", bench, output=run, resume=True))
    assert "shutter open" not in light(tmp_path)
    with nlos.open_bench(path) as bench:
        bench.shutter.clear_trip("the test")
        list(nlos.scan(tmp_path / "scan.yaml", bench, output=run, resume=True))
    with Recording.open(run) as recording:
        whole = counts(recording.samples())
    assert len(kept) >= 30 - 1
    assert kept.items() <= whole.items()
    monkeypatch.undo()
    assert whole == undisturbed(name, tmp_path)


@pytest.mark.skipif(sys.platform == "win32", reason="no program is sent these signals there")
@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_hang_that_a_person_ended_is_in_the_recording_and_keeps_no_later_scan_from_light(
    tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As the page on laser safety says: whoever ended the program knows that it hung, and asks for light anew."""
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    path, run = files(tmp_path, "S3"), tmp_path / "run.h5"
    with pytest.raises((KeyboardInterrupt, SystemExit)), nlos.open_bench(path) as bench:  # noqa: PT012
        for taken, _ in enumerate(nlos.scan(tmp_path / "scan.yaml", bench, output=run), start=1):
            if taken == 30:
                hang(tmp_path, bench.clock)
                signal.raise_signal(number)
    assert light(tmp_path) == ["shutter open", "shutter closed"]
    with Recording.open(run) as recording:
        assert "closed: nothing was heard from this program for 2 s with the light on" in [
            event.text for event in recording.events() if event.kind == "shutter"
        ]
    with nlos.open_bench(path) as bench:
        list(nlos.scan(tmp_path / "scan.yaml", bench, output=run, resume=True))
    assert light(tmp_path)[-1] == "shutter closed"


@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize("call", ["ReadFiFo", "GetFlags", "StartMeas"])
def test_light_goes_off_while_a_call_of_a_vendors_library_does_not_return(
    tmp_path: Path, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    answer = PicoquantLibrary._called

    def called(self: PicoquantLibrary, name: str, method: Callable[..., int], arguments: tuple[Any, ...]) -> int:
        if name == call and light(tmp_path)[-1:] == ["shutter open"]:
            hang(tmp_path, self._bench.clock)
        return answer(self, name, method, arguments)

    monkeypatch.setattr(PicoquantLibrary, "_called", called)
    chosen = load("bench", str(files(tmp_path, "S3")), BenchSettings).settings
    with pytest.raises(DeviceError), open_bench(chosen) as bench:  # by its late answer, or that nothing was heard
        list(scan(plan("multiharp"), bench))
    assert light(tmp_path)[-1] == "shutter closed"


@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize("name", TTL)
@pytest.mark.parametrize("direction", ["<", ">"])
def test_light_goes_off_while_the_disk_of_a_wire_log_hangs_within_an_exchange(
    tmp_path: Path, name: str, direction: str
) -> None:
    """The line to the mirror is busy as far as anybody can tell, and the log takes nothing."""
    lines, dark, thread = 0, False, threading.get_ident()

    def log(device: str, way: str, data: bytes) -> None:
        nonlocal lines, dark
        assert threading.get_ident() == thread, "it was asked for what the hanging disk will not take"
        if way == direction and light(tmp_path)[-1:] == ["shutter open"]:
            lines += 1
            if lines == 7:
                hang(tmp_path, bench.clock)
                dark = True

    chosen = load("bench", str(files(tmp_path, name)), BenchSettings).settings
    with pytest.raises(DeviceError), open_bench(chosen, wire_log=log) as bench:
        list(scan(plan("multiharp" if name == "S3" else "stepped"), bench))
    assert dark
    assert light(tmp_path)[-1] == "shutter closed"


@pytest.mark.usefixtures("watched")
@pytest.mark.parametrize("name", TTL)
def test_light_is_shut_again_and_again_although_whoever_is_told_hangs_as_well(tmp_path: Path, name: str) -> None:
    """The port does not take the first commands to close, and events go to the disk that hangs."""

    def tell(kind: str, text: str) -> None:
        if threading.get_ident() != thread:
            told.append(text)
            hang(tmp_path, VirtualClock())

    told: list[str] = []
    thread = threading.get_ident()
    chosen = load("bench", str(files(tmp_path, name)), BenchSettings).settings
    with open_bench(chosen) as bench:
        bench.on_event = tell
        bench.shutter.open()
        assert bench.simulated is not None
        bench.simulated.faults.add(Fault(name="G9", after_s=bench.clock.now(), times=2))
        hang(tmp_path, bench.clock)
    assert "NOT CONFIRMED CLOSED" in told[0]
    assert light(tmp_path)[-1] == "shutter closed"


@pytest.mark.usefixtures("watched")
def test_light_goes_off_that_a_counter_without_a_watchdog_drives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of another package may be."""
    monkeypatch.setattr(Tcspc488, "has_watchdog", False)
    chosen = load("bench", str(files(tmp_path, "S2")), BenchSettings).settings
    with open_bench(chosen) as bench:
        bench.shutter.open()
        hang(tmp_path, bench.clock)
        with pytest.raises(SafetyTrip, match="nothing was heard"):
            bench.shutter.heard()


@pytest.mark.usefixtures("watched")
def test_light_goes_off_while_it_hangs_to_say_that_the_light_is_not_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is logged goes to the disk that hangs; the port does not take the first commands to close."""
    monkeypatch.setattr(closing._log, "critical", lambda *what: hang(tmp_path, bench.clock))
    chosen = load("bench", str(files(tmp_path, "S1, TTL shutter")), BenchSettings).settings
    with pytest.raises(DeviceError), open_bench(chosen) as bench:  # noqa: PT012
        bench.shutter.open()
        assert bench.simulated is not None
        bench.simulated.faults.add(Fault(name="G9", after_s=bench.clock.now(), times=2))
    assert light(tmp_path)[-1] == "shutter closed"


def test_light_by_hand_goes_off_while_its_program_hangs(tmp_path: Path) -> None:
    """On the computer's own time; no timer stands behind it in another thread than the main one."""
    chosen = load("bench", str(files(tmp_path, "S1, TTL shutter")), BenchSettings).settings
    with open_partial_bench(chosen, {"mirror"}) as bench:
        by_hand = LightOnRequest(bench.shutter, bench.clock, chosen.alignment, Stops())
        by_hand.ask(5.0)
        assert light(tmp_path)[-1] == "shutter open"
        hang(tmp_path, VirtualClock())
        with pytest.raises(SafetyTrip, match="nothing was heard"):
            by_hand.tick()
        by_hand.end("it hung")
        by_hand.ask(5.0)  # a person asks again
        assert light(tmp_path)[-1] == "shutter open"
    assert light(tmp_path)[-1] == "shutter closed"


@pytest.mark.parametrize("name", ["stepped", "clocked", "optotune", "multiharp"])
def test_a_program_that_was_stopped_for_a_while_keeps_nothing_that_is_wrong(name: str) -> None:
    """Stopped and continued (SIGSTOP, SIGCONT), or asleep with its computer, between any two messages, while the
    instruments go on: the scan is complete, or ends dark, and what it has is right."""
    whole, messages = stopped(name, 0)
    for at in range(3, messages + 1, messages // PLACES):
        taken, _ = stopped(name, at)
        assert taken == {number: whole[number] for number in taken}, at


def stopped(name: str, at: int) -> tuple[dict[int, bytes], int]:
    messages, taken = 0, {}

    def log(device: str, direction: str, data: bytes) -> None:
        nonlocal messages
        if scanning:
            messages += 1
            if messages == at:
                bench.clock.sleep(STOPPED_S)

    scanning = False
    with suppress(DeviceError), open_bench(settings(name), wire_log=log) as bench:
        scanning = True
        try:
            for sample in scan(plan(name), bench):
                taken[sample.point.number] = sample.histogram.counts.tobytes()
        finally:
            scanning = False
            bench.shutter.close()
            assert bench.simulated is not None
            assert not bench.simulated.shutter_open
    return taken, messages
