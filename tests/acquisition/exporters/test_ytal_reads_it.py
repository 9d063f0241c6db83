"""y-tal itself reads our y-tal export: same counts, confocal, time in metres of path."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid

# y-tal's typing package asks for names that NumPy 2 dropped; they are put back in the process that imports it.
READ = """
import sys, numpy as np
for old, new in {"bool8": "bool_", "object0": "object_", "int0": "intp", "uint0": "uintp", "void0": "void",
                 "bytes0": "bytes_", "str0": "str_", "float_": "float64", "complex_": "complex128",
                 "string_": "bytes_", "unicode_": "str_", "singlecomplex": "complex64", "cfloat": "complex128",
                 "clongfloat": "clongdouble", "longcomplex": "clongdouble", "longfloat": "longdouble"}.items():
    if not hasattr(np, old):
        setattr(np, old, getattr(np, new))
from tal.io import read_capture
capture = read_capture(sys.argv[1])
np.savez(sys.argv[2], H=capture.H, grid=capture.sensor_grid_xyz, delta_t=capture.delta_t, t_start=capture.t_start,
         confocal=capture.is_confocal(), kind=capture.H_format.name)
"""


def test_ytal_reads_the_export(tmp_path: Path) -> None:
    wall = WallGrid(1.2, 0.9, 4, 3)
    counts = np.random.default_rng(1).poisson(3.0, (4, 3, 50)).astype(np.uint32)
    scan = ScanArrays(counts, np.ones((4, 3)), wall.x_m(), wall.y_m(), wall, TimeAxis(50, 32e-12, 2e-9))
    write_ytal(scan, tmp_path / "scan.hdf5")
    arguments = [sys.executable, "-c", READ, str(tmp_path / "scan.hdf5"), str(tmp_path / "read.npz")]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    read = np.load(tmp_path / "read.npz")
    assert bool(read["confocal"])
    assert str(read["kind"]) == "T_Sx_Sy"
    assert float(read["delta_t"]) == np.float64(32e-12 * SPEED_OF_LIGHT_M_PER_S)
    assert float(read["t_start"]) == np.float64(2e-9 * SPEED_OF_LIGHT_M_PER_S)
    top_left = read["H"][:, 0, -1]
    assert np.array_equal(top_left, counts[0, 0])
    assert tuple(read["grid"][0, -1]) == (wall.x_m()[0], wall.y_m()[0], 0.0)
