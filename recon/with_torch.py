"""Runs a method of the catalogue on a transient, by torch."""

import os
from collections.abc import Hashable
from functools import lru_cache, partial
from typing import cast

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.recon import parts
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.layers.placed import placed
from nlos.recon.method import Method, MethodResult, sure, takes_response
from nlos.recon.methods import find
from nlos.recon.own_methods import defined_at, with_its_line
from nlos.recon.weights.files import sha256_of

Floats = npt.NDArray[np.float32]
Depths = npt.NDArray[np.float64]

if hasattr(os, "register_at_fork"):  # not on Windows. A child has none of its parent's threads, and OpenMP awaits them
    os.register_at_fork(after_in_child=partial(torch.set_num_threads, 1))


def see_by(
    method: str, settings: Settings, transient: Transient, device: str = "cpu"
) -> tuple[MethodResult[Floats], Depths, bool]:
    """What a method makes of one transient, the depths of its planes, (D,), none where it says none, and whether it
    takes the instrument's response into account.

    Raises `ReconstructionFailed` where what it makes is not of the shapes in `recon/method.py`.
    """
    found = find(method)
    with with_its_line(method, found):
        module = _built(cast(Hashable, found), settings, transient)
        return *see(transient, module, device, defined_at(found, "forward")), takes_response(module)


def get_ready_for(method: str, settings: Settings, transient: Transient) -> None:
    """Builds a method for such a transient; `see_by` then finds it built."""
    _built(cast(Hashable, find(method)), settings, transient)


def see(
    transient: Transient, module: nn.Module, device: str = "cpu", own_at: str = ""
) -> tuple[MethodResult[Floats], Depths]:
    """What a method built for this wall and time axis makes of one transient, and the depths of its planes, (D,).

    `own_at`: `file:line: ` of a method of one's own, whose numbers are then looked at too.
    """
    module = placed(module, device)
    with torch.inference_mode():
        counts = torch.from_numpy(np.ascontiguousarray(transient.counts))[None, None].to(device)
        exposure_s = torch.from_numpy(np.ascontiguousarray(transient.exposure_s))[None].to(device)
        told: tuple[torch.Tensor, ...] = ()
        if transient.response is not None and takes_response(module):
            taps = transient.response.taps(transient.time.bin_width_s)
            told = (torch.from_numpy(taps)[None].float().to(device),) if len(taps) > 1 else ()
        with parts.told(module):
            if own_at:  # it may write into what it is given, which is the scan that later pictures are made of
                counts, exposure_s = counts.clone(), exposure_s.clone()
            made: MethodResult[torch.Tensor] = module(counts, exposure_s, *told)
    planes = getattr(module, "depths_m", ())
    depths_m = np.asarray(planes.cpu() if isinstance(planes, torch.Tensor) else planes, dtype=np.float64)
    wrong = _wrong(made, len(depths_m), transient.wall) or (_wrong_numbers(made) if own_at else "")
    if wrong:
        raise ReconstructionFailed(f"{own_at}{wrong} (nlos.recon.method is the contract)")
    volume = None if made.volume is None else made.volume[0].cpu().numpy()
    of_each = getattr(made, "intervals", None)
    known = None if of_each is None else {name: x[0].cpu().numpy() for name, x in of_each.items()}
    return sure(MethodResult(made.albedo[0].cpu().numpy(), made.depth_m[0].cpu().numpy(), volume), known), depths_m


def _wrong(made: object, planes: int, wall: WallGrid) -> str:
    """What is not as the contract says; empty where all is."""
    if not isinstance(made, MethodResult):
        return f"returned {type(made).__name__}, not a MethodResult"
    front = (1, wall.rows, wall.cols)
    wanted: dict[str, tuple[int, ...]] = {"albedo": front, "depth_m": front}
    wanted |= {} if made.volume is None else {"volume": (1, planes, wall.rows, wall.cols)}
    for name, shape in wanted.items():
        field = getattr(made, name)
        if not isinstance(field, torch.Tensor) or not field.is_floating_point():
            kind = field.dtype if isinstance(field, torch.Tensor) else type(field).__name__
            return f"{name} is {kind}, must be a tensor of real numbers"
        if field.shape != shape:
            more = ", D being the length of `depths_m`" if name == "volume" else ""
            return f"{name} is {tuple(field.shape)}, must be {shape} for this scan{more}"
    return ""


def _wrong_numbers(made: MethodResult[torch.Tensor]) -> str:
    """What no front view or depth may hold; empty where all is well."""
    finite = torch.isfinite(made.albedo)
    if not finite.all():
        return f"{int((~finite).sum())} of {finite.numel()} values of albedo are not finite"
    if made.albedo.min() < 0:
        return f"albedo goes down to {float(made.albedo.min()):.3g}; a front view is not negative"
    if torch.isinf(made.depth_m).any():
        return "depth_m is infinite at places; NaN says that nothing is seen"
    if (made.depth_m < 0).any():
        return (
            f"depth_m goes down to {float(made.depth_m.nan_to_num(0).min()):.3g} m; what is seen lies before the wall"
        )
    if made.volume is not None and not torch.isfinite(made.volume).all():
        return "volume holds values that are not finite"
    return ""


def _built(method: Hashable, settings: Settings, transient: Transient) -> nn.Module:
    """By the weights as they are now: a training that goes on has written others into the same file."""
    named = (value for name in ("weights", "noise_weights") if (value := getattr(settings, name, None)) is not None)
    return built(method, settings, transient.wall, transient.time, tuple(map(sha256_of, named)))


@lru_cache(maxsize=6)  # three of each of two axes: those before a film is aligned are still in use just after it is
def built(
    method: Hashable, settings: Settings, wall: WallGrid, time: TimeAxis, weights_sha256: tuple[str, ...]
) -> nn.Module:
    """A method, kept for the next transient of the same shape and weights. Raises `ReconstructionFailed`."""
    module: object = cast(Method, method).build(settings, wall, time)
    if not isinstance(module, nn.Module):
        what = f"build returned {type(module).__name__}, not an nn.Module"
        raise ReconstructionFailed(f"{defined_at(method, 'build')}{what}")
    return module.eval()
