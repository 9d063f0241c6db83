"""Under every scheme, fault and resume, each stored sample holds the photons of its own point, taken as planned; what
was acknowledged stays, the light goes off, and everything ends."""

import os
import random
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import open_bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated import instruments
from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.t3_instrument import T3Instrument
from nlos.drivers.tcspc.picoquant import t3
from tests.acquisition.coded_light import CodedLight, Spelled, code, expected, read
from tests.acquisition.fault_cases import (
    BENCHES,
    cuts_off_the_shutter,
    drawn,
    patience,
    plan,
    resumed_until_complete,
    settings,
)

pytestmark = pytest.mark.usefixtures("one_child_reads")
SOAK = os.environ.get("NLOS_SOAK") == "1"
SCANS = 2000 if SOAK else 12
TOLERANCE = {"optotune": 2, "played": 10, "played, listed": 10}  # told in six digits; 12 bits
FIRST_OF_EACH = {(name, word): parameters for name in BENCHES for word, parameters in reversed(BENCHES[name][2])}


def tells_settings(name: str) -> bool:
    return name not in ("multiharp", "timetagger", "timetagger list")  # list mode draws light in pieces


def take(path: Path, name: str, faults: list[Fault], monkeypatch: pytest.MonkeyPatch) -> None:
    """What `nlos scan --resume` does, on a bench reopened, with light that says where it comes from."""
    this, chosen = plan(name), settings(name, *faults)
    light = CodedLight(this.axis, chosen.laser.repetition_hz, tells_settings(name))
    monkeypatch.setattr(instruments, "light_of", lambda settings, scene=None: light)
    bench = None
    try:
        with patience(), open_bench(chosen) as bench:
            begun = resume(path, this, Header(bench_json=settings(name).model_dump_json()))
            if begun.writer is not None:
                with begun.writer as writer:
                    record(scan(this, bench, taken=begun.taken, elapsed_s=begun.elapsed_s), writer)
    finally:
        if bench is not None and not cuts_off_the_shutter(name, *faults):
            assert bench.simulated is not None
            assert not bench.simulated.shutter_open


@cache
def planned_angles(name: str) -> list[MirrorAngles]:
    with open_bench(settings(name)) as bench:
        return checked_angles(plan(name), bench, aim_of(bench))


def wrong_samples(path: Path, name: str) -> list[str]:
    """Samples that hold other photons than their own point's."""
    this, angles, wrong = plan(name), planned_angles(name), []
    with Recording.open(path) as recording:
        for sample in recording.samples():
            number = sample.point.number
            due = expected(this, angles, number, tells_settings(name))
            try:
                said = read(sample.histogram.counts)
            except ValueError as error:
                wrong.append(f"point {number}: {error}")
                continue
            near = TOLERANCE.get(name, 1)  # a DAC's step is as fine as one code
            if abs(said.x - due.x) > near or abs(said.y - due.y) > near or replace(said, x=due.x, y=due.y) != due:
                wrong.append(f"point {number}: {said} instead of {due}")
    return wrong


def scan_to_the_end(path: Path, name: str, rounds: list[list[Fault]], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each round meets its faults; a round that ends with a device's error is followed by `--resume`."""

    def own(now: dict[int, bytes]) -> None:
        assert not path.exists() or wrong_samples(path, name) == []

    resumed_until_complete(path, lambda faults: take(path, name, faults, monkeypatch), rounds, own)
    assert wrong_samples(path, name) == []


@pytest.mark.parametrize("name", BENCHES)
def test_every_scheme_stores_the_photons_of_each_point_with_it(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan_to_the_end(tmp_path / "run.h5", name, [], monkeypatch)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", BENCHES)
@pytest.mark.parametrize("step_m", [0.02, 0.1])
def test_a_point_holds_the_same_photons_wherever_the_beam_came_from(name: str, step_m: float) -> None:
    """Taken in one go, and each resumed scan's first points after a move from elsewhere."""
    chosen, shipped = settings(name), plan(name)
    scale = 6 * step_m / shipped.wall.width_m
    positions = replace(shipped.positions, x_m=shipped.positions.x_m * scale, y_m=shipped.positions.y_m * scale)
    this = replace(shipped, positions=positions)

    def counts(taken: dict[int, int]) -> dict[int, bytes]:
        with open_bench(chosen) as bench:
            return {s.point.number: s.histogram.counts.tobytes() for s in scan(this, bench, taken=taken)}

    whole = counts({})
    for done in (1, 17, 30):
        rest = counts(dict.fromkeys(range(done), 0))
        assert rest.items() <= whole.items()
        assert len(rest) == len(this) - done


@pytest.mark.sampled(3)
@pytest.mark.soak
@pytest.mark.parametrize(
    ("name", "word"), sorted(FIRST_OF_EACH) if SOAK else sorted(FIRST_OF_EACH)[::8], ids=lambda value: str(value)
)
def test_after_every_fault_by_name(name: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fault = Fault(name=word, skip=10, parameters=FIRST_OF_EACH[name, word])
    scan_to_the_end(tmp_path / "run.h5", name, [[fault]], monkeypatch)


MISSED, TWICE = Fault(name="A6", skip=5, parameters={"kind": "missed"}), {"kind": "extra"}
OVERLOOKED = {"place": "clock"}
MADE_UP = {
    "clocked": [Fault(name="U15", skip=14, parameters=OVERLOOKED), Fault(name="U15", skip=2, parameters=OVERLOOKED)],
    "listed": [Fault(name="U15", skip=14, parameters=OVERLOOKED), Fault(name="A6", skip=14, parameters=TWICE),
               Fault(name="U15", skip=2, parameters=OVERLOOKED)],
    **{name: [Fault(name="A6", skip=skip, parameters=TWICE) for skip in (2, 14)]
       for name in ("multiharp", "timetagger", "timetagger list")},
}  # fmt: skip


@pytest.mark.parametrize(("name", "other"), [(name, fault) for name, faults in MADE_UP.items() for fault in faults])
def test_a_step_that_is_missed_and_one_that_makes_up_for_it_put_no_sample_in_the_wrong_place(
    name: str, other: Fault, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many steps as points at the end of a block, and between the two every point holds its neighbour's photons."""
    scan_to_the_end(tmp_path / "run.h5", name, [[MISSED, other]], monkeypatch)


@pytest.mark.parametrize("skip", [0, 1, 7])
def test_a_full_fifo_takes_a_gates_mark_with_it_and_no_later_photons_move_up(
    skip: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fault = Fault(name="U20", skip=skip, parameters={"place": "records", "what": "fifo_full"})
    scan_to_the_end(tmp_path / "run.h5", "listed", [[fault]], monkeypatch)


@pytest.mark.parametrize("lost", [3, 4, 11, 30])
def test_a_full_fifo_of_a_picoquant_counter_moves_no_later_photons_up(
    lost: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What arrives while the FIFO is full is gone, a step's mark with it; there is room again as soon as it is read."""
    push, calls = T3Instrument._push, count()

    def full(instrument: T3Instrument, records: npt.NDArray[np.uint32]) -> None:
        if next(calls) == lost:
            instrument.overrun = True
        else:
            full_once = instrument.overrun
            instrument.overrun = False
            push(instrument, records)
            instrument.overrun |= full_once

    monkeypatch.setattr(T3Instrument, "_push", full)
    monkeypatch.setattr(t3, "_POLL_S", 0.02)  # a host that is busy: the next points' records are read with the loss
    scan_to_the_end(tmp_path / "run.h5", "multiharp", [[]], monkeypatch)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(SCANS))
def test_two_and_three_faults_at_once_put_no_sample_in_the_wrong_place(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name, rounds = drawn(random.Random(seed))
    scan_to_the_end(tmp_path / "run.h5", name, rounds, monkeypatch)


def test_a_mistake_by_one_step_is_exact() -> None:
    """What the codes are for: neighbours differ, a mixture is refused, and so are photons of a beam under way."""
    this = plan("stepped")
    light = CodedLight(this.axis, 10e6, True)
    gate = Gate(0.0, 2e-3, this.axis.bins, this.axis.bin_width_s, this.axis.offset_s, number=7)
    here, next_ = (light(gate, MirrorAngles(x, 0.05), True).counts for x in (0.1, 0.1 + 20.0 / 65536 * 0.07))
    assert read(here) == Spelled(code(0.1), code(0.05), 8, 512, 32, 8000, 2000)
    assert read(next_).x == code(0.1) + 1
    for mixture in (here + next_, here + light(replace(gate, kept=False), MirrorAngles(0.1, 0.05), True).counts,
                    np.roll(here, 1), light(gate, MirrorAngles(0.1, 0.05), False).counts):  # fmt: skip
        with pytest.raises(ValueError, match=r"digit|no digit"):
            read(mixture)
