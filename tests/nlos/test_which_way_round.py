"""Pictures are as one sees the wall who faces it: what lies at +x is drawn at the right, what lies at +y at the top.
Meshes and volumes lie where the object is in the room: they are the object, and not its mirror image."""

import json
import re
import struct
from pathlib import Path

import numpy as np
import pytest

import nlos
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.font import bitmap
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface, surfels
from tests import command

SIDE, BINS, BIN_S, WALL_M, AWAY_M = 16, 256, 64e-12, 1.0, 2.0


@pytest.mark.parametrize("letter", ["F", "L"])
def test_an_asymmetric_letter_is_neither_mirrored_nor_upside_down(letter: str) -> None:
    """The beam goes to the right of who faces the wall for +x, up for +y; rows of the scan from the top, columns from
    the left. The letter is drawn on the wall's axes."""
    histograms = lit(Surface(letter=letter, centre_m=(0.0, 0.0, 0.5), height_m=0.7))
    picture = nlos.reconstruct(histograms, "lct", wall=WALL_M, bin_width=BIN_S)
    drawn = truth(letter)
    agreed = {
        name: float(np.corrcoef(picture.albedo.ravel(), turned.ravel())[0, 1])
        for name, turned in {"drawn": drawn, "mirrored": drawn[:, ::-1], "upside down": drawn[::-1]}.items()
    }
    assert agreed["drawn"] > 0.7
    assert agreed["drawn"] > max(agreed["mirrored"], agreed["upside down"]) + 0.1, agreed
    assert (np.diff(picture.x_m) > 0).all()
    assert (np.diff(picture.y_m) < 0).all()


def truth(letter: str) -> np.ndarray:
    """The letter on the scan's pixels, 0.7 m tall of a wall of 1 m."""
    cells = np.array([[cell == "#" for cell in line] for line in bitmap(letter)], dtype=float)
    at_m = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WALL_M
    row, col = np.floor((0.35 - (-at_m)) / 0.1).astype(int), np.floor((at_m + 0.25) / 0.1).astype(int)
    inside = ((row >= 0) & (row < 7))[:, None] & ((col >= 0) & (col < 5))[None, :]
    return np.where(inside, cells[np.clip(row, 0, 6)][:, np.clip(col, 0, 4)], 0.0)


def lit(*objects: Surface) -> np.ndarray:
    """Histograms (H, W, T) of the wall's points, the beam sent to each as a mirror would."""
    scene = SceneSettings(objects=objects, direct_cps=0.0, ambient_cps=0.0)
    path = BeamPath(AWAY_M)
    light = SceneLight(scene, DetectorSettings(dark_cps=0.0), path, 10e6, seed=5)
    at_m = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * WALL_M
    histograms = np.zeros((SIDE, SIDE, BINS))
    for row, y_m in enumerate(-at_m):
        for col, x_m in enumerate(at_m):
            y_rad = np.arctan(y_m / AWAY_M)
            spot = path.spot(MirrorAngles(float(np.arctan(x_m * np.cos(y_rad) / AWAY_M)), float(y_rad)))
            assert spot is not None
            assert (spot.x_m, spot.y_m) == pytest.approx((x_m, y_m))
            histograms[row, col] = light.photons_per_pulse(spot, BIN_S, 2 * spot.range_m / 299792458)[:BINS]
    return histograms / histograms.max()


def read_ply(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices (N, 3), normals (N, 3), faces (M, 3 or 4)."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    count = int(re.search(rb"element vertex (\d+)", header)[1])  # type: ignore[index]
    vertex = np.dtype([("xyz", "<f4", 3), ("normal", "<f4", 3), ("albedo", "<f4"), ("grey", "u1", 3)])
    vertices = np.frombuffer(body, vertex, count)
    faces = np.frombuffer(body[count * vertex.itemsize :], [("count", "u1"), ("corners", "<i4", 4)])
    return vertices["xyz"], vertices["normal"], faces["corners"]


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    lines = [line.split() for line in path.read_text().splitlines()]
    points, normals = ([line[1:4] for line in lines if line[0] == kind] for kind in ("v", "vn"))
    faces = [[int(word.split("//")[0]) - 1 for word in line[1:]] for line in lines if line[0] == "f"]
    return np.array(points, float), np.array(normals, float), np.array(faces)


def read_glb(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    data = path.read_bytes()
    length = struct.unpack_from("<I", data, 12)[0]
    document, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    assert not {"matrix", "rotation", "scale", "translation"} & set(document["nodes"][0])
    arrays = []
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        part = binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        arrays.append(np.frombuffer(part, {5126: "<f4", 5125: "<u4"}[accessor["componentType"]]))
    return arrays[0].reshape(-1, 3), arrays[1].reshape(-1, 3), arrays[3].reshape(-1, 3)


def read_vti(path: Path) -> np.ndarray:
    """The places of the bright voxels (N, 3)."""
    header, _, body = path.read_bytes().partition(b'encoding="raw">_')
    words = [re.search(rb'%s="([^"]*)"' % key, header) for key in (b"Origin", b"Spacing", b"WholeExtent")]
    origin, spacing, extent = (np.array(word[1].split(), float) for word in words if word is not None)
    cols, rows, planes = extent[1::2].astype(int) + 1
    values = np.frombuffer(body[8 : 8 + 4 * cols * rows * planes], "<f4").reshape(planes, rows, cols)
    return origin + spacing * np.argwhere(values > 0.3 * values.max())[:, ::-1]


def away_m(truth_m: np.ndarray, found_m: np.ndarray) -> float:
    """How far the object's pieces are from the nearest of what was found, and the other way round: the mean of both."""
    apart = np.linalg.norm(truth_m[:, None] - found_m[None], axis=2)
    return float(apart.min(axis=0).mean() + apart.min(axis=1).mean()) / 2


def test_every_export_of_a_turned_letter_lies_where_the_letter_is(tmp_path: Path) -> None:
    """An F, its right edge swung away from the wall: none of its mirror images can be turned and moved into its place.
    x to the right and y up for who faces the wall, z from there towards who does: right-handed in the room."""
    letter = Surface(letter="F", centre_m=(0.05, 0.0, 0.5), height_m=0.7, yaw_deg=30.0)
    nlos.reconstruct(lit(letter), "lct", wall=WALL_M, bin_width=BIN_S).save(tmp_path)
    command.nlos(tmp_path, "export", "reconstruction.h5", "--to", "ply,obj,glb,vti", check=True)
    pieces = surfels([letter], 0.02)
    true_m, facing = pieces.positions_m, pieces.normals.mean(axis=0)
    places = {}
    for name, read in {"ply": read_ply, "obj": read_obj, "glb": read_glb}.items():
        points, normals, faces = read(tmp_path / f"reconstruction.{name}")
        places[name] = points
        a, b, c = (points[faces[:, corner]] for corner in range(3))
        fronts = np.cross(b - a, c - a)
        assert (fronts[:, 2] < 0).all(), name  # to the wall, as the normals
        assert (normals[:, 2] < 0).all(), name
        mean = normals.mean(axis=0) / np.linalg.norm(normals.mean(axis=0))
        assert mean @ facing > np.cos(np.radians(15)), (name, mean, facing)
    places["vti"] = read_vti(tmp_path / "reconstruction.vti")
    middle_m = np.array([0.0, 0.0, 0.5])
    for name, points in places.items():
        as_it_is = away_m(true_m, points)
        mirrored = [
            away_m(true_m, middle_m + (points - middle_m) * np.where(np.arange(3) == k, -1, 1)) for k in range(3)
        ]
        assert as_it_is < WALL_M / SIDE, name
        assert min(mirrored) > as_it_is + 0.01, (name, as_it_is, mirrored)
    assert np.allclose(places["ply"], places["obj"], atol=1e-5)
    assert np.allclose(places["ply"], places["glb"], atol=1e-5)
