"""A scan from Python is as safe and as complete as `nlos scan`: the same checks, the same recording."""

from pathlib import Path
from typing import Any

import pytest

import nlos
from nlos.__main__ import run
from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.recording import Recording, Status
from nlos.drivers.errors import BenchClosed, DeviceBusy, SafetyTrip
from nlos.drivers.state_folder import STATE
from nlos.drivers.trip_latch import TripLatch

SCAN, BENCH = "five_by_five", "zero_latency"


@pytest.fixture(autouse=True)
def _own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(STATE, str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)


def test_both_doors_write_the_same_recording(tmp_path: Path) -> None:
    assert run(["scan", SCAN, "--bench", BENCH, "-o", "command.h5"]) == 0
    with nlos.open_bench(BENCH) as bench:
        list(nlos.scan(SCAN, bench, output="python.h5"))
    with Recording.open(tmp_path / "command.h5") as theirs, Recording.open(tmp_path / "python.h5") as ours:
        assert ours.plan == theirs.plan
        assert ours.status is theirs.status is Status.COMPLETE
        ours_said, theirs_said = (recording.header.texts() for recording in (ours, theirs))
        for name in ("scan_text", "scan_json", "bench_json", "constants_json", "devices", "software", "warnings"):
            assert ours_said[name] == theirs_said[name], name
        kinds = [[event.kind for event in recording.events()] for recording in (ours, theirs)]
        assert "scheme" in kinds[0]
        assert kinds[0] == kinds[1]
        assert (ours.transient().counts == theirs.transient().counts).all()


def test_a_scan_that_was_left_is_interrupted_and_resumes() -> None:
    with nlos.open_bench(BENCH) as bench:
        samples = nlos.scan(SCAN, bench, output="run.h5")
        first = [next(samples).point.number for _ in range(3)]
        samples.close()
    with Recording.open(Path("run.h5")) as recording:
        assert recording.status is Status.INTERRUPTED
    with nlos.open_bench(BENCH) as bench:
        others = [sample.point.number for sample in nlos.scan(SCAN, bench, output="run.h5", resume=True)]
        assert list(nlos.scan(SCAN, bench, output="run.h5", resume=True)) == []
    assert not set(first) & set(others)
    with Recording.open(Path("run.h5")) as recording:
        assert recording.status is Status.COMPLETE
        assert len(first) + len(others) == len(recording.plan)


def test_a_trip_that_stands_is_met_before_anything_moves() -> None:
    with nlos.open_bench(BENCH) as bench:
        settings = bench.settings
    TripLatch.of_bench(settings).trip("too bright")
    with nlos.open_bench(BENCH) as bench, pytest.raises(SafetyTrip, match="too bright"):
        nlos.scan(SCAN, bench, output="run.h5")
    assert not Path("run.h5").exists()


def test_a_trip_in_the_scan_says_where_the_samples_are() -> None:
    with nlos.open_bench(BENCH) as bench:
        samples = nlos.scan(SCAN, bench, output="run.h5")
        next(samples)
        with pytest.raises(SafetyTrip, match=r"safe in run\.h5; `resume=True` takes the others"):
            samples.throw(SafetyTrip("shutter", "closed by a trip."))
        assert bench.shutter.confirmed_closed
    with Recording.open(Path("run.h5")) as recording:
        assert recording.status is Status.STOPPED


@pytest.mark.parametrize("name", ["run.txt", "far/away/run.h5"])
def test_a_name_that_cannot_be_written_is_refused_at_once(name: str) -> None:
    with nlos.open_bench(BENCH) as bench, pytest.raises(StorageError, match="run"):
        nlos.scan(SCAN, bench, output=name)


def test_a_second_scan_of_a_bench_leaves_the_first_alone() -> None:
    with nlos.open_bench(BENCH) as bench:
        alone = [sample.histogram.counts.tolist() for sample in nlos.scan(SCAN, bench)]
    with nlos.open_bench(BENCH) as bench:
        waiting, first = nlos.scan(SCAN, bench), nlos.scan(SCAN, bench)
        taken = [next(first)]
        with pytest.raises(DeviceBusy, match=r"is scanning already\. End that scan first"):
            nlos.scan(SCAN, bench, output="second.h5")
        with pytest.raises(DeviceBusy, match="is scanning already"):
            next(waiting)
        taken += first
        assert [sample.histogram.counts.tolist() for sample in taken] == alone
        assert not Path("second.h5").exists()
        left = nlos.scan(SCAN, bench)
        next(left)
        left.close()
        assert not bench.shutter.may_be_open
        assert len(list(nlos.scan(SCAN, bench))) == len(alone)


def test_a_scan_of_a_bench_that_was_closed_looks_for_no_cable() -> None:
    with nlos.open_bench(BENCH) as bench:
        pass
    with pytest.raises(BenchClosed, match=r"was closed: the `with` block .* is over\. Open the bench again"):
        nlos.scan(SCAN, bench)


def test_what_is_no_open_bench_is_told_how_one_is_opened() -> None:
    for wrong in (BENCH, None, nlos.open_bench(BENCH)):
        with pytest.raises(TypeError, match=r"is no open bench\. Open it: with nlos.open_bench\("):
            nlos.scan(SCAN, wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"tags": "night"}, r"tags='night': a list of words is expected"),
        ({"tags": ["night", 3]}, r"a list of words is expected"),
        ({"sample": 3}, r"sample=3: text is expected, as sample='3'\."),
        ({"note": ["long"]}, r"note=\['long'\]: text is expected"),
    ],
)
def test_notes_that_are_no_text_are_refused_before_a_file_is_begun(said: dict[str, Any], told: str) -> None:
    """A word is a sequence of letters, too: tags of one letter each were kept of it."""
    with nlos.open_bench(BENCH) as bench, pytest.raises(TypeError, match=told):
        nlos.scan(SCAN, bench, output="run.h5", **said)
    assert not Path("run.h5").exists()


def test_a_scan_that_was_left_says_how_much_of_it_is_there() -> None:
    with nlos.open_bench(BENCH) as bench:
        samples = nlos.scan(SCAN, bench, output="run.h5")
        taken = [next(samples) for _ in range(3)]
        samples.close()
    assert f"64 x 64 points, {len(taken)} measured, 1 x 1 m" in repr(nlos.load("run.h5"))
    with pytest.raises(InvalidData, match=r"^run\.h5: frame 7: the recording has 1, from 0 to 0"):
        nlos.load("run.h5", frame=7)


def test_what_is_refused_of_a_place_names_no_option() -> None:
    with nlos.open_bench(BENCH) as bench, pytest.raises(StorageError, match=r"choose another place\.$"):
        nlos.scan(SCAN, bench, output="nowhere/at/all/run.h5")
