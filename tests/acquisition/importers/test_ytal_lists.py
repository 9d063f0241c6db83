"""y-tal's lists of points (T_Si): each histogram stays with its point, whichever way the wall faces."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

BINS, DELTA_M, COUNT = 128, 0.01, 12
RNG = np.random.default_rng(4)
POINTS = np.c_[RNG.uniform(-0.5, 0.5, (COUNT, 2)), np.zeros(COUNT)]
COUNTS = RNG.poisson(1.0, (BINS, COUNT)).astype(np.float32)


def write(path: Path, **changes: Any) -> Path:
    """A confocal capture, rectified, as `tal.io.write_capture` lays it out."""
    held = {
        "H": COUNTS, "H_format": np.array([3], np.int32), "sensor_grid_xyz": POINTS, "laser_grid_xyz": POINTS,
        "sensor_xyz": np.array([0.0, 0.0, 1.0]), "laser_xyz": np.array([0.0, 0.0, 1.0]),
        "sensor_grid_normals": np.tile([0.0, 0.0, 1.0], (COUNT, 1)), "delta_t": DELTA_M, "t_start": 0.0,
        "t_accounts_first_and_last_bounces": False,
    }  # fmt: skip
    with h5py.File(path, "w") as file:
        for name, value in (held | changes).items():
            file[name] = value
    return path


@pytest.mark.parametrize("start_m", [0.0, 0.35])
def test_counts_and_places_are_those_of_the_file(tmp_path: Path, start_m: float) -> None:
    scan = read_any(write(tmp_path / "list.hdf5", t_start=start_m))
    assert scan.points is not None
    assert np.array_equal(scan.points.counts, COUNTS.T)
    assert np.array_equal(scan.points.x_m, POINTS[:, 0])
    assert np.array_equal(scan.points.y_m, POINTS[:, 1])
    assert scan.points.time.start_s == pytest.approx(start_m / SPEED_OF_LIGHT_M_PER_S)
    assert scan.rectified


def test_right_is_as_seen_from_the_scanner(tmp_path: Path) -> None:
    behind = np.array([0.0, 0.0, -1.0])
    scan = read_any(write(tmp_path / "list.hdf5", sensor_xyz=behind, laser_xyz=behind))
    assert scan.points is not None
    assert np.array_equal(scan.points.x_m, -POINTS[:, 0])
    assert any("right is -x" in note for note in scan.notes)


def test_ways_to_the_scanner_are_taken_off(tmp_path: Path) -> None:
    """Of a photon each whose path on the hidden side is as long at every point: to a bin."""
    ways = 2 * np.linalg.norm(POINTS - [0.0, 0.0, 1.0], axis=1)
    counts = np.zeros((512, COUNT), np.float32)
    counts[np.floor((0.8 + ways) / DELTA_M).astype(int), np.arange(COUNT)] = 5
    scan = read_any(write(tmp_path / "list.hdf5", H=counts, t_accounts_first_and_last_bounces=True))
    assert scan.points is not None
    assert np.abs(scan.points.counts @ (np.arange(512) + 0.5) / 5 * DELTA_M - 0.8).max() <= DELTA_M
    assert scan.points.counts.sum() == pytest.approx(5 * COUNT)


def test_one_laser_point_is_taken_for_its_midpoints(tmp_path: Path) -> None:
    scan = read_any(write(tmp_path / "list.hdf5", laser_grid_xyz=np.array([[0.1, 0.2, 0.0]])))
    assert scan.points is not None
    assert np.ptp(scan.points.x_m) == pytest.approx(np.ptp(POINTS[:, 0]) / 2)
    assert any("normal moveout" in note for note in scan.notes)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"laser_grid_xyz": POINTS[:3]}, r"12 histograms, \(3, 3\) laser and \(12, 3\) sensor points"),
        ({"sensor_grid_xyz": POINTS * np.nan}, "not finite"),
        ({"sensor_grid_xyz": POINTS + np.array([0.0, 0.0, 0.1])}, "not in one plane z = const.*laser_m and sensor_m"),
        ({"H": np.ones((4, 3, 5))}, "H: has 3 dimensions"),
        ({"H_format": np.nan}, "H_format is nan"),
        (
            {"t_accounts_first_and_last_bounces": True, "laser_xyz": np.array([0.0, np.nan, 1.0])},
            "laser_xyz or sensor_xyz is not finite",
        ),
    ],
)
def test_lists_that_make_no_scan_are_refused_by_name(tmp_path: Path, changes: dict[str, Any], named: str) -> None:
    with pytest.raises(InvalidData, match=named):
        read_any(write(tmp_path / "odd.hdf5", **changes))
