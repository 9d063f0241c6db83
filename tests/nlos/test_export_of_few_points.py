"""Where few points tell the scanner's place, an export says how well."""

import re
from pathlib import Path

import h5py
import numpy as np

from tests.command import nlos


def test_the_place_of_the_scanner_is_told_with_how_well_it_is_known(tmp_path: Path) -> None:
    """Of 25 points their times tell the distance to some centimetres only: 4.7 cm off, where 2 m are true."""
    nlos(tmp_path, "scan", "five_by_five", "-o", "run.h5", check=True)
    done = nlos(tmp_path, "export", "run.h5", "--to", "ytal", "-o", "run.hdf5", check=True)
    found = re.search(r"which tell it to ([\d.]+), ([\d.]+), ([\d.]+) mm", done.stdout + done.stderr)
    assert found is not None
    known_m = 1e-3 * np.array([float(each) for each in found.groups()])
    with h5py.File(tmp_path / "run.hdf5") as file:
        off_m = np.abs(np.asarray(file["sensor_xyz"]) - (0.0, 0.0, 2.0))
    assert (off_m < known_m).all()
    assert known_m[2] < 0.2
