"""Captures whose wall faces anywhere, with direct light or without: what is hidden is where it was put."""

from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

import nlos
from nlos.__main__ import run
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.ytal import read_ytal
from nlos.loaded import load_scan
from tests.acquisition.exporters.test_ytal_reads_it import of_ytal

COLS, ROWS, BINS, DELTA_M = 20, 12, 700, 0.006
SPOT_M, SCANNER_M = (0.18, 0.12, 0.55), (0.1, -0.05, 0.9)
"""To the right, up, and off the wall, for who looks at it."""
LIGHT_M_PER_S = 299_792_458.0

# Rows of these are what is right, up and off the wall in the file's own axes.
WALLS = {
    "z, scene in front": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "z, scene behind": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    "y, z is up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "y, scene behind": ((-1, 0, 0), (0, 0, 1), (0, 1, 0)),
    "x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "turned by 30 degrees": ((np.cos(np.pi / 6), 0, -0.5), (0, 1, 0), (0.5, 0, np.cos(np.pi / 6))),
}

WRITE = """
import tal
from tal.io.capture_data import NLOSCaptureData
from tal.enums import GridFormat, HFormat
made = np.load(sys.argv[1])
capture = NLOSCaptureData()
capture.H, capture.H_format = made["H"], HFormat.T_Sx_Sy
capture.sensor_grid_xyz = capture.laser_grid_xyz = made["grid"]
capture.sensor_grid_normals = capture.laser_grid_normals = made["normals"]
capture.sensor_grid_format = capture.laser_grid_format = GridFormat.X_Y_3
capture.sensor_xyz = capture.laser_xyz = made["scanner"]
capture.delta_t, capture.t_start, capture.t_accounts_first_and_last_bounces = float(made["delta"]), 0.0, True
capture.scene_info = {}
tal.io.write_capture(sys.argv[2], capture)
"""


def drawn(direct: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Counts (X, Y, T) of a spot from points that rise to the right and up, and these (X, Y, 3) on the wall."""
    x, y = np.meshgrid((np.arange(COLS) - 9.5) * 0.05, (np.arange(ROWS) - 5.5) * 0.05, indexing="ij")
    points = np.stack([x, y, np.zeros_like(x)], axis=2)
    ends_m = 2 * np.linalg.norm(points - SCANNER_M, axis=2)
    way_m = ends_m + 2 * np.linalg.norm(points - SPOT_M, axis=2)
    counts = (np.arange(BINS) == np.floor(way_m / DELTA_M)[..., None]) * 900.0
    return counts + (np.arange(BINS) == np.floor(ends_m / DELTA_M)[..., None]) * direct, points


def is_found(scan: ImportedScan) -> None:
    """By distances r from the wall's points: r^2 is linear in the spot's place."""
    held, offsets = scan.transient, scan.time_offset_bins
    assert offsets is not None
    x, y = (axis.ravel() for axis in np.meshgrid(held.wall.x_m(), held.wall.y_m()))
    bins = (held.counts.argmax(axis=0) + 0.5 - offsets).ravel()
    r = (held.time.start_s + bins * held.time.bin_width_s) * LIGHT_M_PER_S / 2
    (twice_x, twice_y, whole), *_ = np.linalg.lstsq(np.c_[-x, -y, np.ones_like(x)], r**2 - x**2 - y**2)
    at = twice_x / 2, twice_y / 2, np.sqrt(whole - (twice_x**2 + twice_y**2) / 4)
    assert at == pytest.approx(SPOT_M, abs=0.006)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("wall", WALLS)
def test_what_ytal_writes_of_a_wall_that_faces_anywhere_is_not_mirrored(tmp_path: Path, wall: str) -> None:
    axes = np.array(WALLS[wall])
    counts, points = drawn()
    grid = points @ axes + (0.3, -0.2, 0.1)
    np.savez(tmp_path / "made.npz", H=np.moveaxis(counts, 2, 0), grid=grid, scanner=SCANNER_M @ axes + (0.3, -0.2, 0.1),
             normals=np.broadcast_to(axes[2].astype(float), grid.shape), delta=DELTA_M)  # fmt: skip
    of_ytal(WRITE, str(tmp_path / "made.npz"), str(tmp_path / "capture.hdf5"))
    scan = read_any(tmp_path / "capture.hdf5")
    is_found(scan)
    assert any("the wall faces" in note for note in scan.notes) == (wall != "z, scene in front")


def zaragoza(path: Path, *, matlab: bool, hidden: bool = True) -> Path:
    """As the dataset has it: the wall in y = 0, z up, the scene at y < 0, two bounces and one colour."""
    counts, points = drawn()
    axes = np.array(WALLS["y, z is up"])
    data = np.zeros((1, BINS, 2, COLS, ROWS), np.float32)  # colour, time, bounce, x, y
    data[0, :, 1] = np.moveaxis(counts, 2, 0)
    values = {
        "data": data[0] if matlab else data,
        "cameraGridPositions": np.moveaxis(points @ axes, 2, 0),
        "cameraGridNormals": np.moveaxis(np.broadcast_to(axes[2].astype(float), points.shape), 2, 0),
        "cameraPosition": (SCANNER_M @ axes)[:, None],
        "laserPosition": (SCANNER_M @ axes)[:, None],
        "deltaT": [[DELTA_M]],
        "t0": [[0.0]],
        "isConfocal": [[1]],
    }
    if hidden:
        values["hiddenVolumePosition"] = np.array([[0.0], [-0.5], [0.0]])
    with h5py.File(path, "w", userblock_size=512 if matlab else 0) as file:
        for key, value in values.items():
            file[key] = value
    return path


@pytest.mark.parametrize(("name", "matlab"), [("bunny.hdf5", False), ("bunny.mat", True)])
@pytest.mark.parametrize("hidden", [True, False])
def test_zaragozas_wall_stands_where_its_dataset_has_it(tmp_path: Path, name: str, matlab: bool, hidden: bool) -> None:
    is_found(read_any(zaragoza(tmp_path / name, matlab=matlab, hidden=hidden)))


def test_a_wall_of_which_no_side_is_known_is_refused(tmp_path: Path) -> None:
    path = zaragoza(tmp_path / "bunny.hdf5", matlab=False, hidden=False)
    with h5py.File(path, "r+") as file:
        del file["cameraGridNormals"]
        for who in ("camera", "laser"):
            file[f"{who}Position"][...] = 0.0
    with pytest.raises(InvalidData, match="on which side of it the scene is"):
        read_any(path)


def gated(folder: Path, direct: float) -> Path:
    """A measurement of f-k migration's authors' kind, with its times of flight beside it."""
    counts, points = drawn(direct)
    width_s = DELTA_M / LIGHT_M_PER_S
    picoseconds = 2e12 / LIGHT_M_PER_S * np.linalg.norm(points - SCANNER_M, axis=2)
    upright = counts.transpose(1, 0, 2)[::-1]
    savemat(folder / "meas_10min.mat", {"meas": upright, "bin_resolution": width_s, "wall_size": 1.0})
    savemat(folder / "tof.mat", {"tofgrid": picoseconds.T[::-1]})
    return folder / "meas_10min.mat"


def test_without_direct_light_the_files_geometry_says_when_light_is_at_the_wall(tmp_path: Path) -> None:
    path = gated(tmp_path, direct=0.0)
    scan = read_any(path)
    assert scan.no_direct_light
    is_found(scan)
    picture = nlos.reconstruct(nlos.load(path))
    row, col = np.unravel_index(np.nan_to_num(picture.albedo).argmax(), picture.albedo.shape)
    at = picture.x_m[col], picture.y_m[row], picture.depth_m[row, col]
    assert at == pytest.approx(SPOT_M, abs=0.03)


def test_direct_light_and_what_the_user_says_go_before_the_files_geometry(tmp_path: Path) -> None:
    assert not read_any(gated(tmp_path, direct=20_000.0)).no_direct_light
    path = gated(tmp_path, direct=0.0)
    told = read_any(path, Given(rectified=False))
    assert not told.no_direct_light
    assert not told.rectified


def test_an_import_keeps_that_there_is_no_direct_light(tmp_path: Path) -> None:
    path = gated(tmp_path, direct=0.0)
    assert run(["import", str(path), "-o", str(tmp_path / "run.h5")]) == 0
    assert load_scan(tmp_path / "run.h5").no_direct_light


def test_a_leaning_grid_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidData, match="right angle"):
        read_ytal(leaning(tmp_path / "capture.hdf5"))


def leaning(path: Path) -> Path:
    counts, points = drawn()
    points[..., 0] += points[..., 1]
    with h5py.File(path, "w") as file:
        file["H"], file["H_format"] = np.moveaxis(counts, 2, 0), np.array([1], np.int32)
        file["sensor_grid_xyz"] = file["laser_grid_xyz"] = points
        file["sensor_xyz"] = file["laser_xyz"] = np.array(SCANNER_M)
        file["delta_t"], file["t_start"], file["t_accounts_first_and_last_bounces"] = DELTA_M, 0.0, True
    return path
