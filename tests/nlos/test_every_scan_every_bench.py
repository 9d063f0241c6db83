"""Every shipped scan on every shipped bench: a plan that the bench then takes, or the refusal that says why and what to
do."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.planning.direct_light import expected_direct
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.scanning.alarms import AlarmSettings
from nlos.acquisition.scanning.direct_watch import DirectWatch
from nlos.acquisition.scanning.engine import scan
from nlos.cli.benches import twin
from nlos.configs.load import load, names
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import LimitError
from nlos.drivers.tcspc.counter import HistogramAxis
from nlos.scan_preparation import ScanRequest, prepare

SCANS = {name: load("scan", name, ScanSettings).settings.plan() for name in names("scan")}
REFUSALS = {
    ("lab", "full"): "outside the allowed area",
    ("lab", "sparse"): "outside the allowed area",
    ("multiharp", "until_enough"): "two_pass",
    ("timetagger", "until_enough"): "two_pass",
}
"""What a bench cannot do, by a word of the reason or of what to do next."""
OWN_WIDTHS_PS = {"multiharp": {16: 20, 32: 40}}
POINTS = 12


@pytest.fixture(scope="module", params=names("bench"))
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    with open_bench(twin(load("bench", request.param, BenchSettings)).settings) as opened:
        yield opened


def file_name(bench: Bench) -> str:
    return bench.settings.name.replace(" ", "_")


def first_points(plan: ScanPlan) -> ScanPlan:
    """The beginning of a plan, without the second pass, whatever somebody might advise."""
    few = np.arange(min(POINTS, plan.first_pass))
    return replace(
        plan, positions=plan.positions.take(few), dwell_s=plan.dwell_s[few], pass_=plan.pass_[few], revisit_below=None,
        budget=None,
    )  # fmt: skip


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", SCANS)
def test_a_plan_or_the_right_refusal(bench: Bench, name: str, tmp_path: Path) -> None:
    asked = SCANS[name]
    request = ScanRequest(asked, AlarmSettings(), Header(), tmp_path / "run.h5")
    if (why := REFUSALS.get((file_name(bench), name))) is not None:
        with pytest.raises(LimitError, match=why):
            prepare(request, bench)
        return
    prepared = prepare(request, bench)
    plan = prepared.request.plan
    asked_ps, width_ps = (round(each.axis.bin_width_s * 1e12, 3) for each in (asked, plan))
    assert width_ps == OWN_WIDTHS_PS.get(file_name(bench), {}).get(asked_ps, asked_ps)
    begin_s, end_s = (
        np.array([each.axis.offset_s, each.axis.offset_s + each.axis.bins * each.axis.bin_width_s])
        for each in (asked, plan)
    )
    assert end_s[0] <= begin_s[0] + 1e-15
    assert end_s[1] >= begin_s[1] - 1e-15
    samples = list(scan(first_points(plan), bench, aim=prepared.aim))
    assert [sample.point.number for sample in samples] == list(range(POINTS))
    assert all(sample.histogram.counts.shape == (plan.axis.bins,) for sample in samples)
    few = first_points(plan)
    watch = DirectWatch(few, expected_direct(few, bench.settings, prepared.aim))
    assert [said for sample in samples if (said := watch.look(sample))] == []


def test_another_time_axis_is_said_and_kept(bench: Bench, tmp_path: Path) -> None:
    said: list[tuple[str, str]] = []
    bench.on_event = lambda kind, text: said.append((kind, text))  # what other tests left waiting comes first
    said.clear()
    prepare(ScanRequest(SCANS["demo"], AlarmSettings(), Header(), tmp_path / "run.h5"), bench)
    bench.on_event = None
    other = [text for kind, text in said if kind == "warning" and "820 of 20 ps" in text]
    assert len(other) == (file_name(bench) in OWN_WIDTHS_PS)


def test_points_that_end_by_counts_keep_their_window_on_another_axis() -> None:
    plan = SCANS["until_enough"]
    other = plan.on_axis(HistogramAxis(820, 20e-12, 9.98e-9))
    assert plan.stop is not None
    assert other.stop is not None
    for bin_, other_bin in ((plan.stop.first_bin, other.stop.first_bin), (plan.stop.end_bin, other.stop.end_bin)):
        before_s = plan.axis.offset_s + bin_ * plan.axis.bin_width_s
        assert other.axis.offset_s + other_bin * other.axis.bin_width_s == pytest.approx(before_s, abs=11e-12)
