"""A track is where something drawn was, how large, and how fast, with errors that say how far off."""

import numpy as np
import pytest

from nlos.recon.local_lines import OF_A_PIXEL
from nlos.recon.track import COLUMNS, fitted, track

X_M, Y_M = np.linspace(-0.5, 0.5, 41), np.linspace(0.5, -0.5, 41)


def _covered(pixels: np.ndarray, centre: float, width: float) -> np.ndarray:
    """How much of each pixel a bar covers, so that it moves by less than one."""
    half = 0.0125
    upper, lower = np.minimum(pixels + half, centre + width / 2), np.maximum(pixels - half, centre - width / 2)
    covered: np.ndarray = np.clip((upper - lower) / (2 * half), 0, 1)
    return covered


def bars(time_s: np.ndarray, noise_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A bar of 0.2 x 0.1 m at (-0.2 + 0.3 t, 0.1 - 0.1 t, 0.8 + 0.2 t) m, off its path by chance."""
    rng = np.random.default_rng(3)
    albedo, depth = np.zeros((len(time_s), 41, 41)), np.full((len(time_s), 41, 41), np.nan)
    for frame, t in enumerate(time_s):
        x, y = np.array([-0.2 + 0.3 * t, 0.1 - 0.1 * t]) + rng.normal(0.0, 1.0, 2) * noise_m
        part = np.outer(_covered(Y_M, y, 0.1), _covered(X_M, x, 0.2))
        albedo[frame], depth[frame] = part, np.where(part > 0, 0.8 + 0.2 * t, np.nan)
    return albedo, depth


def test_a_bar_is_found_where_it_was_and_as_fast_as_it_moved() -> None:
    time_s = np.arange(8) * 0.1
    found = track(*bars(time_s), X_M, Y_M, time_s)
    assert tuple(found) == COLUMNS
    assert found["x_m"] == pytest.approx(-0.2 + 0.3 * time_s, abs=0.004)
    assert found["y_m"] == pytest.approx(0.1 - 0.1 * time_s, abs=0.004)
    assert found["z_m"] == pytest.approx(0.8 + 0.2 * time_s, abs=1e-6)
    assert found["width_m"] == pytest.approx(0.2, abs=0.02)
    assert found["height_m"] == pytest.approx(0.1, abs=0.02)
    for axis, true in (("vx", 0.3), ("vy", -0.1), ("vz", 0.2)):
        assert found[f"{axis}_m_per_s"] == pytest.approx(true, abs=0.03)


def test_errors_are_as_large_as_what_is_off() -> None:
    time_s = np.arange(60) * 0.01
    found = track(*bars(time_s, 0.02), X_M, Y_M, time_s)
    for axis, true in (("x", -0.2 + 0.3 * time_s), ("y", 0.1 - 0.1 * time_s)):
        assert np.median(found[f"{axis}_error_m"]) < 0.75 * 0.02  # several agree
        off = (found[f"{axis}_m"] - true) / found[f"{axis}_error_m"]
        assert float(np.sqrt((off**2).mean())) == pytest.approx(1.0, abs=0.3)
    off = (found["vx_m_per_s"] - 0.3) / found["vx_error_m_per_s"]
    assert 0.6 < float(np.sqrt((off**2).mean())) < 1.5
    wider = track(*bars(time_s, 0.02), X_M, Y_M, time_s, window=4)
    assert wider["vx_error_m_per_s"] == pytest.approx(2 * found["vx_error_m_per_s"])


def test_what_is_not_there_has_no_place_and_no_speed() -> None:
    time_s = np.arange(9) * 0.1
    albedo, depth = bars(time_s)
    albedo[:3], depth[:3] = 0.0, np.nan
    found = track(albedo, depth, X_M, Y_M, time_s)
    for column in ("x_m", "x_error_m", "width_m", "vx_m_per_s", "vx_error_m_per_s"):
        assert np.isnan(found[column]).tolist() == [True] * 3 + [False] * 6
    alone = track(albedo[:4], depth[:4], X_M, Y_M, time_s[:4])
    assert np.isfinite(alone["x_m"]).tolist() == [False, False, False, True]
    assert np.isnan(alone["vx_m_per_s"]).all()
    two = track(albedo[3:5], depth[3:5], X_M, Y_M, time_s[3:5])
    assert np.isfinite(two["x_m"]).all()
    assert np.isnan(two["vx_m_per_s"]).all()


def test_light_without_a_depth_is_not_the_object() -> None:
    time_s = np.arange(8) * 0.1
    albedo, depth = bars(time_s)
    alone = track(albedo, depth, X_M, Y_M, time_s)
    albedo[:, 2:5, 2:5] = 1.0
    for column, values in track(albedo, depth, X_M, Y_M, time_s).items():
        assert values == pytest.approx(alone[column]), column


def test_no_place_is_known_better_than_a_part_of_a_pixel() -> None:
    time_s = np.arange(8) * 0.1
    found = track(*bars(time_s), X_M, Y_M, time_s)
    for axis in "xyz":
        assert (found[f"{axis}_error_m"] >= OF_A_PIXEL * 0.025).all()


def test_speeds_are_off_by_as_much_as_their_errors_say() -> None:
    """Five frames a line, of which it takes two: what still stands by chance scatters about a speed of 0."""
    time_s, rng = np.arange(1500) * 0.25, np.random.default_rng(7)
    albedo = np.stack([np.outer(_covered(Y_M, 0.0, 0.1), _covered(X_M, x, 0.2)) for x in rng.normal(0, 0.02, 1500)])
    found = track(albedo, np.full(albedo.shape, 0.8), X_M, Y_M, time_s)
    off = found["vx_m_per_s"] / found["vx_error_m_per_s"]
    assert float(np.sqrt((off**2).mean())) == pytest.approx(1.0, abs=0.12)


def test_a_line_ends_where_the_film_stood_still() -> None:
    """0.3 m/s, then nothing for ten seconds, then -0.3 m/s somewhere else."""
    time_s = np.concatenate([np.arange(6), 100 + np.arange(6)]) * 0.1
    albedo, depth = bars(np.concatenate([np.arange(6), np.arange(6)[::-1]]) * 0.1)
    assert track(albedo, depth, X_M, Y_M, time_s)["vx_m_per_s"] == pytest.approx([0.3] * 6 + [-0.3] * 6, abs=0.05)


@pytest.mark.parametrize(("pace_s", "frames"), [(1.0, 5), (0.2, 5), (0.13, 7), (0.1, 9), (0.01, 9)])
def test_a_speed_is_that_of_most_of_a_second(pace_s: float, frames: int) -> None:
    assert fitted(np.arange(20) * pace_s) == frames
    assert fitted(np.zeros(1)) == 5
