"""A bin that holds no more counts is no histogram of the light, however modest the rate: the scan says so and ends."""

from collections.abc import Callable

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.scanning.alarms import AlarmRaised, Alarms, AlarmSettings
from nlos.acquisition.scanning.engine import scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings

DWELL_MS, LASER_HZ, FULL = 2000.0, 10e6, 0xFFFF
WINDOW = {"histogram": {"bins": 64, "bin_width_ps": 256, "offset_ns": 0}, "dwell_ms": DWELL_MS}


def benches() -> dict[str, BenchSettings]:
    ours = load("bench", "zero_latency", BenchSettings).settings
    theirs = load("bench", "multiharp", BenchSettings).settings
    picoharp = PicoquantSettings(model="picoquant", device="picoharp300", library="simulated")
    return {
        "tcspc488 of 16 bits": ours.model_copy(update={"counter": ours.counter.model_copy(update={"counts": "u16"})}),
        "tcspc488 of 32 bits": ours,
        "PicoHarp 300": theirs.model_copy(update={"counter": picoharp}),
    }


@pytest.mark.parametrize("name", benches())
@pytest.mark.parametrize("counts", [FULL - 1, FULL + 4465])
def test_more_counts_than_a_bin_holds_end_the_scan_with_the_light_off(
    name: str, counts: int, small_plan: Callable[..., ScanPlan]
) -> None:
    def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
        seen = np.zeros(gate.bins, np.uint32)
        seen[20] = round(counts * gate.dwell_s / DWELL_MS * 1e3) if is_open else 0  # 35 kHz: 0.4 % of the pulses
        return Exposure(seen, gate.dwell_s, round(gate.dwell_s * LASER_HZ), int(seen.sum()), False)

    plan = small_plan(2, 2, **WINDOW)
    with open_bench(benches()[name]) as bench:
        assert bench.simulated is not None
        bench.simulated.light = light
        samples = scan(plan, bench, alarms=Alarms(AlarmSettings(), LASER_HZ))
        if counts > FULL and "32" not in name:
            with pytest.raises(AlarmRaised, match=r"a bin of point 0 is full with 65535 counts .*[Ss]horten"):
                list(samples)
        else:
            assert [int(each.histogram.counts.sum()) for each in samples] == [counts] * 4
        assert not bench.simulated.shutter_open
