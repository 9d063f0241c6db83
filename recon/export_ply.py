"""The front surface as PLY: points in metres with their albedo as grey, and the faces between them."""

from pathlib import Path

import numpy as np

from nlos.recon.surface import front_surface, vertex_normals
from nlos.recon.volume import Reconstruction


def write_ply(path: Path, reconstruction: Reconstruction) -> None:
    """Writes binary little-endian PLY: x right, y up, z from the wall, normals towards it; `albedo` 0 to 1 beside 8-bit
    grey."""
    surface = front_surface(reconstruction)
    vertices = np.empty(
        len(surface.points_m),
        dtype=[("xyz", "<f4", 3), ("normal", "<f4", 3), ("albedo", "<f4"), ("grey", "u1", 3)],
    )
    vertices["xyz"] = surface.points_m
    vertices["normal"] = vertex_normals(surface)
    vertices["albedo"] = surface.albedo
    vertices["grey"] = np.rint(surface.albedo * 255).astype(np.uint8)[:, None]
    faces = np.empty(len(surface.quads), dtype=[("count", "u1"), ("corners", "<i4", 4)])
    faces["count"] = 4
    faces["corners"] = surface.quads
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"comment {reconstruction.method}; metres; x right, y up, z from the wall\n"
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        "property float nx\nproperty float ny\nproperty float nz\nproperty float albedo\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(header.encode("ascii") + vertices.tobytes() + faces.tobytes())
