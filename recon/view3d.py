"""A rotatable 3D view of a reconstruction in one HTML file: no scripts from elsewhere, nothing to install."""

import base64
import html
import json
from pathlib import Path
from string import Template

import numpy as np
import numpy.typing as npt

from nlos.recon.pictures import FAINT
from nlos.recon.surface import front_surface
from nlos.recon.volume import Reconstruction, Volume

MOST_POINTS = 60_000
SHOWN_AT_FIRST = 0.15


def write_view3d(path: Path, reconstruction: Reconstruction, title: str = "") -> None:
    """Writes the bright voxels, or the front surface where there is no volume, with the page that turns them."""
    if reconstruction.volume is not None:
        points, albedo = bright_voxels(reconstruction.volume)
    else:
        surface = front_surface(reconstruction)
        points, albedo = surface.points_m, surface.albedo
    wall = reconstruction.wall
    low, high = _span(points)
    scene = {
        "points": base64.b64encode(_packed(points, albedo, low, high).tobytes()).decode("ascii"),
        "low": low.tolist(),
        "high": high.tolist(),
        "wall": [wall.width_m, wall.height_m],
        "pitch": max(wall.width_m / wall.cols, wall.height_m / wall.rows),
    }
    page = Template((Path(__file__).parent / "view3d.html").read_text(encoding="utf-8"))
    path.write_text(
        page.substitute(
            title=html.escape(title or f"{reconstruction.method} reconstruction"),
            subtitle=html.escape(f"{len(points)} points, {reconstruction.method}, {reconstruction.seconds:.2f} s"),
            threshold=f"{SHOWN_AT_FIRST:g}" if reconstruction.volume is not None else "0",
            scene=json.dumps(scene).replace("</", "<\\/"),
        ),
        encoding="utf-8",
    )


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


def _span(points: npt.NDArray[np.float32]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    if len(points) == 0:
        return np.zeros(3), np.ones(3)
    return points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)


def _packed(
    points: npt.NDArray[np.float32],
    albedo: npt.NDArray[np.float32],
    low: npt.NDArray[np.float64],
    high: npt.NDArray[np.float64],
) -> npt.NDArray[np.uint16]:
    """Positions within their span and albedo, 16 bits each, (N, 4): a thousandth of a voxel is enough to look at."""
    extent = np.where(high > low, high - low, 1.0)
    values = np.concatenate([(points - low) / extent, albedo[:, None]], axis=1)
    return np.asarray(np.rint(np.clip(values, 0, 1) * 65535), dtype="<u2")
