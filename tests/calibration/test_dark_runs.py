"""Dark runs beside scans and alone: bins that differ, what couples into one, and clicks that the dead time took."""

import numpy as np
import pytest

from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.calibration.constants import Quantity
from nlos.calibration.errors import InvalidData
from nlos.calibration.measure import KnownBefore, Measurement, measure_constants
from nlos.calibration.raw_points import RawPoints

BINS, WIDTH_S, PERIOD_S, PULSES = 512, 16e-12, 100e-9, 10_000_000
SIDE, HOT_BIN = 5, 300


def run(
    counts_per_bin: float, *, direct: float = 0.0, hot: float = 0.0, ripple: float = 0.0, seed: int = 0
) -> RawPoints:
    """A second at each of 25 points: room light, a direct pulse at the wall's times, a bin that gets more than others,
    and bins whose widths come and go."""
    at = (np.arange(SIDE) - 2) * 0.2
    x, y = (each.ravel() for each in np.meshgrid(at, at))
    arrival = 2 * (np.sqrt(x**2 + y**2 + 4.0) - 2.0) / SPEED_OF_LIGHT_M_PER_S / WIDTH_S + 100
    bins = np.arange(BINS)
    rate = np.full((len(x), BINS), counts_per_bin) * (1 + ripple * np.sin(9.4 * bins / BINS))
    rate[:, HOT_BIN] += hot
    rate += direct / 5 * np.exp(-0.5 * ((bins + 0.5 - arrival[:, None]) / 2) ** 2)
    counts = np.random.default_rng(seed).poisson(rate).astype(np.uint32)
    outside = np.random.default_rng(seed + 1).poisson(counts_per_bin * (PERIOD_S / WIDTH_S - BINS), len(x))
    one = np.ones(len(x))
    return RawPoints(counts, x, y, PULSES * PERIOD_S * one, PULSES * one, counts.sum(axis=1) + outside * one,
                     TimeAxis(BINS, WIDTH_S))  # fmt: skip


def measured(*runs: RawPoints, known: KnownBefore) -> Measurement:
    return measure_constants(runs, devices={}, sources=[], measured_utc="2026-01-01", aim=Aim(2.0), known=known)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("uneven", [{"hot": 20.0}, {"hot": 2000.0}, {"ripple": 0.1}])
def test_a_run_that_was_meant_to_be_dark_is_no_scan_however_its_bins_differ(uneven: dict[str, float]) -> None:
    """What couples into a bin is told with the bin; alone or beside a scan."""
    dark = run(2.0, **uneven, seed=3)
    beside = measured(run(2.0, direct=900.0), dark, known=KnownBefore(meant_dark=(False, True))).constants
    alone = measured(dark, known=KnownBefore(meant_dark=(True,))).constants
    for found in (beside, alone):
        assert found.dark_hz is not None
        assert abs(found.dark_hz.value - dark.total_count.mean()) < found.dark_hz.error
        assert found.dark_per_bin_hz is not None
        if hot := uneven.get("hot"):
            assert found.dark_per_bin_hz[HOT_BIN] == pytest.approx(hot + 2.0, rel=0.2)  # drawn to the others
    assert beside.geometry is not None
    assert abs(beside.geometry.wall_distance_m - 2.0) < 4 * beside.geometry_errors["wall_distance_m"]


@pytest.mark.parametrize("uneven", [{"hot": 20.0}, {"ripple": 0.1}])
def test_uneven_counts_without_a_wall_are_taken_for_no_scan_beside_one(uneven: dict[str, float]) -> None:
    with pytest.raises(InvalidData, match=r"run 2 of 2.*--dark"):
        measured(run(2.0, direct=900.0), run(2.0, **uneven, seed=3), known=KnownBefore())


def test_light_that_comes_from_a_wall_is_no_dark_whatever_was_meant() -> None:
    found = measured(run(2.0, direct=900.0), known=KnownBefore(meant_dark=(True,)))
    assert found.raw is not None
    assert found.constants.dark_hz is None


def test_several_scans_are_all_scans() -> None:
    found = measured(run(2.0, direct=900.0), run(2.0, direct=300.0, seed=5), known=KnownBefore())
    assert found.raw is not None
    assert len(found.raw.counts) == 2 * SIDE**2


def test_clicks_that_the_dead_time_took_belong_to_the_dark_rate() -> None:
    """A detector that is blind for 77 ns after each click sees n / (1 + n 77 ns) of n photons a second."""
    photons_hz = 400e3
    clicks_hz = photons_hz / (1 + photons_hz * 77e-9)
    found = measured(run(clicks_hz * WIDTH_S * PULSES, seed=3), known=KnownBefore(Quantity(77e-9, 0.0))).constants
    assert found.dark_hz is not None
    assert abs(found.dark_hz.value - photons_hz) < 4 * found.dark_hz.error
    assert found.dark_hz.error < 0.002 * photons_hz
    assert found.dark_per_bin_hz is not None
    assert found.dark_per_bin_hz.mean() == pytest.approx(photons_hz * WIDTH_S / PERIOD_S, rel=0.01)


def test_more_clicks_than_the_dead_time_leaves_time_for_are_refused() -> None:
    with pytest.raises(InvalidData, match="more than there was time for"):
        measured(run(4e6 * WIDTH_S * PULSES), known=KnownBefore(Quantity(300e-9, 0.0)))
