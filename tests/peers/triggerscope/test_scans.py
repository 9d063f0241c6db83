"""Whole scans with a compiled sketch in the bench: every count, time and output as on the simulated bench."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.engine import scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.galvo.triggerscope.model import TRIGGERSCOPE
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.triggerscope.firmware import V4, V4B, TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.wiring import Wiring

BOARDS = {"TriggerScope_V4B": V4B, "TriggerScope_V4": V4, "TriggerScope_620MM": V4B, "TriggerScope_612MM": V4}
BENCHES = {
    Scheme.STEPPED: ("simulated", {"counter": {"markers": False}}),
    Scheme.CLOCKED: ("simulated", {}),
    Scheme.LISTED: ("simulated", {"counter": {"mode": "t3"}}),
    None: ("multiharp", {}),  # list mode through the vendor's library
}


def settings(scheme: Scheme | None) -> BenchSettings:
    file, changes = BENCHES[scheme]
    text = load("bench", file, BenchSettings).settings.model_dump(mode="json")
    for block, values in changes.items():
        text[block] |= values
    text["simulation"]["scene"]["surfel_m"] = 0.05
    return BenchSettings.model_validate_json(json.dumps(text))


@pytest.mark.parametrize("scheme", BENCHES, ids=lambda scheme: scheme.value if scheme else "multiharp")
@pytest.mark.parametrize("name", BOARDS)
def test_a_scan_is_the_same_to_the_last_bit(
    monkeypatch: pytest.MonkeyPatch, sketch: Callable[..., object], tmp_path: Path, name: str, scheme: Scheme | None
) -> None:
    chosen = settings(scheme)
    plan = ScanSettings.model_validate(
        {
            "wall": {"width_m": 0.8, "height_m": 0.8, "rows": 16, "cols": 16},
            "pattern": {"kind": "serpentine"},
            "dwell_ms": 2.0,
            "histogram": {"bins": 512, "bin_width_ps": 40.0 if scheme is None else 32.0, "offset_ns": 8.0},
        }
    ).plan()
    logs, scans = [], []
    for real in (True, False):
        log: list[tuple[float, str, int, int]] = []

        def matching(mirror: object, table: SimulatedTable, real: bool = real, log: list = log) -> object:
            bench = table.bench
            wiring = Wiring.matching(bench, mirror)
            this = sketch(name, bench, wiring) if real else TriggerScopeFirmware(bench, wiring, board=BOARDS[name])
            wiring.log = lambda *event: log.append(event)
            return this

        other = replace(TRIGGERSCOPE, firmware=matching)
        monkeypatch.setitem(MIRRORS, "triggerscope", other)
        with open_bench(chosen) as bench:
            scans.append(list(scan(plan, bench, scheme=scheme)))
        logs.append(log)
    assert len(logs[0]) > 256
    assert logs[1] == logs[0]
    assert [sample.point for sample in scans[0]] == [sample.point for sample in scans[1]]
    for theirs, ours in zip(*scans, strict=True):
        np.testing.assert_array_equal(ours.histogram.counts, theirs.histogram.counts)
        assert ours.histogram.live_time_s == theirs.histogram.live_time_s
    assert sum(int(sample.histogram.counts.sum()) for sample in scans[0]) > 1000
