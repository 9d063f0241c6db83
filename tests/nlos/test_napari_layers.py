"""What napari is handed of a result: arrays where they are in metres, and a manifest that names a function there is."""

import importlib
import re
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.napari_layers import reader
from nlos.recon.results import write_reconstruction
from nlos.recon.volume import Reconstruction, Volume


def test_a_result_opens_with_its_axes_in_metres(tmp_path: Path) -> None:
    wall = WallGrid(2.0, 1.0, 4, 8)
    albedo = np.zeros((4, 8), np.float32)
    albedo[0, 0] = 1.0  # top left
    volume = Volume(np.stack([albedo, albedo, albedo]), np.array([0.5, 0.6, 0.7]), wall)
    made = Reconstruction(albedo, np.full((4, 8), 0.6, np.float32), wall, "lct", 0.0, {}, volume)
    write_reconstruction(tmp_path / "reconstruction.h5", made)
    read = reader(str(tmp_path / "reconstruction.h5"))
    assert read is not None
    front, depth, solid = read(str(tmp_path / "reconstruction.h5"))
    assert [kind for _, _, kind in (front, depth, solid)] == ["image"] * 3
    for array, properties, _ in (front, solid):
        brightest = np.unravel_index(int(np.argmax(array)), array.shape)
        at = [s * k + t for s, k, t in zip(properties["scale"], brightest, properties["translate"], strict=True)]
        assert at[-2:] == pytest.approx([-0.375, -0.875])  # y = +0.375 m is above: napari's y grows downwards
        assert (properties["axis_labels"][-2:], set(properties["units"])) == (("-y", "x"), {"m"})
        assert len(properties["axis_labels"]) == len(properties["units"]) == array.ndim
    assert solid[1]["translate"][0] == pytest.approx(0.5)
    assert solid[1]["scale"][0] == pytest.approx(0.1)


def test_other_files_are_left_to_other_readers(tmp_path: Path) -> None:
    assert reader(str(tmp_path / "run.h5")) is None
    assert reader([str(tmp_path / "reconstruction.h5")]) is None


def test_the_manifest_is_declared_and_names_what_there_is() -> None:
    declared = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))
    module, _, name = declared["project"]["entry-points"]["napari.manifest"]["nlos"].partition(":")
    text = (Path(importlib.import_module(module).__file__ or "").parent / name).read_text("utf-8")
    assert f"python_name: {reader.__module__}:{reader.__name__}" in text
    (pattern,) = re.findall(r'filename_patterns: \["(.*)"\]', text)
    assert fnmatch("/home/somebody/out/reconstruction.h5", pattern)  # npe2 matches whole paths


def test_napari_itself_opens_a_result_by_the_plug_in(tmp_path: Path) -> None:
    pytest.importorskip("napari", reason="napari is not installed")
    from napari.components import ViewerModel
    from npe2 import PluginManager

    PluginManager.instance().discover()
    wall = WallGrid(2.0, 1.0, 4, 8)
    albedo = np.ones((4, 8), np.float32)
    volume = Volume(np.stack([albedo] * 3), np.array([0.5, 0.6, 0.7]), wall)
    made = Reconstruction(albedo, np.full((4, 8), 0.6, np.float32), wall, "lct", 0.0, {}, volume)
    write_reconstruction(tmp_path / "reconstruction.h5", made)
    viewer = ViewerModel()
    front, depth, solid = viewer.open(str(tmp_path / "reconstruction.h5"), plugin="nlos")
    assert [layer.name for layer in (front, depth, solid)] == ["LCT front view", "LCT depth (m)", "LCT volume"]
    assert list(solid.translate) == pytest.approx([0.5, -0.375, -0.875])
    assert list(solid.scale) == pytest.approx([0.1, 0.25, 0.25])
    assert [(low, high) for low, high, _ in viewer.dims.range] == [
        (pytest.approx(0.5), pytest.approx(0.7)), (pytest.approx(-0.375), pytest.approx(0.375)),
        (pytest.approx(-0.875), pytest.approx(0.875)),
    ]  # fmt: skip
    assert solid.axis_labels == ("z", "-y", "x")
    assert [str(unit) for unit in solid.units] == ["meter"] * 3
