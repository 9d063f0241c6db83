"""The front surface as OBJ and GLB (glTF 2.0): meshes with normals, for whoever draws, prints or animates.

Both hold the numbers of PLY and VTI: wall coordinates, which are right-handed in the room, so that a print is the
object and not its mirror image. Normals and the front sides of faces point to the wall, -z.
"""

import json
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.recon.surface import Surface, front_surface, vertex_normals
from nlos.recon.volume import Reconstruction

_FLOAT, _UINT32, _ARRAY_BUFFER, _ELEMENT_BUFFER, _TRIANGLES = 5126, 5125, 34962, 34963, 4


def write_obj(path: Path, reconstruction: Reconstruction) -> None:
    """Wavefront OBJ: vertices in metres with their grey, normals, triangles, since some readers skip larger faces."""
    surface = front_surface(reconstruction)
    points, normals = surface.points_m, vertex_normals(surface)
    lines = [f"# {reconstruction.method}; metres; x right, y up, z from the wall"]
    lines += [
        f"v {x:.9g} {y:.9g} {z:.9g} {g:.4g} {g:.4g} {g:.4g}"
        for (x, y, z), g in zip(points.tolist(), surface.albedo.tolist(), strict=True)
    ]
    lines += [f"vn {x:.4g} {y:.4g} {z:.4g}" for x, y, z in normals.tolist()]
    lines += [
        "f " + " ".join(f"{corner + 1}//{corner + 1}" for corner in face) for face in _triangles(surface).tolist()
    ]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


def write_glb(path: Path, reconstruction: Reconstruction) -> None:
    """Binary glTF 2.0: one mesh of triangles with normals and grey vertex colours; of nothing, an empty scene."""
    surface = front_surface(reconstruction)
    document: dict[str, object] = {
        "asset": {"version": "2.0", "generator": "nlos"},
        "scene": 0,
        "scenes": [{"nodes": [0] if len(surface.quads) else []}],
    }
    binary = b""
    if len(surface.quads):
        more, binary = _mesh(surface, reconstruction.method)
        document |= more
    text = json.dumps(document).encode("ascii")
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    if binary:
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _triangles(surface: Surface) -> npt.NDArray[np.int32]:
    """The quadrilaterals as triangles, (2 M, 3), of the same sense of rotation."""
    return np.concatenate([surface.quads[:, [0, 1, 2]], surface.quads[:, [0, 2, 3]]])


def _mesh(surface: Surface, name: str) -> tuple[dict[str, object], bytes]:
    points = np.ascontiguousarray(surface.points_m, dtype="<f4")
    normals = np.ascontiguousarray(vertex_normals(surface), dtype="<f4")
    colours = np.repeat(surface.albedo[:, None], 3, axis=1).astype("<f4")
    triangles = _triangles(surface).astype("<u4")
    arrays: list[tuple[npt.NDArray[np.generic], int, str]] = [
        (points, _FLOAT, "VEC3"), (normals, _FLOAT, "VEC3"), (colours, _FLOAT, "VEC3"),
        (triangles.reshape(-1), _UINT32, "SCALAR"),
    ]  # fmt: skip
    views: list[dict[str, int]] = []
    accessors: list[dict[str, object]] = []
    binary = b""
    for number, (array, kind, shape) in enumerate(arrays):
        target = _ELEMENT_BUFFER if shape == "SCALAR" else _ARRAY_BUFFER
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": array.nbytes, "target": target})
        accessors.append({"bufferView": number, "componentType": kind, "count": len(array), "type": shape})
        binary += array.tobytes()
    accessors[0] |= {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    primitive = {"attributes": attributes, "indices": 3, "mode": _TRIANGLES, "material": 0}
    return {
        "nodes": [{"mesh": 0, "name": name}],
        "meshes": [{"primitives": [primitive]}],
        "materials": [{"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": accessors,
    }, binary
