"""What is looked at before anything moves: the disk, the light, the beam's spot, the window; to the last byte."""

import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning import preflight
from nlos.acquisition.planning.direct_light import DirectLight, expected_direct, window_warnings
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import (
    ExpectedRates,
    check_disk,
    check_light,
    checked_angles,
    disk_bytes,
)
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.bench_settings import AllowedArea, GeometrySettings
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.counter import HistogramAxis

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


@pytest.mark.parametrize(("side", "bins"), [(16, 4096), (200, 64)])
def test_a_recording_is_as_large_as_was_said(run_path: Path, small_plan: Plans, side: int, bins: int) -> None:
    plan = small_plan(side, side, histogram={"bins": bins, "bin_width_ps": 16, "offset_ns": 10})
    with RecordingWriter.create(run_path, plan, Header().stamped()):
        pass
    assert run_path.stat().st_size <= disk_bytes(plan) <= run_path.stat().st_size + 100_000


@pytest.mark.parametrize("there", [False, True])
def test_a_disk_is_large_enough_to_the_last_byte(
    run_path: Path, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    """A recording that is there already has its place: only what is to stay free beside it is needed."""
    plan, least_free = small_plan(), 50_000_000
    if there:
        run_path.touch()
    needed = least_free if there else least_free + disk_bytes(plan)
    for spare in (0, -1):
        usage = SimpleNamespace(free=needed + spare)
        monkeypatch.setattr(shutil, "disk_usage", lambda folder, usage=usage: usage)
        if spare == 0:
            check_disk(plan, run_path, least_free)
            continue
        with pytest.raises(
            StorageError,
            match=r"50 MB free beside it .* has 49.9 MB left.* set alarms" if there else "plan fewer points",
        ):
            check_disk(plan, run_path, least_free)


def test_pile_up_is_a_twentieth_of_the_laser_pulses() -> None:
    check_light(ExpectedRates(3e5, 1e5, 1e5), 1e7)
    with pytest.raises(LimitError, match="above 5% of 1e\\+07 laser pulses/s"):
        check_light(ExpectedRates(3e5, 1e5, 1.01e5), 1e7)


def test_rates_are_told_apart_in_a_histogram_and_expected_of_a_dwell(small_plan: Plans) -> None:
    """Over 2 s: 40 counts a bin everywhere, a direct pulse of 6000 and 900 later on."""
    counts = np.full(1024, 40.0)
    counts[200:203] += 2000.0
    counts[400:700] += 3.0
    rates = ExpectedRates.of_histogram(counts, 2.0, HistogramAxis(1024, 16e-12, 0.0))
    assert (rates.direct_hz, rates.indirect_hz) == pytest.approx((3000.0, 450.0))
    assert rates.background_hz == pytest.approx(20.0 * 1024)
    at_a_point = preflight.expectation(small_plan(), rates)
    assert (at_a_point.direct, at_a_point.indirect) == pytest.approx((24.0, 3.6))
    assert at_a_point.background == pytest.approx(0.16 * 1024)
    assert at_a_point.signal_to_noise == pytest.approx(3.6 / np.sqrt(3.6 + 0.16 * 1024))


def test_a_small_plan_is_as_bright_as_a_large_one_of_the_same_wall(bench_settings: Benches, small_plan: Plans) -> None:
    """Looked at are sixteen points, or as many as there are."""
    with open_bench(bench_settings()) as bench:
        totals_hz = []
        for plan in (small_plan(2, 2), small_plan(12, 12)):
            angles = checked_angles(plan, bench, preflight.aim_of(bench))
            totals_hz.append(ExpectedRates.of_simulation(plan, bench, angles).total_hz)
    assert totals_hz[0] == pytest.approx(totals_hz[1], rel=0.3)


def test_a_settled_beam_is_so_many_pixels_off_at_most(small_plan: Plans) -> None:
    """At the middle of a wall, 2 m away, 0.05 degrees of each mirror are 0.1 of the beam: 3.5 mm, more from the first
    mirror; 10 pixels a metre across, 20 down."""
    settings = SimpleNamespace(
        mirror=SimpleNamespace(settle=SimpleNamespace(within_deg=0.05)),
        geometry=SimpleNamespace(wall_distance_m=2.0, mirror_separation_m=0.1),
    )
    bench, plan = cast(Bench, SimpleNamespace(settings=settings)), small_plan(20, 10)
    within_rad = np.radians(0.1)
    expected = np.hypot(2.1 * within_rad * 10, 2.0 * within_rad * 20)
    assert preflight.beam_within_px(plan, bench, [MirrorAngles(0.0, 0.0)]) == pytest.approx(expected)
    assert preflight.beam_within_px(plan, bench, [MirrorAngles(0.0, 0.0), MirrorAngles(0.2, 0.2)]) > expected


def test_the_drawn_wall_leans_as_the_bench_file_says() -> None:
    drawn = preflight.drawn_aim(GeometrySettings(wall_distance_m=2.0, wall_yaw_deg=10.0, wall_pitch_deg=5.0))
    left, right, bottom, top = (
        float(drawn.ranges_m(np.array(x), np.array(y))) for x, y in ((-0.1, 0.0), (0.1, 0.0), (0.0, -0.1), (0.0, 0.1))
    )
    assert left < 2.0 < right
    assert bottom < 2.0 < top


def test_points_beside_the_allowed_area_are_refused_before_anything_moves(
    bench_settings: Benches, small_plan: Plans
) -> None:
    settings, plan = bench_settings(), small_plan()
    area = AllowedArea(left_m=-0.45, right_m=0.40, bottom_m=-0.45, top_m=0.45)  # the last column is at 0.417 m
    settings = settings.model_copy(update={"geometry": settings.geometry.model_copy(update={"allowed": area})})
    with open_bench(settings) as bench, pytest.raises(LimitError, match=r"x = \+0.417 m.*outside the allowed area"):
        checked_angles(plan, bench, preflight.aim_of(bench))


@pytest.mark.parametrize(
    ("arrival_ns", "inside"), [(10.19, False), (10.21, True), (26.07, True), (26.10, False), (9.0, False)]
)
def test_a_window_holds_a_pulse_from_before_its_maximum_until_after_it(
    small_plan: Plans, arrival_ns: float, inside: bool
) -> None:
    """10 to 26.384 ns; a pulse takes 0.2 ns before its maximum and 0.3 ns after it."""
    direct = DirectLight(np.array([arrival_ns * 1e-9]), 100e-9, True)
    assert direct.inside(small_plan()).tolist() == [inside]
    seen_ns = arrival_ns if arrival_ns > 10.2 else arrival_ns + 100
    assert direct.seen_at_s(small_plan()) * 1e9 == pytest.approx([seen_ns])


@pytest.mark.parametrize(("bin_width_ps", "most"), [(16, 6250), (25, 4000), (30, 3333)])
def test_a_window_may_be_as_long_as_the_period_and_no_bin_longer(
    small_plan: Plans, bin_width_ps: int, most: int
) -> None:
    """100e-9 / 25e-12 is a little less than 4000."""
    direct = DirectLight(np.array([5e-9]), 100e-9, True)
    plans = (
        small_plan(histogram={"bins": bins, "bin_width_ps": bin_width_ps, "offset_ns": 0}) for bins in (most, most + 1)
    )
    fits, too_long = (window_warnings(plan, direct) for plan in plans)
    assert fits == []
    assert "longer than the laser's period of 100 ns: what comes after" in too_long[0]
    assert too_long[0].endswith(f"Take at most {most} bins.")


def test_axes_that_are_turned_show_only_where_the_wall_leans(bench_settings: Benches, small_plan: Plans) -> None:
    settings = bench_settings()
    upright, leaning = (
        expected_direct(small_plan(), settings, preflight.drawn_aim(GeometrySettings(wall_distance_m=2.0, **tilt)))
        for tilt in ({"mirror_separation_m": 0.012}, {"wall_yaw_deg": 10.0})
    )
    assert upright.turned_s == {}
    assert "x is reversed" in leaning.turned_s
    assert "y is reversed" not in leaning.turned_s
    assert leaning.turned_s["x is reversed"].max() == pytest.approx(leaning.arrival_s.max(), rel=0.01)
