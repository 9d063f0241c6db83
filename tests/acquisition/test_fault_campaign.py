"""Scans with a random fault at a random moment: the light goes off, and `--resume` ends equal to undisturbed."""

import json
import os
import random
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume, verify
from nlos.acquisition.scanning.engine import record, scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceError
from nlos.drivers.simulated.faults import Fault

SOAK = os.environ.get("NLOS_SOAK") == "1"
SCANS = 100 if SOAK else 16

SERIAL: list[tuple[str, dict[str, Any]]] = [
    ("G1", {}), ("G2", {"delay_s": 2.0}), ("G3", {"delay_s": 0.1}), ("G4", {"kind": "noise"}), ("G4", {"kind": "nul"}),
    ("G4", {"kind": "overlong"}), ("G5", {}), ("G6", {}), ("G7", {"chunk": 2}), ("G8", {"place": "read"}),
    ("G8", {"place": "write"}), ("G9", {}),
]  # fmt: skip
TRIGGERSCOPE: list[tuple[str, dict[str, Any]]] = [
    ("A2", {}), ("A4", {}), ("A6", {"kind": "missed"}), ("A6", {"kind": "extra"}), ("A7", {}),
]  # fmt: skip
OPTOTUNE: list[tuple[str, dict[str, Any]]] = [
    ("B1", {"reply": "NO"}), ("B1", {"reply": "OL"}), ("B2", {}), ("B3", {}), ("B4", {"bit": 1}),
    ("B5", {"place": "stuck"}), ("B6", {"off": 0.02}),
]  # fmt: skip
USB: list[tuple[str, dict[str, Any]]] = [
    ("U1", {}), ("U2", {}), ("U3", {"place": "in"}), ("U3", {"place": "out"}), ("U3", {"place": "control"}),
    ("U4", {}), ("U5", {"field": "tag"}), ("U5", {"field": "kind"}), ("U6", {"what": "cut"}),
    ("U6", {"what": "early_end"}), ("U7", {}), ("U8", {"bytes": 2}), ("U10", {}), ("U11", {"place": "read"}),
    ("U11", {"place": "write"}), ("U12", {"what": "crc"}), ("U12", {"what": "number"}), ("U12", {"what": "header"}),
    ("U13", {"errors": 20}), ("U14", {"cause": "over_count"}), ("U14", {"cause": "watchdog"}),
    ("U14", {"cause": "sync"}), ("U15", {"what": "missed"}), ("U15", {"what": "overrun"}), ("U15", {"place": "clock"}),
    ("U16", {}), ("U18", {}), ("U19", {"delay_s": 0.05}),
]  # fmt: skip
LIST_MODE: list[tuple[str, dict[str, Any]]] = [
    ("U20", {"place": "records", "what": "marker_order"}), ("U20", {"place": "records", "what": "fifo_full"}),
    ("U20", {"place": "block"}),
]  # fmt: skip
VENDOR: list[tuple[str, dict[str, Any]]] = [
    ("V1", {"place": "GetFlags"}), ("V1", {"place": "ReadFiFo"}), ("V2", {}), ("V3", {}), ("V4", {}),
    ("U20", {"place": "marker", "late_pulses": 200}),
]  # fmt: skip
BENCHES = {
    "stepped": ("simulated", {"counter": {"markers": False}}, SERIAL + TRIGGERSCOPE + USB),
    "clocked": ("simulated", {}, SERIAL + TRIGGERSCOPE + USB),
    "listed": ("simulated", {"counter": {"mode": "t3"}}, SERIAL + TRIGGERSCOPE + USB + LIST_MODE),
    "optotune": ("optotune", {}, SERIAL + OPTOTUNE + USB),
    "multiharp": ("multiharp", {}, SERIAL + TRIGGERSCOPE + VENDOR),
}


def settings(name: str, fault: Fault | None = None) -> BenchSettings:
    file, changes, _ = BENCHES[name]
    text = load("bench", file, BenchSettings).settings.model_dump(mode="json")
    for block, values in changes.items():
        text[block] |= values
    text["simulation"]["scene"]["surfel_m"] = 0.05
    text["simulation"]["faults"] = [fault.model_dump(mode="json")] if fault else []
    return BenchSettings.model_validate_json(json.dumps(text))


def plan(name: str) -> ScanPlan:
    width_ps = 40.0 if name == "multiharp" else 32.0
    return ScanSettings.model_validate(
        {
            "wall": {"width_m": 0.6, "height_m": 0.6, "rows": 6, "cols": 6},
            "pattern": {"kind": "serpentine"},
            "dwell_ms": 2.0,
            "histogram": {"bins": 512, "bin_width_ps": width_ps, "offset_ns": 8.0},
        }
    ).plan()


def go_on(path: Path, name: str, fault: Fault | None = None) -> None:
    """What `nlos scan --resume` does, on a bench that has been opened anew."""
    chosen = settings(name, fault)
    table = None
    try:
        with open_bench(chosen) as table:
            begun = resume(path, plan(name), Header(bench_json=settings(name).model_dump_json()))
            if begun.writer is None:
                return
            with begun.writer as writer:
                record(scan(plan(name), table, taken=begun.taken, elapsed_s=begun.elapsed_s), writer)
    finally:
        if table is not None and table.simulated is not None and not cuts_off_the_shutter(name, fault):
            assert not table.simulated.shutter_open


def cuts_off_the_shutter(name: str, fault: Fault | None) -> bool:
    """Whether the cable that is pulled is the shutter's own: a watchdog or the interlock has to close it then."""
    return fault is not None and fault.name == ("G8" if name == "multiharp" else "U11")


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
            first = None  # the person has mended what broke
    else:
        pytest.fail("it did not even end with the fault gone")
    assert verify(path).complete
    np.testing.assert_array_equal(counts(path), undisturbed(name, folder))
