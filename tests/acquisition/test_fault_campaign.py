"""Scans with one to three random faults at random moments, on the resumed attempt too: the light goes off, what was
acknowledged stays, and `--resume` ends equal to undisturbed. With photons that say where they come from:
`test_own_photons.py`."""

import os
import random
from functools import cache
from pathlib import Path

import pytest

from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import open_bench
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.fault_cases import (
    cuts_off_the_shutter,
    drawn,
    patience,
    plan,
    resumed_until_complete,
    settings,
)

pytestmark = pytest.mark.usefixtures("one_child_reads")
SCANS = 2000 if os.environ.get("NLOS_SOAK") == "1" else 16


def go_on(path: Path, name: str, faults: list[Fault]) -> None:
    """What `nlos scan --resume` does, on a bench that has been reopened."""
    table = None
    try:
        with patience(), open_bench(settings(name, *faults)) as table:
            begun = resume(path, plan(name), Header(bench_json=settings(name).model_dump_json()))
            if begun.writer is None:
                return
            with begun.writer as writer:
                record(scan(plan(name), table, taken=begun.taken, elapsed_s=begun.elapsed_s), writer)
    finally:
        if table is not None and table.simulated is not None and not cuts_off_the_shutter(name, *faults):
            assert not table.simulated.shutter_open


def counts(path: Path) -> dict[int, bytes]:
    with Recording.open(path) as recording:
        return {sample.point.number: sample.histogram.counts.tobytes() for sample in recording.samples()}


@cache
def undisturbed(name: str, folder: Path) -> dict[int, bytes]:
    path = folder / f"{name}.h5"
    go_on(path, name, [])
    assert len(counts(path)) == len(plan(name))
    return counts(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("undisturbed")


def check(path: Path, expected: dict[int, bytes], name: str, rounds: list[list[Fault]]) -> None:
    """Nothing acknowledged is lost or changes in any round; in the end all is as expected."""

    def as_expected(now: dict[int, bytes]) -> None:
        assert now.items() <= expected.items()

    resumed_until_complete(path, lambda faults: go_on(path, name, faults), rounds, as_expected)
    assert counts(path) == expected


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(SCANS))
def test_a_scan_with_faults_loses_nothing_and_ends_complete_and_equal(seed: int, tmp_path: Path, folder: Path) -> None:
    name, rounds = drawn(random.Random(f"counts {seed}"))
    check(tmp_path / "run.h5", undisturbed(name, folder), name, rounds)


@pytest.mark.parametrize("name", ["timetagger", "timetagger list", "multiharp", "listed", "clocked"])
def test_the_first_step_of_all_is_missed(name: str, tmp_path: Path, folder: Path) -> None:
    """No gap between steps tells; where points begin at the mirror's own steps, all of them come one period later."""
    faults = [Fault(name="A6", skip=0, parameters={"kind": "missed"})]
    check(tmp_path / "run.h5", undisturbed(name, folder), name, [faults])
