"""A rotatable 3D view of a reconstruction in one HTML file: no scripts from elsewhere, nothing to install."""

import base64
import html
import json
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.recon.seen import FAINT, SOLID, depth_limits
from nlos.recon.small_print import small_print
from nlos.recon.surface import front_surface
from nlos.recon.volume import Reconstruction, Volume

MOST_POINTS = 60_000
MOST_VOXELS = 400_000


def write_view3d(path: Path, reconstruction: Reconstruction, title: str = "") -> None:
    """Writes the page of `view3d_page`."""
    path.write_text(view3d_page(reconstruction, title), encoding="utf-8")


def view3d_page(reconstruction: Reconstruction, title: str = "") -> str:
    """Bright voxels, front surface and volume with the page that turns them, as HTML."""
    points, albedo = solid_points(reconstruction)
    wall = reconstruction.wall
    near, far = depth_limits([reconstruction])
    scene = {
        "points": _base64(np.concatenate([points, albedo[:, None]], axis=1)),
        "count": len(points),
        "near": near,
        "far": max(far, 0.1),
        "wall": [wall.width_m, wall.height_m],
        "pitch": max(wall.width_m / wall.cols, wall.height_m / wall.rows),
        **solid_scene(reconstruction),
    }
    page = Template((Path(__file__).parent / "view3d.html").read_text(encoding="utf-8").replace("$$", "$$$$"))
    return page.substitute(
        title=html.escape(title or reconstruction.scan or f"{reconstruction.method} reconstruction"),
        subtitle=html.escape(small_print(reconstruction)),
        threshold=f"{SOLID:g}",
        faint=f"{FAINT:g}",
        turnable=(Path(__file__).parent / "view3d.js").read_text(encoding="utf-8"),
        scene=json.dumps(scene).replace("</", "<\\/"),
    )


def solid_points(
    reconstruction: Reconstruction,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """The bright voxels, or the points of the front surface of a method that has no volume: (N, 3) in metres, and their
    albedo (N,), 0 to 1, less where the method doubts that there is a surface."""
    if reconstruction.volume is not None:
        points_m, albedo = bright_voxels(reconstruction.volume)
    else:
        surface = front_surface(reconstruction)
        points_m, albedo = surface.points_m, surface.albedo
    return points_m, _faded(reconstruction, points_m, albedo)


def _faded(
    reconstruction: Reconstruction, points_m: npt.NDArray[np.float32], albedo: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """The albedo of points times the probability that there is a surface at their pixels, where it is known."""
    sure, wall = reconstruction.intervals, reconstruction.wall
    if sure is None:
        return albedo
    col = np.rint((points_m[:, 0] / wall.width_m + 0.5) * wall.cols - 0.5).astype(np.intp)
    row = np.rint((0.5 - points_m[:, 1] / wall.height_m) * wall.rows - 0.5).astype(np.intp)
    return np.asarray(albedo * sure.seen[row, col], dtype=np.float32)


def solid_scene(reconstruction: Reconstruction) -> dict[str, Any]:
    """Front surface, and the volume where there is one, as the page's script reads them."""
    surface = front_surface(reconstruction)
    albedo = _faded(reconstruction, surface.points_m, surface.albedo)
    return {
        "surface": _base64(np.concatenate([surface.points_m, albedo[:, None]], axis=1)),
        "quads": _base64(surface.quads) if len(surface.quads) else None,
        **(_volume(reconstruction.volume) if reconstruction.volume is not None else {}),
    }


def bright_voxels(volume: Volume) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """The brightest voxels that are maxima along depth or next to one: (N, 3) in metres, (N,) albedo 0 to 1."""
    albedo = volume.albedo
    ridge = np.zeros(albedo.shape, dtype=np.bool_)
    if len(albedo) > 2:
        ridge[1:-1] = (albedo[1:-1] >= albedo[:-2]) & (albedo[1:-1] >= albedo[2:])
    else:
        ridge[:] = True
    top = float(np.quantile(albedo.max(axis=0), 0.999)) or 1.0
    ridge &= albedo > FAINT * top
    plane, row, col = np.nonzero(ridge)
    value = albedo[plane, row, col]
    if len(value) > MOST_POINTS:
        keep = np.argpartition(value, -MOST_POINTS)[-MOST_POINTS:]
        plane, row, col, value = plane[keep], row[keep], col[keep], value[keep]
    points = np.stack([volume.wall.x_m()[col], volume.wall.y_m()[row], volume.depths_m[plane]], axis=1)
    return points.astype(np.float32), np.clip(value / top, 0, 1).astype(np.float32)


def _volume(volume: Volume) -> dict[str, object]:
    """The volume in bytes, thinned by block maxima to at most `MOST_VOXELS`, and where its brightest voxel lies: x, y,
    z, each from 0 to 1."""
    albedo, depths_m = volume.albedo, volume.depths_m
    step = [1, 1, 1]
    while np.prod([-(-size // by) for size, by in zip(albedo.shape, step, strict=True)]) > MOST_VOXELS:
        step[int(np.argmax([size / by for size, by in zip(albedo.shape, step, strict=True)]))] *= 2
    padded = np.pad(albedo, [(0, -size % by) for size, by in zip(albedo.shape, step, strict=True)], mode="edge")
    (d, h, w), (a, b, c) = padded.shape, step
    thinned = padded.reshape(d // a, a, h // b, b, w // c, c).max(axis=(1, 3, 5))
    top = float(np.quantile(albedo.max(axis=0), 0.999)) or 1.0
    grey = np.clip(255 * thinned / top, 0, 255).astype(np.uint8)
    place = np.unravel_index(int(thinned.argmax()), thinned.shape)
    at = [float(where) / max(size - 1, 1) for where, size in zip(place, thinned.shape, strict=True)]
    return {
        "volume": {"shape": list(grey.shape), "u1": base64.b64encode(grey.tobytes()).decode("ascii")},
        "depths": [float(depths_m[0]), float(depths_m[-1])],
        "at": [at[2], 1 - at[1], at[0]],
    }


def _base64(values: npt.NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")
