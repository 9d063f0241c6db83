"""Scans with a random fault at a random moment: the light goes off, and `--resume` ends equal to undisturbed. Two and
three faults at once: `test_own_photons.py`."""

import os
import random
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume, verify
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import open_bench
from nlos.drivers.errors import DeviceError
from nlos.drivers.simulated.faults import Fault
from tests.acquisition.fault_cases import BENCHES, cuts_off_the_shutter, plan, settings

SOAK = os.environ.get("NLOS_SOAK") == "1"
SCANS = 100 if SOAK else 16


def go_on(path: Path, name: str, fault: Fault | None = None) -> None:
    """What `nlos scan --resume` does, on a bench that has been reopened."""
    faults = [] if fault is None else [fault]
    chosen = settings(name, *faults)
    table = None
    try:
        with open_bench(chosen) as table:
            begun = resume(path, plan(name), Header(bench_json=settings(name).model_dump_json()))
            if begun.writer is None:
                return
            with begun.writer as writer:
                record(scan(plan(name), table, taken=begun.taken, elapsed_s=begun.elapsed_s), writer)
    finally:
        if table is not None and table.simulated is not None and not cuts_off_the_shutter(name, *faults):
            assert not table.simulated.shutter_open


def counts(path: Path) -> np.ndarray:
    with Recording.open(path) as recording:
        samples = sorted(recording.samples(), key=lambda sample: sample.point.number)
    return np.stack([sample.histogram.counts for sample in samples])


@cache
def undisturbed(name: str, folder: Path) -> np.ndarray:
    path = folder / f"{name}.h5"
    go_on(path, name)
    return counts(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("undisturbed")


def draw(seed: int) -> tuple[str, Fault]:
    chance = random.Random(seed)
    name = chance.choice(sorted(BENCHES))
    word, parameters = chance.choice(BENCHES[name][2])
    return name, Fault(name=word, skip=chance.choice((0, 1, 3, 10, 30, 60)), parameters=parameters)


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(SCANS))
def test_a_scan_with_a_fault_ends_complete_and_equal(seed: int, tmp_path: Path, folder: Path) -> None:
    name, fault = draw(seed)
    path = tmp_path / "run.h5"
    first: Fault | None = fault
    for _ in range(3):
        try:
            go_on(path, name, first)
            break
        except DeviceError:
            first = None  # the person has fixed what broke
    else:
        pytest.fail("it did not even end with the fault gone")
    assert verify(path).complete
    np.testing.assert_array_equal(counts(path), undisturbed(name, folder))
