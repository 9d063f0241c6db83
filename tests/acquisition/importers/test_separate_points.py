"""Lists of laser and sensor points, on walls that need not be flat: plates whose light is summed up here, path by path,
are found where they are."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import nlos
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.imported import FreePoints
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

BINS, BIN_S, WIDTH_M = 320, 32e-12, 1.0
PLATES = ((-0.2, 0.15, 0.6), (0.2, -0.15, 0.9))
"""Centres of two plates of 0.2 x 0.2 m that face the wall."""


def points(count: int = 1024, apart_m: float = 0.0, hills_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Laser and sensor points (N, 3) all over a wall with a hill in it, as far apart as said in any direction."""
    rng = np.random.default_rng(5)
    middle, angle = rng.uniform(-WIDTH_M / 2, WIDTH_M / 2, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    aside = apart_m / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    both = []
    for at in (middle + aside, middle - aside):
        both.append(np.c_[at, hills_m * np.cos(np.pi * at[:, 0] / WIDTH_M)])
    return both[0], both[1]


def rendered(lasers: np.ndarray, sensors: np.ndarray, first_s: float = 0.0) -> np.ndarray:
    """Light (N, T) from laser points by the plates' pieces to sensor points."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-0.1, 0.1, 15)]))
    pieces = np.concatenate([np.stack([x + u, y + v, np.full_like(u, z)], axis=1) for x, y, z in PLATES])
    to, back = (np.linalg.norm(each[:, None] - pieces, axis=2) for each in (lasers, sensors))
    bins = ((to + back) / SPEED_OF_LIGHT_M_PER_S - first_s) / BIN_S
    counts = np.zeros((len(lasers), BINS))
    np.add.at(counts, (np.arange(len(lasers))[:, None], bins.astype(int)), pieces[:, 2] ** 4 / (to * back) ** 2)
    return counts


def saved(path: Path, counts: np.ndarray, **beside: Any) -> Path:
    np.savez(path, histograms=counts, bin_width_s=BIN_S, rectified=True, **beside)
    return path


def light_of(path: Path) -> FreePoints:
    held = read_any(path).points
    assert held is not None
    return held


def plates_found(held: FreePoints) -> list[float]:
    """The depth of the picture's brightest pixel within each plate."""
    picture = nlos.reconstruct(
        held.counts, points=(held.x_m, held.y_m), wall=(WIDTH_M, WIDTH_M), bin_width=held.time.bin_width_s, method="lct"
    )
    across, down = np.abs(picture.x_m - np.array(PLATES)[:, :1]), np.abs(picture.y_m - np.array(PLATES)[:, 1:2])
    inside = (across[:, None] < 0.1) & (down[..., None] < 0.1)  # (plates, H, W)
    dark = ((across[:, None] > 0.15) | (down[..., None] > 0.15)).all(axis=0)
    assert all(picture.albedo[plate].mean() > 4 * picture.albedo[dark].mean() for plate in inside)
    return [float(np.nanmedian(picture.depth_m[plate])) for plate in inside]


@pytest.mark.parametrize(("apart_m", "hills_m"), [(0.0, 0.0), (0.25, 0.0), (0.0, 0.12), (0.2, 0.1)])
def test_plates_are_where_they_are(tmp_path: Path, apart_m: float, hills_m: float) -> None:
    lasers, sensors = points(apart_m=apart_m, hills_m=hills_m)
    held = light_of(saved(tmp_path / "pairs.npz", rendered(lasers, sensors), laser_m=lasers, sensor_m=sensors))
    assert np.allclose(held.x_m, (lasers + sensors)[:, 0] / 2, atol=0.01)
    hills = (lasers + sensors)[:, 2] / 2
    plane_m = (hills.max() + hills.min()) / 2
    assert plates_found(held) == pytest.approx([z - plane_m for *_, z in PLATES], abs=0.012)


def test_a_laser_point_that_is_the_sensor_point_keeps_its_counts(tmp_path: Path) -> None:
    lasers, _ = points(count=64)
    counts = np.random.default_rng(0).poisson(1.0, (64, BINS))
    assert np.array_equal(light_of(saved(tmp_path / "one.npz", counts, laser_m=lasers, sensor_m=lasers)).counts, counts)


def test_a_wall_taken_for_flat_and_confocal_shows_them_elsewhere(tmp_path: Path) -> None:
    """So that the test above could fail."""
    lasers, sensors = points(apart_m=0.2, hills_m=0.1)
    x_m, y_m, _ = (lasers + sensors).T / 2
    held = light_of(saved(tmp_path / "flat.npz", rendered(lasers, sensors), x_m=x_m, y_m=y_m))
    with pytest.raises(AssertionError):
        assert plates_found(held) == pytest.approx([z - 0.05 for *_, z in PLATES], abs=0.012)


def test_one_point_stands_for_all_and_a_grid_for_a_list(tmp_path: Path) -> None:
    places = (np.arange(16) + 0.5) / 16 - 0.5
    grid = np.stack(np.meshgrid(places, -places), axis=2)  # (H, W, 2)
    sensors = np.concatenate([grid, np.zeros((16, 16, 1))], axis=2).reshape(-1, 3)
    laser = np.array([0.1, -0.1, 0.0])
    counts = rendered(np.broadcast_to(laser, sensors.shape), sensors)
    listed = light_of(saved(tmp_path / "list.npz", counts, laser_m=laser, sensor_m=sensors))
    cube, on_plane = counts.reshape(16, 16, BINS), {"laser_m": laser[:2], "sensor_m": grid}
    gridded = light_of(saved(tmp_path / "grid.npz", cube, **on_plane))
    savemat(tmp_path / "grid.mat", {"histograms": cube, "bin_width_s": BIN_S, "rectified": 1.0, **on_plane})
    for other in (gridded, light_of(tmp_path / "grid.mat")):
        assert np.allclose(other.counts, listed.counts)
        assert np.allclose(other.x_m, listed.x_m)
        assert np.allclose(other.y_m, listed.y_m)
    assert np.ptp(listed.x_m) == pytest.approx(np.ptp(places) / 2)


def test_records_that_begin_later_keep_their_last_light(tmp_path: Path) -> None:
    lasers, sensors = points(apart_m=0.1)
    whole = light_of(saved(tmp_path / "whole.npz", rendered(lasers, sensors), laser_m=lasers, sensor_m=sensors))
    begins_s = 100 * BIN_S
    late = rendered(lasers, sensors, begins_s)
    cut = light_of(saved(tmp_path / "late.npz", late, laser_m=lasers, sensor_m=sensors, offset_s=begins_s))
    assert np.allclose(cut.counts[:, :BINS], whole.counts)
    assert cut.counts.shape[1] == BINS + 100


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"x_m": np.zeros(1024)}, "x_m: laser_m and sensor_m say it already"),
        ({"rectified": False}, "count from the light's arrival at the laser point"),
        ({"sensor_m": np.zeros((1000, 3))}, r"sensor_m: has shape \(1000, 3\); \(1024, 3\) is expected"),
        ({"sensor_m": np.full((1024, 3), np.nan)}, "sensor_m: holds values that are no finite numbers"),
        ({"sensor_m": points()[0][:, [0, 2, 1]], "laser_m": points()[0][:, [0, 2, 1]]}, "turn the points so"),
    ],
)
def test_points_that_contradict_are_refused(tmp_path: Path, changes: dict[str, Any], named: str) -> None:
    lasers, sensors = points()
    beside = {"laser_m": lasers, "sensor_m": sensors, "rectified": True, "bin_width_s": BIN_S} | changes
    np.savez(tmp_path / "bad.npz", histograms=rendered(*points()), **beside)
    with pytest.raises(InvalidData, match=named):
        read_any(tmp_path / "bad.npz")
