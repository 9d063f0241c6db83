"""A signal that a Python program handles itself, and goes on: its scan does not go on in the dark."""

import asyncio
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import nlos
from nlos.acquisition.recording.recording import Recording, Status
from nlos.drivers.bench import Bench
from nlos.drivers.errors import ShutterHeld

Counts = npt.NDArray[np.uint32]
SCAN = "five_by_five"
CLOCKED, STEPPED = "simulated", "zero_latency"


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture(params=["SIGINT", "SIGTERM", "SIGALRM"])
def handled(request: pytest.FixtureRequest) -> Iterator[int]:
    """A signal whose handler lets the program go on, as that of an event loop does."""
    number: int = getattr(signal, request.param)
    before = signal.signal(number, lambda number, frame: None)
    yield number
    signal.signal(number, before)


@pytest.fixture(scope="module", params=[STEPPED, CLOCKED])
def undisturbed(request: pytest.FixtureRequest) -> tuple[str, list[Counts]]:
    """The bench, and what it counts point by point."""
    with nlos.open_bench(request.param) as bench:
        return request.param, [sample.histogram.counts for sample in nlos.scan(SCAN, bench)]


@pytest.mark.parametrize("within_a_point", [False, True])
def test_a_scan_ends_and_says_so_where_a_signal_shut_its_light(
    handled: int, undisturbed: tuple[str, list[Counts]], within_a_point: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, whole = undisturbed
    said = f"{signal.Signals(handled).name} shut the light off.*resume=True"
    with nlos.open_bench(name) as bench:
        samples = nlos.scan(SCAN, bench, output="run.h5")
        taken = [next(samples).histogram.counts for _ in range(6)]
        if within_a_point:
            monkeypatch.setattr(bench.counter, "read", _after_signal(handled, bench.counter.read))
        else:
            signal.raise_signal(handled)
        with pytest.raises(ShutterHeld, match=said):
            taken.extend(sample.histogram.counts for sample in samples)
    assert 6 <= len(taken) < len(whole)
    assert all((ours == theirs).all() for ours, theirs in zip(taken, whole, strict=False))  # none in the dark
    with Recording.open(Path("run.h5")) as recording:
        assert recording.status is Status.INTERRUPTED
        assert len(recording.intact_records()) == len(taken)


def _after_signal(number: int, read: Callable[[int, int], object]) -> Callable[[int, int], object]:
    """The first reading finds that the signal came while its point was measured."""

    def after_signal(first: int, count: int) -> object:
        if waiting:
            signal.raise_signal(waiting.pop())
        return read(first, count)

    waiting = [number]
    return after_signal


def test_a_scan_in_another_thread_ends_with_the_light_that_ctrl_c_shut() -> None:
    taken, shut = threading.Event(), threading.Event()
    ended: list[Exception] = []

    def work(bench: Bench) -> None:
        try:
            for _ in nlos.scan(SCAN, bench):
                taken.set()
                shut.wait(60.0)
        except ShutterHeld as error:
            ended.append(error)

    with nlos.open_bench(STEPPED) as bench:
        worker = threading.Thread(target=work, args=(bench,))
        worker.start()
        taken.wait(60.0)
        with pytest.raises(KeyboardInterrupt):  # which an event loop may only print
            signal.raise_signal(signal.SIGINT)
        shut.set()
        worker.join(60.0)
        assert ended
        assert not bench.shutter.may_be_open


def test_ctrl_c_within_asyncio_ends_the_scan() -> None:
    async def main() -> None:
        with nlos.open_bench(CLOCKED) as bench:
            for _ in nlos.scan(SCAN, bench):
                signal.raise_signal(signal.SIGINT)

    with pytest.raises(ShutterHeld, match="SIGINT shut the light off"):
        asyncio.run(main())


def test_a_scan_after_one_that_a_signal_ended_has_its_light(handled: int) -> None:
    with nlos.open_bench(CLOCKED) as bench:
        samples = nlos.scan(SCAN, bench)
        first = next(samples)
        signal.raise_signal(handled)
        with pytest.raises(ShutterHeld):
            list(samples)
        again = next(whole := nlos.scan(SCAN, bench))
        whole.close()
        assert (again.histogram.counts == first.histogram.counts).all()


def test_a_handler_that_takes_a_signal_from_an_open_bench_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    """As Bluesky's engine takes Ctrl-C: the light stays on, whatever is pressed."""
    with nlos.open_bench(STEPPED) as outer, nlos.open_bench("optotune") as bench:
        outer.shutter.open()  # the other bench hands signals on
        bench.shutter.open()
        assert not caplog.messages
        before = signal.signal(signal.SIGINT, lambda number, frame: None)
        try:
            for _ in range(2):
                bench.shutter.close()
                bench.shutter.open()
        finally:
            signal.signal(signal.SIGINT, before)
        (said,) = caplog.messages
        assert said.startswith("SIGINT no longer shuts the light")
