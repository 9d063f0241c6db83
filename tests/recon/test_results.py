"""What is left behind can be read by others: HDF5 layout, pictures, PLY, VTI and the 3D view."""

import base64
import json
import re
import struct
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from matplotlib.image import imread

from nlos.acquisition.response import gaussian, measured
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData
from nlos.recon.export_mesh import write_glb, write_obj
from nlos.recon.export_ply import write_ply
from nlos.recon.export_vti import write_vti
from nlos.recon.front_view import depth_map, front_view
from nlos.recon.pictures import confidence_picture
from nlos.recon.results import read_reconstruction, write_reconstruction, write_results
from nlos.recon.slices_picture import slices_picture
from nlos.recon.small_print import small_print
from nlos.recon.view3d import write_view3d
from nlos.recon.volume import Intervals, Reconstruction, Volume, response_words

WALL = WallGrid(1.2, 0.8, 8, 12)
PLY_VERTEX = [("xyz", "<f4", 3), ("normal", "<f4", 3), ("albedo", "<f4"), ("grey", "u1", 3)]


@pytest.fixture
def made() -> Reconstruction:
    """One bright square, upper left, at 0.55 m; nothing elsewhere."""
    depths = 0.05 + 0.1 * np.arange(10)
    albedo = np.full((10, 8, 12), 1e-4, dtype=np.float32)
    albedo[5, 1:4, 2:6] = 1
    albedo[[4, 6], 1:4, 2:6] = 0.5
    volume = Volume(albedo, depths, WALL)
    confidence = np.ones((8, 12), dtype=np.float32)
    return Reconstruction(
        front_view(albedo), depth_map(albedo, depths), WALL, "lct", 0.5, {"snr": 0.1}, volume, None, confidence,
        points=96, photons=4000.5, scan="run.h5",
    )  # fmt: skip


def test_depth_lies_between_planes_where_the_light_does() -> None:
    depths = 0.3 + 0.01 * np.arange(60)
    for z in (0.4512, 0.4555, 0.4599):
        profile = np.exp(-0.5 * ((depths - z) / 0.012) ** 2).astype(np.float32)
        volume = Volume(np.broadcast_to(profile[:, None, None], (60, 4, 4)).copy(), depths, WallGrid(1, 1, 4, 4))
        assert np.allclose(depth_map(volume.albedo, volume.depths_m), z, atol=2e-4)


def test_nothing_seen_has_no_depth(made: Reconstruction) -> None:
    assert np.isfinite(made.depth_m).sum() == 12
    assert np.allclose(made.depth_m[1:4, 2:6], 0.55)
    rng = np.random.default_rng(0)
    noisy = rng.gamma(20, 0.01, (10, 8, 12)).astype(np.float32)
    noisy[5, 1:4, 2:6] = 2
    seen = np.isfinite(depth_map(noisy, 0.05 + 0.1 * np.arange(10)))
    assert seen[1:4, 2:6].all()
    assert seen.sum() < 12 + 84 / 5  # every pixel's noise is above a tenth of the bright square


def test_the_file_holds_what_its_layout_says(made: Reconstruction, tmp_path: Path) -> None:
    paths = write_results(tmp_path / "out", made, html=True)
    assert [path.name for path in paths] == [
        "reconstruction.h5", "albedo.png", "depth.png", "slices.png", "view3d.html",
    ]  # fmt: skip
    with h5py.File(paths[0]) as file:
        assert {name: file[name].shape for name in file} == {
            "albedo": (8, 12), "depth_m": (8, 12), "confidence": (8, 12), "volume": (10, 8, 12), "depths_m": (10,),
            "x_m": (12,), "y_m": (8,),
        }  # fmt: skip
        assert file.attrs["method"] == "lct"
        assert json.loads(file.attrs["settings"]) == {"snr": 0.1}
        assert file["y_m"][0] > file["y_m"][-1]
        assert file["x_m"][0] < file["x_m"][-1]
        assert "torch" in file.attrs["software"]
    again = read_reconstruction(paths[0])
    assert (again.scan, again.points, again.photons) == ("run.h5", 96, 4000.5)
    assert np.array_equal(again.albedo, made.albedo)
    assert np.array_equal(again.depth_m, made.depth_m, equal_nan=True)
    assert again.volume is not None
    assert again.confidence is not None
    assert all(imread(path).std() > 0 for path in paths[1:4])


@pytest.mark.parametrize("used", [True, False])
@pytest.mark.parametrize("older", [False, True])
def test_the_response_that_a_picture_was_made_with_is_read_back(
    made: Reconstruction, tmp_path: Path, used: bool, older: bool
) -> None:
    """Also from a file of before its curve was kept."""
    curve = measured([0.0, 1.0, 5.0, 3.0, 2.0, 1.0, 0.5, 0.0], 50e-12, "the scan's own direct peak", zero=1.75)
    told = replace(made, response=curve, response_used=used)
    path = tmp_path / "reconstruction.h5"
    write_reconstruction(path, told)
    if older:
        with h5py.File(path, "r+") as file:
            del file["response_shares"], file.attrs["response_used"]
    again = read_reconstruction(path)
    assert response_words(again) == response_words(told)
    assert again.response_used is used
    assert again.response is not None
    assert again.response.source == curve.source
    if not older:
        assert again.response.shares == pytest.approx(curve.shares, rel=1e-6)
        assert (again.response.step_s, again.response.zero) == (curve.step_s, curve.zero)
        with h5py.File(path, "r+") as file:
            file["response_shares"][2] = np.nan
        with pytest.raises(InvalidData, match=r"reconstruction\.h5 is not a reconstruction: the response .*finite"):
            read_reconstruction(path)
    write_reconstruction(path, made)
    assert response_words(read_reconstruction(path)) == "none known"


def test_nothing_is_overwritten_unasked_and_the_volume_may_stay_away(made: Reconstruction, tmp_path: Path) -> None:
    write_results(tmp_path, made, keep_volume=False)
    with h5py.File(tmp_path / "reconstruction.h5") as file:
        assert "volume" not in file
    with pytest.raises(FileExistsError, match="--overwrite"):
        write_results(tmp_path, made)
    write_results(tmp_path, made, overwrite=True)


def test_a_wall_measured_here_and_there_has_a_picture_of_that(made: Reconstruction, tmp_path: Path) -> None:
    uneven = np.ones((8, 12), dtype=np.float32)
    uneven[:, 6:] = 0.1
    paths = write_results(tmp_path, replace(made, confidence=uneven))
    assert tmp_path / "confidence.png" in paths
    assert imread(tmp_path / "confidence.png").std() > 0
    write_results(tmp_path, made, overwrite=True, keep_volume=False)
    assert not (tmp_path / "confidence.png").exists()  # nothing of another result stays beside this one
    assert not (tmp_path / "slices.png").exists()
    with pytest.raises(InvalidData, match="how well the wall was measured"):
        confidence_picture(replace(made, confidence=None), tmp_path / "c.png")


def test_a_file_that_is_no_reconstruction_is_refused(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["histograms"] = np.zeros((2, 2, 2))
    with pytest.raises(InvalidData, match="is not a reconstruction"):
        read_reconstruction(tmp_path / "other.h5")


def test_the_file_format_page_names_everything_in_a_reconstruction(made: Reconstruction, tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs/file-format.md").read_text("utf-8").partition("## reconstruction.h5")[2]
    bounds = dict.fromkeys(("albedo_low", "albedo_high", "depth_low_m", "depth_high_m", "seen"), made.albedo)
    told = replace(made, response=gaussian(70e-12, "a test"), intervals=Intervals(**bounds), frame=1)
    write_reconstruction(tmp_path / "r.h5", told)
    with h5py.File(tmp_path / "r.h5") as file:
        assert len(file) == 13
        for word in (*file, *file.attrs, *(word for part in file.values() for word in part.attrs)):
            assert f"`{word}`" in page, word


def test_ply_holds_the_surface_in_metres(made: Reconstruction, tmp_path: Path) -> None:
    write_ply(tmp_path / "s.ply", made)
    header, _, body = (tmp_path / "s.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex 12" in header
    assert b"element face 6" in header
    vertices = np.frombuffer(body, dtype=PLY_VERTEX, count=12)
    assert np.allclose(vertices["xyz"][0], (WALL.x_m()[2], WALL.y_m()[1], 0.55))
    faces = np.frombuffer(body[12 * 31 :], dtype=[("count", "u1"), ("corners", "<i4", 4)])
    assert len(faces) == 6
    assert faces["corners"].max() == 11
    assert np.allclose(vertices["normal"], (0, 0, -1), atol=1e-3)  # a flat square looks at the wall


def test_an_obj_holds_places_to_the_micrometre(made: Reconstruction, tmp_path: Path) -> None:
    farther = replace(made, depth_m=made.depth_m + np.float32(1.23456789))
    write_obj(tmp_path / "s.obj", farther)
    lines = [line.split() for line in (tmp_path / "s.obj").read_text().splitlines()]
    depths_m = np.array([line[3] for line in lines if line[0] == "v"], dtype=float)
    assert np.abs(depths_m - 1.78456789).max() < 5e-7


def test_meshes_hold_the_same_surface_and_face_the_wall(made: Reconstruction, tmp_path: Path) -> None:
    write_obj(tmp_path / "s.obj", made)
    lines = [line.split() for line in (tmp_path / "s.obj").read_text().splitlines()]
    points = np.array([line[1:4] for line in lines if line[0] == "v"], dtype=float)
    faces = [[int(word.split("//")[0]) - 1 for word in line[1:]] for line in lines if line[0] == "f"]
    assert (len(points), len(faces)) == (12, 12)
    assert {len(face) for face in faces} == {3}  # Open3D leaves larger ones out
    assert np.allclose(points[0], (WALL.x_m()[2], WALL.y_m()[1], 0.55))
    for face in faces:
        a, b, c = (points[corner] for corner in face[:3])
        assert (
            np.cross(b - a, c - a)[2] < 0
        )  # seen from the wall, corners go round to the left: its front is towards it
    write_glb(tmp_path / "s.glb", made)
    data = (tmp_path / "s.glb").read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, size, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]
    assert len(binary) == document["buffers"][0]["byteLength"]
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        kind_of = {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        arrays.append(np.frombuffer(part, kind_of).reshape(accessor["count"], -1))
    assert np.allclose(arrays[0], points, atol=1e-6)
    assert np.allclose(arrays[1], (0, 0, -1), atol=1e-3)
    assert np.allclose(document["accessors"][0]["max"], points.max(axis=0), atol=1e-6)
    corners = arrays[3].reshape(-1, 3)
    assert (len(corners), corners.max()) == (12, 11)
    flat = arrays[0][corners]
    assert (np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])[:, 2] < 0).all()


def test_vti_holds_the_volume_with_y_upwards(made: Reconstruction, tmp_path: Path) -> None:
    write_vti(tmp_path / "v.vti", made)
    header, _, body = (tmp_path / "v.vti").read_bytes().partition(b'encoding="raw">_')
    assert b'WholeExtent="0 11 0 7 0 9"' in header
    origin = [float(word) for word in re.search(rb'Origin="([^"]*)"', header)[1].split()]  # type: ignore[index]
    assert np.allclose(origin, (WALL.x_m()[0], WALL.y_m()[-1], 0.05))
    size = int(np.frombuffer(body, "<u8", 1)[0])
    values = np.frombuffer(body[8 : 8 + size], "<f4").reshape(10, 8, 12)
    assert made.volume is not None
    assert np.array_equal(values[:, ::-1], made.volume.albedo)
    with pytest.raises(InvalidData, match="no volume"):
        write_vti(tmp_path / "w.vti", replace(made, volume=None))
    with pytest.raises(InvalidData, match="no volume"):
        slices_picture(replace(made, volume=None), tmp_path / "s.png")


@pytest.mark.parametrize("with_volume", [True, False])
def test_the_3d_view_is_one_file_that_loads_nothing(made: Reconstruction, tmp_path: Path, with_volume: bool) -> None:
    write_view3d(tmp_path / "v.html", made if with_volume else replace(made, volume=None), title="<b>&")
    page = (tmp_path / "v.html").read_text()
    assert "&lt;b&gt;&amp;" in page
    assert small_print(made) in page
    assert not re.search(r"(src|href)\s*=|https?://|import\s", page)
    scene = json.loads(re.search(r"const scene = (\{.*\});", page)[1])  # type: ignore[index]
    points = np.frombuffer(base64.b64decode(scene["points"]), "<f4").reshape(-1, 4)
    assert ("volume" in scene) is with_volume
    if with_volume:
        grey = np.frombuffer(base64.b64decode(scene["volume"]["u1"]), "u1").reshape(scene["volume"]["shape"])
        assert made.volume is not None
        assert grey.shape == made.volume.albedo.shape
        assert np.array_equal(grey == 255, made.volume.albedo == made.volume.albedo.max())
    assert len(points) == 12
    assert np.allclose(points[:, 2], 0.55, atol=1e-3)
    assert np.allclose(points[0, :2], (WALL.x_m()[2], WALL.y_m()[1]), atol=1e-3)


def test_an_empty_reconstruction_can_still_be_written(tmp_path: Path) -> None:
    nothing = Reconstruction(
        np.zeros((8, 12), np.float32), np.full((8, 12), np.nan, np.float32), WALL, "lct", 0.1, {},
        Volume(np.zeros((10, 8, 12), np.float32), 0.05 + 0.1 * np.arange(10), WALL),
    )  # fmt: skip
    write_results(tmp_path, nothing, html=True)
    write_ply(tmp_path / "s.ply", nothing)
    write_obj(tmp_path / "s.obj", nothing)
    write_glb(tmp_path / "s.glb", nothing)
