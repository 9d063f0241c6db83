"""y-tal and Zaragoza captures arrive upright, with time in seconds and the scanner's paths as offsets."""

from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.ytal import read_ytal
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

X, Y, T = 4, 3, 6


def points() -> np.ndarray:
    """A grid indexed [x, y], as y-tal's renderer makes it: x rising, y rising."""
    x, y = np.meshgrid(np.linspace(-0.75, 0.75, X), np.linspace(-0.5, 0.5, Y), indexing="ij")
    return np.stack([x, y, np.zeros_like(x)], axis=2)


def write(path: Path, **changes: object) -> Path:
    data = np.zeros((T, X, Y), np.float32)
    data[2, 3, 2] = 1.0  # rightmost column, top row
    values = {
        "H": data,
        "H_format": np.array([1], np.int32),
        "sensor_grid_xyz": points(),
        "laser_grid_xyz": points(),
        "sensor_xyz": np.array([0.0, 0.0, 1.0]),
        "laser_xyz": np.array([0.0, 0.0, 1.0]),
        "delta_t": 0.003,
        "t_start": 0.0,
        "t_accounts_first_and_last_bounces": False,
        **changes,
    }
    with h5py.File(path, "w") as file:
        for key, value in values.items():
            file[key] = value
    return path


@pytest.mark.parametrize("said", [5, np.arange(3), np.bytes_(b"original_format: ["), np.bytes_(b"- original_format")])
def test_what_others_keep_as_scene_info_is_theirs(tmp_path: Path, said: object) -> None:
    scan = read_any(write(tmp_path / "capture.hdf5", scene_info=said))
    assert scan.transient.counts[2, 0, 3] == 1.0
    assert scan.wall_known


def test_the_picture_is_upright_and_time_is_in_seconds(tmp_path: Path) -> None:
    scan = read_any(write(tmp_path / "capture.hdf5"))
    assert scan.transient.counts[2, 0, 3] == 1.0
    assert scan.transient.time.bin_width_s == pytest.approx(0.003 / SPEED_OF_LIGHT_M_PER_S)
    assert (scan.transient.wall.width_m, scan.transient.wall.height_m) == (pytest.approx(2.0), pytest.approx(1.5))
    assert scan.rectified


def test_paths_to_the_scanner_become_offsets(tmp_path: Path) -> None:
    scan = read_ytal(write(tmp_path / "capture.hdf5", t_accounts_first_and_last_bounces=True, t_start=0.6))
    assert scan.time_offset_bins is not None
    corner = 2 * np.sqrt(0.75**2 + 0.5**2 + 1.0) - 0.6
    assert scan.time_offset_bins[0, 0] == pytest.approx(corner / 0.003)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"H_format": np.array([4], np.int32)}, "H_format is 4"),
        ({"laser_grid_xyz": points() + 0.5}, "confocal"),
        ({"delta_t": 0.0}, "delta_t"),
        ({"H": np.zeros((T, X, Y + 1))}, "grid of shape"),
        ({"sensor_grid_xyz": points() ** 3, "laser_grid_xyz": points() ** 3}, "regular grid"),
        ({"t_start": h5py.Empty(float)}, "t_start"),
    ],
)
def test_what_cannot_be_reconstructed_is_refused_by_name(tmp_path: Path, changes: dict, named: str) -> None:
    with pytest.raises(InvalidData, match=named):
        read_ytal(write(tmp_path / "capture.hdf5", **changes))


@pytest.mark.parametrize("sides", [(5, 4), (4, 4)])
@pytest.mark.parametrize("order", ["time before space", "space before time", "grid and space before time"])
def test_zaragoza_orders_are_all_read(tmp_path: Path, order: str, sides: tuple[int, int]) -> None:
    cols, rows = sides
    x, y = np.meshgrid(np.linspace(-0.75, 0.75, cols), np.linspace(-0.5, 0.5, rows), indexing="ij")
    first, grid = np.zeros((1, T, 2, cols, rows), np.float32), np.stack([x, y, np.zeros_like(x)])
    first[0, 2, 1, -1, 1] = 1.0  # colour, t, bounce, sx, sy: rightmost column, second row from below
    with h5py.File(tmp_path / "capture.hdf5", "w") as file:
        file["data"] = first if order == "time before space" else first.T
        file["cameraGridPositions"] = grid.T if order.startswith("grid") else grid
        file["deltaT"], file["t0"] = 0.003, 0.0
        file["laserPosition"] = file["cameraPosition"] = np.array([0.0, 0.0, 1.0])
    scan = read_any(tmp_path / "capture.hdf5")
    assert np.argwhere(scan.transient.counts).tolist() == [[2, rows - 2, cols - 1]]
    assert not scan.rectified


def test_a_polarised_capture_is_told_what_to_write(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match=r"H: has shape \(6, 4, 3, 4\): a polarised capture.*H\[\.\.\., 0\]"):
        read_any(write(tmp_path / "capture.hdf5", H=np.zeros((T, X, Y, 4), np.float32)))
