"""y-tal itself reads our y-tal export - same counts, confocal, time in metres of path - and its solver focuses it."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nlos.__main__ import run as cli
from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.importers.ytal import read_ytal
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid

# y-tal's typing package asks for names that NumPy 2 dropped; they are put back in the process that imports it.
BEFORE_NUMPY_2 = """
import sys, numpy as np
for old, new in {"bool8": "bool_", "object0": "object_", "int0": "intp", "uint0": "uintp", "void0": "void",
                 "bytes0": "bytes_", "str0": "str_", "float_": "float64", "complex_": "complex128",
                 "string_": "bytes_", "unicode_": "str_", "singlecomplex": "complex64", "cfloat": "complex128",
                 "clongfloat": "clongdouble", "longcomplex": "clongdouble", "longfloat": "longdouble"}.items():
    if not hasattr(np, old):
        setattr(np, old, getattr(np, new))
"""
READ = """
from tal.io import read_capture, write_capture
capture = read_capture(sys.argv[1])
np.savez(sys.argv[2], H=capture.H, grid=capture.sensor_grid_xyz, delta_t=capture.delta_t, t_start=capture.t_start,
         confocal=capture.is_confocal(), kind=capture.H_format.name)
write_capture(sys.argv[3] + "/again.hdf5", capture)
for name in ("laser", "sensor"):
    for what in ("xyz", "normals"):
        setattr(capture, f"{name}_grid_{what}", getattr(capture, f"{name}_grid_{what}")[::-1])
write_capture(sys.argv[3] + "/turned.hdf5", capture)  # whose scene_info nobody turned
for name in ("laser", "sensor"):
    for what in ("xyz", "normals"):
        setattr(capture, f"{name}_grid_{what}", getattr(capture, f"{name}_grid_{what}")[:, :2])
capture.H = capture.H[:, :, :2]
write_capture(sys.argv[3] + "/cut.hdf5", capture)
"""

# Its back-projection with its phasor-field filter, every second point, around either letter of the demo's scene.
SOLVE = """
import tal
from tal.enums import CameraSystem, VolumeFormat
from tal.reconstruct import bp, filter_H
tal.set_resources(1)
capture = tal.io.read_capture(sys.argv[1])
capture.H = capture.H[:, ::2, ::2]
for name in ("laser", "sensor"):
    for what in ("xyz", "normals"):
        setattr(capture, f"{name}_grid_{what}", getattr(capture, f"{name}_grid_{what}")[::2, ::2])
capture.H = filter_H(capture, "pf", wl_mean=0.12, wl_sigma=0.12)
depths = np.arange(0.5, 1.3, 0.01)
for x in (-0.22, 0.22):
    axes = x + np.linspace(-0.15, 0.15, 7), np.linspace(-0.2, 0.2, 9), depths
    volume = np.stack(np.meshgrid(*axes, indexing="ij"), -1).astype(np.float32)
    light = np.abs(bp.solve(capture, volume, VolumeFormat.X_Y_Z_3, CameraSystem.DIRECT_LIGHT, progress=False))
    print("depth", depths[light.max((0, 1)).argmax()])
"""
DEMO = """
wall: {width_m: 1.0, height_m: 1.0, rows: 32, cols: 32}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""


def of_ytal(script: str, *arguments: str) -> str:
    """What a script prints in a process of its own."""
    command = [sys.executable, "-c", BEFORE_NUMPY_2 + script, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=240)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_its_solver_finds_the_letters_of_the_demo_at_their_depths(tmp_path: Path) -> None:
    (tmp_path / "demo.yaml").write_text(DEMO)
    run = tmp_path / "demo.h5"
    assert cli(["scan", str(tmp_path / "demo.yaml"), "-o", str(run)]) == 0
    assert cli(["export", str(run), "--to", "ytal"]) == 0
    told = of_ytal(SOLVE, str(run.with_suffix(".hdf5")))
    depths_m = [float(line.split()[1]) for line in told.splitlines() if line.startswith("depth")]
    assert depths_m == pytest.approx([0.63, 1.0], abs=0.02)


def test_ytal_reads_the_export(tmp_path: Path) -> None:
    wall = WallGrid(1.2, 0.9, 4, 3)
    counts = np.random.default_rng(1).poisson(3.0, (4, 3, 50)).astype(np.uint32)
    exposure_s = np.random.default_rng(2).uniform(1e-7, 1e-2, (4, 3))
    exposure_s[1, 2] = 0.0
    scan = ScanArrays(counts, exposure_s, wall.x_m(), wall.y_m(), wall, TimeAxis(50, 32e-12, 2e-9), falloff=2)
    assert not any("exposure" in left for left in write_ytal(scan, tmp_path / "scan.hdf5"))
    of_ytal(READ, str(tmp_path / "scan.hdf5"), str(tmp_path / "read.npz"), str(tmp_path))
    read = np.load(tmp_path / "read.npz")
    assert bool(read["confocal"])
    assert str(read["kind"]) == "T_Sx_Sy"
    assert float(read["delta_t"]) == np.float64(32e-12 * SPEED_OF_LIGHT_M_PER_S)
    assert float(read["t_start"]) == np.float64(2e-9 * SPEED_OF_LIGHT_M_PER_S)
    top_left = read["H"][:, 0, -1]
    assert np.array_equal(top_left, counts[0, 0])
    assert tuple(read["grid"][0, -1]) == (wall.x_m()[0], wall.y_m()[0], 0.0)
    for name in ("scan", "again"):  # as exported, and as y-tal has written it again
        back = read_ytal(tmp_path / f"{name}.hdf5")
        assert np.allclose(back.held.exposure_s, exposure_s, atol=1e-12)
        assert (back.rectified, back.falloff) == (False, 2)
    for name in ("turned", "cut"):  # nobody knows then which exposure is whose
        back = read_ytal(tmp_path / f"{name}.hdf5")
        assert (back.held.exposure_s == 1).all()
        assert any("assuming 1 s" in note for note in back.notes)
        assert (back.rectified, back.falloff) == (False, 2)
