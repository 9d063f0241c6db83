"""Runs a method of the catalogue on a transient, by torch."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.recon.method import MethodResult
from nlos.recon.methods import find

Floats = npt.NDArray[np.float32]
Depths = npt.NDArray[np.float64]


def see(transient: Transient, module: nn.Module, device: str = "cpu") -> tuple[MethodResult[Floats], Depths]:
    """What a method built for this wall and time axis makes of one transient, and the depths of its planes, (D,)."""
    module = module.to(device)
    with torch.inference_mode():
        counts = torch.from_numpy(np.ascontiguousarray(transient.counts))[None, None].to(device)
        exposure_s = torch.from_numpy(np.ascontiguousarray(transient.exposure_s))[None].to(device)
        made: MethodResult[torch.Tensor] = module(counts, exposure_s)
    planes = module.depths_m
    depths_m = np.asarray(planes.cpu() if isinstance(planes, torch.Tensor) else planes, dtype=np.float64)
    volume = None if made.volume is None else made.volume[0].cpu().numpy()
    return MethodResult(made.albedo[0].cpu().numpy(), made.depth_m[0].cpu().numpy(), volume), depths_m


@lru_cache(maxsize=4)
def built(method: str, settings: Settings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    """The method of that name in the catalogue, kept for the next transient of the same shape."""
    return find(method).build(settings, wall, time).eval()
