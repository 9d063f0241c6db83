import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nlos.acquisition.planning.aim import Aim
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import DirectTimes, Spots, fit_geometry
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath, Misalignment

C = 299_792_458.0
TRUE = ScannerGeometry(2.03, 0.015, 0.04, -0.03, 1.013, 0.992, 0.006, -0.009, np.deg2rad(3), np.deg2rad(-4))
GRID = np.deg2rad(np.linspace(-20, 20, 9))
AX, AY = (a.ravel() for a in np.meshgrid(GRID, GRID))
tilts, shifts = st.floats(-0.3, 0.3), st.floats(-0.2, 0.2)


@given(tilts, tilts, shifts, shifts, st.floats(0, 0.05), st.floats(-0.4, 0.4), st.floats(-0.4, 0.4))
def test_the_model_is_the_simulated_benchs_by_other_means(
    pitch: float, yaw: float, sx: float, sy: float, e: float, ax: float, ay: float
) -> None:
    off = Misalignment(
        scanner_x_m=sx, scanner_y_m=sy, wall_pitch_deg=np.rad2deg(pitch), wall_yaw_deg=np.rad2deg(yaw), x_gain=1.02
    )
    spot = BeamPath(2.0, e, off).spot(MirrorAngles(ax, ay))
    assert spot is not None
    geometry = ScannerGeometry(2.0, e, sx, sy, 1.02, wall_pitch_rad=pitch, wall_yaw_rad=yaw)
    assert np.allclose(geometry.spots(ax, ay), (spot.x_m, spot.y_m, spot.range_m), atol=1e-12)
    assert geometry.ranges_m(ax, ay) == pytest.approx(spot.range_m, abs=1e-12)


@given(st.floats(-1, 1), st.floats(-1, 1), tilts, tilts)
def test_the_corrected_aim_hits_the_point(x: float, y: float, pitch: float, yaw: float) -> None:
    geometry = dataclasses.replace(TRUE, wall_pitch_rad=pitch, wall_yaw_rad=yaw)
    ax, ay = geometry.angles_rad(np.array([x]), np.array([y]))
    hit_x, hit_y, _ = geometry.spots(ax, ay)
    assert np.hypot(hit_x - x, hit_y - y)[0] < 1e-8


def test_a_square_wall_is_aimed_at_as_the_plan_does() -> None:
    assert np.allclose(ScannerGeometry(2.0, 0.02).angles_rad(0.8, -0.6), Aim(2.0, 0.02).angles_rad(0.8, -0.6))


def test_a_point_out_of_reach_is_named() -> None:
    with pytest.raises(InvalidData, match=r"wall point 1 at \(\+90\.000 m"):
        TRUE.angles_rad(np.array([0.0, 90.0]), np.array([0.0, 0.0]))


def test_direct_times_tell_distance_tilt_and_delay() -> None:
    random = np.random.default_rng(1)
    path = TRUE.spots(AX, AY)[2]
    arrival = 2 * path / C - 6e-9 + random.normal(0, 2e-12, len(AX))
    arrival[[3, 40]] += 1e-9
    start = dataclasses.replace(TRUE, wall_distance_m=2.0, wall_pitch_rad=0.0, wall_yaw_rad=0.0)
    fit = fit_geometry(start, DirectTimes(AX, AY, arrival, np.full(81, 2e-12)))
    for name, error in fit.errors.items():
        truth = -6e-9 if name == "delay_s" else getattr(TRUE, name)
        found = fit.delay_s if name == "delay_s" else getattr(fit.geometry, name)
        assert abs(found - truth) < 4 * error, name
    assert not fit.accepted[[3, 40]].any()
    assert fit.accepted.sum() > 75


def test_spots_and_times_tell_the_whole_geometry() -> None:
    random = np.random.default_rng(2)
    x, y, path = TRUE.spots(AX, AY)
    spots = np.column_stack([x, y]) + random.normal(0, 5e-4, (len(AX), 2))
    arrival = 2 * path / C - 6e-9 + random.normal(0, 1e-12, len(AX))
    start = ScannerGeometry(2.0, TRUE.mirror_separation_m)
    seen = slice(0, 81, 2)
    spots = Spots(AX[seen], AY[seen], *spots[seen].T, error_m=5e-4)
    fit = fit_geometry(start, DirectTimes(AX, AY, arrival, np.full(81, 1e-12)), spots)
    for name, error in fit.errors.items():
        truth = -6e-9 if name == "delay_s" else getattr(TRUE, name)
        found = fit.delay_s if name == "delay_s" else getattr(fit.geometry, name)
        assert abs(found - truth) < 4 * error, name
    assert np.sqrt((fit.spot_residual_m**2).mean()) < 6e-4


@pytest.mark.parametrize(("scatter_s", "as_stated"), [(2e-12, 1.0), (6e-12, 3.0)])
def test_errors_are_those_of_many_measurements(scatter_s: float, as_stated: float) -> None:
    """Whose scatter is as stated, 2 ps, or three times that."""
    random, path = np.random.default_rng(4), TRUE.spots(AX, AY)[2]
    start = dataclasses.replace(TRUE, wall_distance_m=2.0, wall_pitch_rad=0.0, wall_yaw_rad=0.0)
    found, errors = [], []
    for _ in range(40):
        arrival = 2 * path / C - 6e-9 + random.normal(0, scatter_s, len(AX))
        fit = fit_geometry(start, DirectTimes(AX, AY, arrival, np.full(81, 2e-12)))
        found.append([fit.geometry.wall_distance_m, fit.geometry.wall_pitch_rad, fit.geometry.wall_yaw_rad])
        errors.append([fit.errors[name] for name in ("wall_distance_m", "wall_pitch_rad", "wall_yaw_rad")])
    assert np.std(found, axis=0) == pytest.approx(np.mean(errors, axis=0), rel=0.3)
    exact = fit_geometry(start, DirectTimes(AX, AY, 2 * path / C, np.full(81, 2e-12)))
    assert np.mean(errors, axis=0)[0] == pytest.approx(as_stated * exact.errors["wall_distance_m"], rel=0.25)


def test_a_time_that_is_ten_errors_off_is_left_aside_and_one_of_two_is_not() -> None:
    arrival = 2 * TRUE.spots(AX, AY)[2] / C + np.random.default_rng(6).normal(0, 1e-12, 81).clip(-2e-12, 2e-12)
    arrival[7] += 20e-12
    fit = fit_geometry(TRUE, DirectTimes(AX, AY, arrival, np.full(81, 2e-12)))
    assert np.flatnonzero(~fit.accepted).tolist() == [7]
    arrival[7] -= 16e-12
    assert fit_geometry(TRUE, DirectTimes(AX, AY, arrival, np.full(81, 2e-12))).accepted.all()


def marked(wrong: int) -> Spots:
    """A spot for each of 81 directions, so many of them off by 5 cm along x."""
    x, y, _ = TRUE.spots(AX, AY)
    x = x + np.random.default_rng(8).normal(0, 3e-4, 81)
    x[3 : 3 + wrong] += np.resize([0.05, -0.05, 0.05], wrong)
    return Spots(AX, AY, x, y, error_m=1e-3)


def test_a_spot_that_is_off_along_x_counts_along_neither_axis() -> None:
    fit = fit_geometry(ScannerGeometry(2.03, TRUE.mirror_separation_m, wall_pitch_rad=TRUE.wall_pitch_rad,
                                       wall_yaw_rad=TRUE.wall_yaw_rad), spots=marked(2))  # fmt: skip
    assert np.flatnonzero(~fit.spots_accepted).tolist() == [3, 4]
    assert np.flatnonzero(~fit.counted).tolist() == [3, 4, 84, 85]


def test_where_more_than_a_quarter_is_off_nobody_knows_which_is_wrong() -> None:
    assert fit_geometry(TRUE, spots=marked(18)).spots_accepted.sum() == 63
    with pytest.raises(InvalidData, match=r"2[0-9] of 81 spots do not fit the others: spot 4, spot 5"):
        fit_geometry(TRUE, spots=marked(24))


def test_what_is_told_of_the_mirrors_is_kept_to() -> None:
    told = {"x_gain": 1e-4, "y_gain": 1e-4}
    fit = fit_geometry(TRUE, spots=marked(0), told=told)
    assert (fit.geometry.x_gain, fit.geometry.y_gain) == pytest.approx((1.0, 1.0), abs=2e-3)
    assert fit_geometry(TRUE, spots=marked(0)).geometry.x_gain == pytest.approx(TRUE.x_gain, abs=2e-3)


def test_nine_points_are_enough() -> None:
    some = slice(0, 81, 10)
    path = TRUE.spots(AX[some], AY[some])[2]
    fit = fit_geometry(
        TRUE, DirectTimes(AX[some], AY[some], 2 * path / C, np.full(9, 2e-12)), free=("wall_distance_m",)
    )
    assert fit.geometry.wall_distance_m == pytest.approx(TRUE.wall_distance_m, abs=1e-6)


def test_a_bump_shows_in_the_height_map() -> None:
    x, y, path = TRUE.spots(AX, AY)
    bump = (np.hypot(x - 0.3, y) < 0.1) * 0.02
    fit = fit_geometry(TRUE, DirectTimes(AX, AY, 2 * (path - bump / 0.95) / C - 6e-9, np.full(81, 1e-12)))
    assert np.abs(fit.height_m - bump)[bump == 0].max() < 1e-3
    assert fit.height_m[bump > 0] == pytest.approx(0.02, rel=0.12)


def test_too_few_and_degenerate_points_are_refused() -> None:
    with pytest.raises(InvalidData, match="needs nine"):
        fit_geometry(TRUE, DirectTimes(AX[:8], AY[:8], AX[:8], np.ones(8)))
    line = np.zeros(20)
    with pytest.raises(InvalidData, match="do not determine"):
        fit_geometry(TRUE, DirectTimes(np.linspace(-0.3, 0.3, 20), line, np.linspace(0, 1e-9, 20), np.full(20, 1e-12)))
