"""Another program changes a range in the middle of a scan: ranges are set again in the dark, and the scan continues."""

import json
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plugged
from tests.acquisition.fault_cases import plan, settings

TTL = {"shutter": {"model": "triggerscope_ttl"}, "mirror": {"shutter_pin": 16}}


def with_shutter(name: str, changes: dict[str, Any], *faults: Fault) -> BenchSettings:
    text = settings(name, *faults).model_dump(mode="json")
    for block, values in changes.items():
        text[block] |= values
    return BenchSettings.model_validate_json(json.dumps(text))


@pytest.mark.parametrize("changes", [{}, TTL], ids=["counter's shutter", "TTL shutter"])
@pytest.mark.parametrize("name", ["stepped", "clocked", "listed"])
def test_ranges_are_set_anew_in_the_dark_and_every_sample_is_what_it_was(name: str, changes: dict[str, Any]) -> None:
    this: ScanPlan = plan(name)
    with open_bench(with_shutter(name, changes)) as bench:
        undisturbed = {sample.point.number: sample.histogram.counts for sample in scan(this, bench)}
    fault = Fault(name="A7", skip=45 if name == "stepped" else 26)
    with open_bench(with_shutter(name, changes, fault)) as bench:
        firmware = plugged(bench.settings.mirror.port.removeprefix("sim://")).firmware
        lit, events = [], []
        simulated = bench.simulated
        assert simulated is not None

        def log(when_s: float, what: str, number: int, value: int) -> None:
            if what == "range":
                lit.append(simulated.shutter_open)

        firmware.wiring.log = log
        bench.on_event = lambda kind, text: events.append(text)
        samples = list(scan(this, bench))
    assert any("changed the range" in text for text in events)
    assert lit[1:] == [False, False]  # the first is the other program's
    assert sorted(sample.point.number for sample in samples) == sorted(undisturbed)
    for sample in samples:
        np.testing.assert_array_equal(sample.histogram.counts, undisturbed[sample.point.number])
