"""Where few points tell the scanner's place, an export says how well."""

import re
from pathlib import Path

import h5py
import numpy as np

from tests.command import nlos


def test_the_place_of_the_scanner_is_told_with_how_well_it_is_known(tmp_path: Path) -> None:
    """Of 25 points the distance is known to some centimetres if a time is true to a bin. It is far truer."""
    nlos(tmp_path, "scan", "five_by_five", "-o", "run.h5", check=True)
    done = nlos(tmp_path, "export", "run.h5", "--to", "ytal", "-o", "run.hdf5", check=True)
    found = re.search(r"which tell it to ([\d.]+), ([\d.]+), ([\d.]+) mm", done.stdout + done.stderr)
    assert found is not None
    known_m = 1e-3 * np.array([float(each) for each in found.groups()])
    with h5py.File(tmp_path / "run.hdf5") as file:
        off_m = np.abs(np.asarray(file["sensor_xyz"]) - (0.0, 0.0, 2.0))
    assert (off_m < known_m).all()
    assert off_m[2] < 5e-3 < known_m[2] < 0.2
    nlos(tmp_path, "export", "run.h5", "--to", "npz", "-o", "run.npz", check=True)
    held = dict(np.load(tmp_path / "run.npz"))
    row, col = np.nonzero(held["exposure_s"])
    places = {"x_m": held["x_m"][col], "y_m": held["y_m"][row], "exposure_s": held["exposure_s"][row, col]}
    np.savez(tmp_path / "free.npz", **(held | places | {"histograms": held["histograms"][row, col]}))
    nlos(tmp_path, "export", "free.npz", "--to", "ytal", "-o", "free.hdf5", check=True)
    with h5py.File(tmp_path / "free.hdf5") as file:
        assert file["H"].shape[1] == len(row)
        assert np.array_equal(np.asarray(file["sensor_grid_xyz"])[:, 0], places["x_m"])
        assert (np.abs(np.asarray(file["sensor_xyz"]) - (0.0, 0.0, 2.0)) < known_m).all()
