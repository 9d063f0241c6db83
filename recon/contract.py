"""What a method made, held against the contract in `recon/method.py`: what is wrong, in words."""

from collections.abc import Mapping
from dataclasses import fields

import numpy as np
import numpy.typing as npt
import torch

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.method import MethodResult
from nlos.recon.volume import Intervals

INTERVALS = tuple(field.name for field in fields(Intervals))


def wrong_shapes(made: object, planes: int, wall: WallGrid) -> str:
    """What is not of the shapes and types that every method's result has; empty where all is."""
    if not isinstance(made, MethodResult):
        return f"returned {type(made).__name__}, not a MethodResult"
    front = (1, wall.rows, wall.cols)
    wanted: dict[str, tuple[int, ...]] = {"albedo": front, "depth_m": front}
    wanted |= {} if made.volume is None else {"volume": (1, planes, wall.rows, wall.cols)}
    for name, shape in wanted.items():
        if wrong := _wrong_shape(name, getattr(made, name), shape):
            return wrong
    return ""


def wrong_numbers(made: MethodResult[torch.Tensor], depths_m: npt.NDArray[np.float64], time: TimeAxis) -> str:
    """What no front view, depth, volume or interval of a scan with this time axis may hold; empty where all is well.
    Asked of methods of one's own alone."""
    finite = torch.isfinite(made.albedo)
    if not finite.all():
        return f"{int((~finite).sum())} of {finite.numel()} values of albedo are not finite"
    if made.albedo.min() < 0:
        return f"albedo goes down to {float(made.albedo.min()):.3g}; a front view is not negative"
    return _wrong_depth(made.depth_m, time) or _wrong_volume(made.volume, depths_m) or _wrong_intervals(made)


def _wrong_depth(depth_m: torch.Tensor, time: TimeAxis) -> str:
    if torch.isinf(depth_m).any():
        return "depth_m is infinite at places; NaN says that nothing is seen"
    seen = depth_m.nan_to_num(0)
    if seen.min() < 0:
        return f"depth_m goes down to {float(seen.min()):.3g} m; what is seen lies before the wall"
    reach_m = (time.start_s + (time.bins + 1) * time.bin_width_s) * SPEED_OF_LIGHT_M_PER_S / 2
    if seen.max() > reach_m:
        return (
            f"depth_m goes up to {float(seen.max()):.3g} m, and this scan's last bin holds light of at most "
            f"{reach_m:.3g} m; depths are in metres from the wall, NaN where nothing is seen"
        )
    return ""


def _wrong_volume(volume: torch.Tensor | None, depths_m: npt.NDArray[np.float64]) -> str:
    if volume is None:
        return ""
    if not torch.isfinite(volume).all():
        return "volume holds values that are not finite"
    if depths_m.ndim != 1 or not np.isfinite(depths_m).all() or (np.diff(depths_m) <= 0).any():
        return f"depths_m of shape {depths_m.shape} must be the planes' depths in metres, (D,), each behind the last"
    return ""


def _wrong_intervals(made: MethodResult[torch.Tensor]) -> str:
    known = getattr(made, "intervals", None)
    if known is None:
        return ""
    if not isinstance(known, Mapping) or set(known) != set(INTERVALS):
        said = ", ".join(map(str, known)) if isinstance(known, Mapping) else type(known).__name__
        return f"intervals are {said}, must be {', '.join(INTERVALS)}"
    for name, field in known.items():
        if wrong := _wrong_shape(name, field, tuple(made.albedo.shape)):
            return wrong
        if torch.isinf(field).any() or (not name.startswith("depth") and torch.isnan(field).any()):
            return f"{name} holds values that are not finite"
    for low, high in (("albedo_low", "albedo_high"), ("depth_low_m", "depth_high_m")):
        if (known[low] > known[high]).any():
            return f"{low} is above {high} at places"
    if known["seen"].min() < 0 or known["seen"].max() > 1:
        return "seen is a probability, from 0 to 1"
    return ""


def _wrong_shape(name: str, field: object, shape: tuple[int, ...]) -> str:
    if not isinstance(field, torch.Tensor) or not field.is_floating_point():
        kind = field.dtype if isinstance(field, torch.Tensor) else type(field).__name__
        return f"{name} is {kind}, must be a tensor of real numbers"
    if field.shape != shape:
        more = ", D being the length of `depths_m`" if name == "volume" else ""
        return f"{name} is {tuple(field.shape)}, must be {shape} for this scan{more}"
    return ""
