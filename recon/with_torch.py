"""Runs a method of the catalogue on a transient, by torch."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.recon.front_view import depth_map, front_view
from nlos.recon.methods import find
from nlos.recon.volume import Volume

Image = npt.NDArray[np.float32]


def see(transient: Transient, method: str, settings: Settings, device: str) -> tuple[Image, Image, Volume | None]:
    """Front view (H, W), depth map in metres (H, W), and the volume where the method has one."""
    module = _module(method, settings, transient.wall, transient.time).to(device)
    with torch.inference_mode():
        counts = torch.from_numpy(np.ascontiguousarray(transient.counts))[None, None].to(device)
        exposure_s = torch.from_numpy(np.ascontiguousarray(transient.exposure_s))[None].to(device)
        seen = module(counts, exposure_s)
    if isinstance(seen, torch.Tensor):
        volume = Volume(seen[0, 0].cpu().numpy(), _depths_m(module), transient.wall)
        return front_view(volume), depth_map(volume), volume
    albedo, depth_m, learned_volume = seen
    whole = None
    if learned_volume is not None:
        whole = Volume(learned_volume[0].cpu().numpy(), _depths_m(module), transient.wall)
    return albedo[0].cpu().numpy(), depth_m[0].cpu().numpy(), whole


def _depths_m(module: nn.Module) -> npt.NDArray[np.float64]:
    depths_m = module.depths_m
    return np.asarray(depths_m.cpu() if isinstance(depths_m, torch.Tensor) else depths_m, dtype=np.float64)


@lru_cache(maxsize=4)
def _module(method: str, settings: Settings, wall: WallGrid, time: TimeAxis) -> nn.Module:
    return find(method).build(settings, wall, time).eval()
