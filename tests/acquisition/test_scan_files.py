"""Every scan file that comes along loads, plans, and is within the default bench's reach."""

import numpy as np
import pytest

from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import choose
from nlos.configs.load import ConfigError, load, names, parse
from nlos.drivers.bench import BenchSettings, open_bench


@pytest.mark.parametrize("name", names("scan"))
def test_every_scan_file_can_be_scanned_on_the_default_bench(name: str) -> None:
    loaded = load("scan", name, ScanSettings)
    assert "wall: {width_m: " in loaded.text
    assert "\ndwell_ms: " in loaded.text
    plan = loaded.settings.plan()
    with open_bench(load("bench", "simulated", BenchSettings).settings) as bench:
        choice = choose(plan, bench, checked_angles(plan, bench, aim_of(bench)))
    assert len(plan) <= 20_000  # at under a millisecond each of wall time
    assert plan.dwell_total_s < choice.forecast.total_s < 200.0
    assert np.all(plan.dwell_s >= 1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("pattern: serpentine", "pattern: serpentin"), "serpentine"),
        (("dwell_ms: 8", "dwell_ms: -8"), ":4:1: dwell_ms"),
        (("dwell_ms: 8", 'dwell_ms: "1e-3"'), ":4:1: dwell_ms"),
        (("dwell_ms: 8", "dwell_ms: 8\ndwell_ms: 9"), ":5:1: "),
        (("dwell_ms: 8", "dwel_ms: 8"), "dwell_ms"),
        (("pattern: serpentine", "pattern: {kind: circle, points: 9}"), "radius_m"),
        (("pattern: serpentine", "pattern: {kind: random, points: 0}"), "points"),
    ],
)
def test_a_mistake_in_a_scan_file_is_refused_by_its_place(change: tuple[str, str], message: str) -> None:
    text = load("scan", "demo", ScanSettings).text
    assert change[0] in text
    with pytest.raises(ConfigError, match=r"bad\.yaml:\d+:\d+: ") as refusal:
        parse(text.replace(*change), "bad.yaml", ScanSettings)
    assert message in str(refusal.value)
