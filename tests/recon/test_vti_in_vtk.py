"""A .vti as VTK's own reader sees it: the brightest voxel where it is on the wall, in metres."""

from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.recon.export_vti import write_vti
from nlos.recon.volume import Reconstruction, Volume


def test_vtk_finds_the_brightest_voxel_at_its_place(tmp_path: Path) -> None:
    vtk = pytest.importorskip("vtk", reason="VTK is not installed")
    from vtk.util.numpy_support import vtk_to_numpy

    wall = WallGrid(2.0, 1.0, 4, 8)
    albedo = np.zeros((3, 4, 8), np.float32)
    albedo[2, 0, 1] = 5.0  # far, top, second from the left
    volume = Volume(albedo, np.array([0.5, 0.6, 0.7]), wall)
    made = Reconstruction(albedo.max(axis=0), np.full((4, 8), 0.6, np.float32), wall, "lct", 0.0, {}, volume)
    write_vti(tmp_path / "volume.vti", made)
    reader = vtk.vtkXMLImageDataReader()
    reader.SetFileName(str(tmp_path / "volume.vti"))
    reader.Update()
    image = reader.GetOutput()
    values = vtk_to_numpy(image.GetPointData().GetScalars())
    assert values.max() == 5.0
    assert image.GetPoint(int(values.argmax())) == pytest.approx((wall.x_m()[1], wall.y_m()[0], 0.7))
