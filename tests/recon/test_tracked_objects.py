"""Several objects of a film have tracks of their own, from where each appears to where it is gone."""

import numpy as np
import pytest

from nlos.recon.tracked_objects import tracked_objects

X_M, Y_M = np.linspace(-0.5, 0.5, 41), np.linspace(0.5, -0.5, 41)


def _film(
    *objects: tuple[float, float, float, float, float, range], frames: int = 12
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares of 0.12 m of (x, y, z, x and y velocity, when it is there), the nearer one in front."""
    time_s = np.arange(frames) * 0.1
    albedo, depth = np.zeros((frames, 41, 41)), np.full((frames, 41, 41), np.nan)
    across, down = np.meshgrid(X_M, Y_M)
    for x, y, z, vx, vy, there in sorted(objects, key=lambda each: -each[2]):
        for frame in there:
            here = (np.abs(across - x - vx * time_s[frame]) <= 0.0601) & (
                np.abs(down - y - vy * time_s[frame]) <= 0.0601
            )
            albedo[frame][here], depth[frame][here] = 1.0, z
    return albedo, depth, time_s


def test_two_objects_have_places_and_velocities_of_their_own() -> None:
    albedo, depth, time_s = _film((-0.3, 0.2, 0.7, 0.4, 0.0, range(12)), (0.3, -0.2, 0.9, -0.3, 0.1, range(12)))
    one, other = sorted(tracked_objects(albedo, depth, X_M, Y_M, time_s), key=lambda each: each["x_m"][0])
    assert one["x_m"] == pytest.approx(-0.3 + 0.4 * time_s, abs=0.015)
    assert other["y_m"] == pytest.approx(-0.2 + 0.1 * time_s, abs=0.015)
    assert one["z_m"] == pytest.approx(0.7)
    assert other["z_m"] == pytest.approx(0.9)
    for each, axis, true in ((one, "vx", 0.4), (one, "vy", 0.0), (other, "vx", -0.3), (other, "vy", 0.1)):
        assert np.nanmedian(each[f"{axis}_m_per_s"]) == pytest.approx(true, abs=0.03)
        assert (each[f"{axis}_error_m_per_s"] < 0.1).all()


def test_one_that_passes_in_front_of_the_other_stays_itself() -> None:
    """By their depths, where they cross in the picture."""
    albedo, depth, time_s = _film((-0.3, 0.0, 0.6, 0.6, 0.0, range(12)), (0.3, 0.1, 1.0, -0.6, 0.0, range(12)))
    found = tracked_objects(albedo, depth, X_M, Y_M, time_s)
    near = next(each for each in found if np.nanmedian(each["z_m"]) == pytest.approx(0.6))
    assert near["x_m"] == pytest.approx(-0.3 + 0.6 * time_s, abs=0.015)
    assert len(found) == 2


def test_what_appears_and_vanishes_is_there_for_as_long() -> None:
    albedo, depth, time_s = _film((-0.3, 0.2, 0.7, 0.2, 0.0, range(12)), (0.25, -0.2, 0.8, 0.0, 0.2, range(4, 9)))
    found = tracked_objects(albedo, depth, X_M, Y_M, time_s)
    assert len(found) == 2
    assert np.flatnonzero(np.isfinite(found[0]["x_m"])).tolist() == list(range(12))
    assert np.flatnonzero(np.isfinite(found[1]["x_m"])).tolist() == list(range(4, 9))


def test_specks_and_empty_frames_are_no_objects() -> None:
    albedo, depth, time_s = _film((-0.3, 0.2, 0.7, 0.2, 0.0, range(3, 12)))
    albedo[5, 38, 38], depth[5, 38, 38] = 0.9, 1.0
    found = tracked_objects(albedo, depth, X_M, Y_M, time_s)
    assert len(found) == 1
    assert np.isnan(found[0]["x_m"][:3]).all()
    assert tracked_objects(0 * albedo, np.full_like(depth, np.nan), X_M, Y_M, time_s) == []
