"""Scans of separate laser and sensor points, their light's paths summed up here, become what a confocal scan of their
midpoints sees."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import nlos
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.moveout import moved_out

BINS, DELTA_M, WIDTH_M, DEPTH_M = 512, 0.01, 1.0, 0.6
SCANNER_M = np.array([0.2, -0.1, 1.5])
PLATES = ((-0.2, 0.15, DEPTH_M), (0.2, -0.15, DEPTH_M + 0.3))
"""Centres of two plates of 0.2 x 0.2 m that face the wall."""


def grid(points: int, width_m: float = WIDTH_M) -> np.ndarray:
    """As y-tal's renderer makes it: indexed [x, y], both rising."""
    places = (np.arange(points) + 0.5) / points * width_m - width_m / 2
    x, y = np.meshgrid(places, places, indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=2)


def rendered(lasers: np.ndarray, sensors: np.ndarray, first_m: np.ndarray | float = 0.0) -> np.ndarray:
    """Light (T, ...) from laser points (..., 3) by the plates' pieces to sensor points (..., 3), by the diffuse law."""
    u, v = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-0.1, 0.1, 15)]))
    pieces = np.concatenate([np.stack([x + u, y + v, np.full_like(u, z)], axis=1) for x, y, z in PLATES])
    lasers, sensors = np.broadcast_arrays(lasers, sensors)
    shape = lasers.shape[:-1]
    to, back = (np.linalg.norm(points.reshape(-1, 1, 3) - pieces, axis=2) for points in (lasers, sensors))
    light = pieces[:, 2] ** 4 / (to * back) ** 4
    path = to + back - np.broadcast_to(first_m, shape).reshape(-1, 1)
    counts = np.zeros((BINS, len(to)))
    np.add.at(counts, ((path / DELTA_M).astype(int), np.arange(len(to))[:, None]), light)
    return counts.reshape(BINS, *shape)


def write(path: Path, counts: np.ndarray, lasers: np.ndarray, sensors: np.ndarray, **changes: Any) -> Path:
    values = {
        "H": counts.astype(np.float32),
        "H_format": np.array([1 if counts.ndim == 3 else 2], np.int32),
        "sensor_grid_xyz": sensors, "laser_grid_xyz": lasers, "sensor_xyz": SCANNER_M, "laser_xyz": SCANNER_M,
        "delta_t": DELTA_M, "t_start": 0.0, "t_accounts_first_and_last_bounces": False, **changes,
    }  # fmt: skip
    with h5py.File(path, "w") as file:
        for key, value in values.items():
            file[key] = value
    return path


def picture(scan: ImportedScan) -> Any:
    held = scan.transient
    histograms = np.moveaxis(held.counts, 0, 2) / np.maximum(held.exposure_s, 1)[..., None]
    sides = held.wall.width_m, held.wall.height_m
    return nlos.reconstruct(histograms, wall=sides, bin_width=held.time.bin_width_s, method="lct")


def against_confocal(tmp_path: Path, scan: ImportedScan, points: np.ndarray) -> tuple[float, float]:
    """Correlation of the picture with that of a confocal scan of the same points, and how far its depths are off."""
    confocal = read_any(write(tmp_path / "confocal.hdf5", rendered(points, points), points, points))
    assert scan.transient.wall == confocal.transient.wall
    mine, truth = picture(scan), picture(confocal)
    bright = truth.albedo > 0.3 * truth.albedo.max()
    apart = np.abs(mine.depth_m - truth.depth_m)[bright]
    return float(np.corrcoef(mine.albedo.ravel(), truth.albedo.ravel())[0, 1]), float(np.nanmedian(apart))


def test_one_laser_point_is_a_confocal_scan_of_half_the_wall(tmp_path: Path) -> None:
    sensors, laser = grid(32), np.zeros((1, 1, 3))
    scan = read_any(write(tmp_path / "single.hdf5", rendered(laser, sensors), laser, sensors))
    assert scan.rectified
    assert scan.transient.wall.width_m == pytest.approx(WIDTH_M / 2)
    assert any("0.685 m apart" in note and "normal moveout" in note for note in scan.notes)
    alike, apart_m = against_confocal(tmp_path, scan, sensors / 2)
    assert alike > 0.97
    assert apart_m < 0.005


def test_every_pair_near_each_other_is_a_finer_confocal_scan(tmp_path: Path) -> None:
    points = grid(8)
    counts = rendered(points[:, :, None, None], points)
    scan = read_any(write(tmp_path / "exhaustive.hdf5", counts, points, points))
    fine = grid(15, WIDTH_M * 15 / 16)
    alike, apart_m = against_confocal(tmp_path, scan, fine)
    assert alike > 0.99
    assert apart_m < 0.002
    # Points two steps apart are skipped: those themselves, two neighbours either way round, two diagonals.
    pairs = np.ones((15, 15))
    pairs[1::2], pairs[:, 1::2] = 2, 2
    pairs[1::2, 1::2] = 4
    assert np.array_equal(scan.transient.exposure_s, pairs)


def test_the_ways_to_the_scanner_are_taken_off(tmp_path: Path) -> None:
    sensors, laser = grid(16), np.full((1, 1, 3), [0.1, 0.05, 0.0])
    plain = read_any(write(tmp_path / "plain.hdf5", rendered(laser, sensors), laser, sensors))
    ways = np.linalg.norm(laser - SCANNER_M, axis=2) + np.linalg.norm(sensors - SCANNER_M, axis=2)
    start_m = round(ways.min() / DELTA_M) * DELTA_M
    counts = rendered(laser, sensors, start_m - ways)
    said = {"t_start": start_m, "t_accounts_first_and_last_bounces": True}
    whole = read_any(write(tmp_path / "whole.hdf5", counts, laser, sensors, **said))
    assert np.corrcoef(plain.transient.counts.ravel(), whole.transient.counts.ravel())[0, 1] > 0.9
    mean = [np.average(np.arange(BINS), weights=each.transient.counts.sum(axis=(1, 2))) for each in (plain, whole)]
    assert mean[0] == pytest.approx(mean[1], abs=0.1)


def test_every_photon_goes_where_its_time_goes() -> None:
    counts = np.zeros(300)
    counts[[50, 120, 200]] = 100, 10, 1
    moved = moved_out(counts, 0.8, 0.0, DELTA_M)
    assert moved.sum() == pytest.approx(11)  # no light is faster than from one point to the other
    for at, count in ((120, 10), (200, 1)):
        first, last = (np.sqrt((bin_ * DELTA_M) ** 2 - 0.8**2) / DELTA_M for bin_ in (at, at + 1))
        assert moved[int(first) : int(last) + 1].sum() == pytest.approx(count)


@pytest.mark.parametrize("late", [0, 7, -7, BINS + 1])
def test_counts_of_one_point_are_the_same_counts(late: int) -> None:
    counts = np.random.default_rng(0).poisson(1.0, BINS)
    expected = np.zeros(BINS)
    for at, count in enumerate(counts):
        if 0 <= at + late < BINS:
            expected[at + late] = count
    for rounding in (0.0, 1e-10, -1e-10):
        assert np.array_equal(moved_out(counts, abs(rounding), late * DELTA_M + rounding, DELTA_M), expected)


@pytest.mark.parametrize(
    ("lasers", "changes", "named"),
    [
        (np.full((1, 1, 3), 0.3), {}, "not in one plane"),
        (np.zeros((2, 2, 3)), {}, "one laser point, or one for each sensor point"),
        (np.zeros((1, 1, 3)), {"H_format": np.array([4], np.int32)}, r"T_Li_Si.*Write its points as a grid"),
        (np.full((1, 1, 3), np.nan), {}, "not finite"),
    ],
)
def test_what_has_no_midpoints_is_refused_by_name(tmp_path: Path, lasers: np.ndarray, changes: Any, named: str) -> None:
    counts = np.ones((BINS, 8, 8))
    with pytest.raises(InvalidData, match=named):
        read_any(write(tmp_path / "odd.hdf5", counts, lasers, grid(8), **changes))


def test_grids_of_different_spacings_are_refused_by_name(tmp_path: Path) -> None:
    counts = np.ones((64, 4, 4, 8, 8))
    with pytest.raises(InvalidData, match=r"one laser point \(T_Sx_Sy\)"):
        read_any(write(tmp_path / "odd.hdf5", counts, grid(4), grid(8)))
    with pytest.raises(InvalidData, match="different spacings"):
        read_any(write(tmp_path / "odd.hdf5", counts[:, :, :, :4, :4], 0.5 * grid(4), grid(4)))


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_plain_arrays_with_places_of_both_are_not_taken_for_confocal(tmp_path: Path, suffix: str) -> None:
    path, arrays = tmp_path / f"both{suffix}", {"laser_xyz": np.zeros(3), "sensor_grid_xyz": grid(8)}
    if suffix == ".npz":
        np.savez(path, histograms=np.ones((8, 8, 64)), bin_width_s=32e-12, **arrays)
    else:
        with h5py.File(path, "w") as file:
            file["histograms"] = np.ones((8, 8, 64))
            file.attrs.update({"bin_width_s": 32e-12, "wall_size_m": 1.0})
            for name, values in arrays.items():
                file[name] = values
    with pytest.raises(InvalidData, match=r"both.*laser_xyz, sensor_grid_xyz.*HDF5_TAL"):
        read_any(path)
