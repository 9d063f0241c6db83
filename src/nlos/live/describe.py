"""Pictures and arrays as JSON: what the page draws."""

import base64
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.recon.seen import brightest, visible_depth
from nlos.recon.view3d import solid_points, solid_scene
from nlos.recon.volume import FINISHED

if TYPE_CHECKING:
    from nlos.recon.live import LivePicture

MOST_POINTS = 12_000


def packed(values: npt.NDArray[Any]) -> dict[str, Any]:
    """An array as its shape and little-endian float32 in base64, NaN and all."""
    return {"shape": list(values.shape), "f4": base64.b64encode(values.astype("<f4").tobytes()).decode("ascii")}


def solid(picture: "LivePicture") -> dict[str, Any]:
    """Front surface and volume, as `view3d.html` has them, and of how many samples they are."""
    return {"samples": picture.samples, "method": picture.reconstruction.method, **solid_scene(picture.reconstruction)}


def described(picture: "LivePicture") -> dict[str, Any]:
    """Front view (1 = its 99.9th percentile), depth where something is seen, confidence, and the bright voxels as
    x, y, z in metres and brightness, (N, 4)."""
    result = picture.reconstruction
    where_m, value = solid_points(result)
    keep = np.argsort(value)[-MOST_POINTS:]
    return {
        "samples": picture.samples,
        "method": result.method,
        "change": picture.change,
        "error": picture.error,
        "bound": picture.bound,
        "seconds": result.seconds,
        "refined": result.settings.get("refine", True) or result.settings.get(FINISHED, False),
        "explained": None if result.explained is None else str(result.explained),
        "verdict": "" if result.explained is None else result.explained.verdict,
        "explains_nothing": result.explained is not None and bool(result.explained.nothing or result.explained.doubt),
        "wall": [result.wall.width_m, result.wall.height_m],
        "albedo": packed(result.albedo / brightest(result)),
        "depth_m": packed(visible_depth(result)),
        "confidence": packed(picture.confidence),
        "seen": None if result.intervals is None else packed(result.intervals.seen),
        "points": packed(np.concatenate([where_m[keep], value[keep, None]], axis=1)),
    }
