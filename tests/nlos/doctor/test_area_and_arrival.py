"""Where the doctor sends the beam, and when it says that light came: against places and times that are known."""

import math

import numpy as np
import pytest

from nlos.configs.load import load, names
from nlos.doctor.area import WallArea, angles_of, area_of
from nlos.doctor.gates import arrival, axis_of
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.bench_settings import AllowedArea
from nlos.drivers.errors import LimitError
from nlos.drivers.tcspc.counter import HistogramAxis

AXIS = HistogramAxis(1024, 16e-12, 8e-9)
TIME_S = AXIS.offset_s + (np.arange(AXIS.bins) + 0.5) * AXIS.bin_width_s


def area(left_m: float, right_m: float, bottom_m: float, top_m: float) -> tuple[WallArea, Bench]:
    """Of a bench that allows this; the bench is closed again, and still knows its limits."""
    settings = load("bench", "zero_latency", BenchSettings).settings
    allowed = AllowedArea(left_m=left_m, right_m=right_m, bottom_m=bottom_m, top_m=top_m)
    geometry = settings.geometry.model_copy(update={"allowed": allowed})
    with open_bench(settings.model_copy(update={"geometry": geometry})) as bench:
        return area_of(bench), bench


def test_all_that_is_allowed_and_reached_is_looked_at() -> None:
    found, _ = area(-0.2, 0.6, -0.3, 0.1)
    assert found.centre == pytest.approx((0.2, -0.1))
    assert -0.2 < found.left_m < -0.199
    assert 0.599 < found.right_m < 0.6
    assert -0.3 < found.bottom_m < -0.299
    assert 0.099 < found.top_m < 0.1
    assert found.nearest == (0.0, 0.0)
    assert found.farthest == (found.right_m, found.bottom_m)
    part = found.within(0.3)
    assert (part.left_m, part.right_m) == pytest.approx((-0.1, 0.5))
    assert (part.bottom_m, part.top_m) == (found.bottom_m, found.top_m)


def test_an_area_beside_the_undeflected_beam_has_its_nearest_place_on_its_edge() -> None:
    found = WallArea(0.2, 0.6, -0.3, -0.1)
    assert (found.nearest, found.farthest) == ((0.2, -0.1), (0.6, -0.3))


def test_of_more_than_the_mirror_reaches_nearly_all_that_it_reaches_is_looked_at() -> None:
    found, bench = area(-30.0, 30.0, -30.0, 30.0)
    assert found.centre == pytest.approx((0.0, 0.0))
    for corner in found.corners:
        bench.mirror.check(angles_of(bench, corner))
    farther = found.right_m / 0.89
    with pytest.raises(LimitError):
        bench.mirror.check(angles_of(bench, (farther, farther)))


def test_an_area_out_of_reach_is_refused_by_name() -> None:
    with pytest.raises(LimitError, match="does not reach the allowed area"):
        area(30.0, 31.0, 30.0, 31.0)


@pytest.mark.parametrize("name", [name for name in names("bench") if name != "drawn"])
def test_every_counters_window_holds_the_walls_direct_light(name: str) -> None:
    """There and back at the speed of light, and a nanosecond for the pulse."""
    settings = load("bench", name, BenchSettings).settings
    if not settings.simulated:
        pytest.skip("needs its instruments")
    with open_bench(settings) as bench:
        axis = axis_of(bench)
        bench.counter.check(axis, 0.1)
    due_s = 2 * settings.geometry.wall_distance_m / 299_792_458
    assert axis.offset_s + 1e-9 < due_s < axis.offset_s + axis.bins * axis.bin_width_s - 1e-9
    assert axis.offset_s >= due_s - 12e-9


def photons(*pulses: tuple[float, float], background: float = 0.2, seed: int = 1) -> np.ndarray:
    """Counts (T,) of Gaussian pulses, each (when in s, photons), 60 ps wide (one sigma), over a background per bin."""
    draw = np.random.default_rng(seed)
    counts = draw.poisson(background, AXIS.bins)
    for when_s, count in pulses:
        shape = np.exp(-0.5 * ((TIME_S - when_s) / 60e-12) ** 2)
        counts += draw.poisson(count * shape / shape.sum())
    return counts


def test_direct_light_comes_when_it_was_sent_within_the_error_that_is_said() -> None:
    offs = []
    for seed in range(40):
        found = arrival(photons((13.3e-9, 400), seed=seed), AXIS, 13.4e-9, 4e-9)
        assert found is not None
        offs.append((found.time_s - 13.3e-9) / found.error_s)
    assert abs(np.mean(offs)) < 4 / math.sqrt(40)
    assert 0.6 < np.std(offs) < 1.5


def test_the_first_high_peak_is_the_walls_and_what_is_out_of_reach_is_none() -> None:
    found = arrival(photons((13.3e-9, 500), (15.5e-9, 1200)), AXIS, 13.4e-9, 4e-9)
    assert found is not None
    assert found.time_s == pytest.approx(13.3e-9, abs=30e-12)
    found = arrival(photons((13.3e-9, 500), (20e-9, 90)), AXIS, 20e-9, 3e-9)
    assert found is not None
    assert found.time_s == pytest.approx(20e-9, abs=60e-12)


def test_a_faint_pulse_that_stands_out_is_found_where_it_is() -> None:
    """60 photons over 37 of the background: ten times what chance makes of these."""
    for seed in range(30):
        found = arrival(photons((13.3e-9, 60), background=0.5, seed=seed), AXIS, 13.4e-9, 4e-9)
        assert found is not None, seed
        assert abs(found.time_s - 13.3e-9) < 4.5 * found.error_s


@pytest.mark.parametrize("background", [0.02, 3.0])
def test_chance_is_no_direct_light_and_a_faint_pulse_is(background: float) -> None:
    for seed in range(20):
        assert arrival(photons(background=background, seed=seed), AXIS, 13.4e-9, 4e-9) is None
    assert arrival(photons((13.3e-9, 250), background=background), AXIS, 13.4e-9, 4e-9) is not None
