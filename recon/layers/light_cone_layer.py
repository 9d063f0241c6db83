"""The light cone inside a network: channels over time in, channels over depth out, at a given falloff and snr."""

import numpy as np
import torch
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData, InvalidSettings
from nlos.recon.layers.counts import added
from nlos.recon.layers.light_cone_inverse import LightConeInverse, undone
from nlos.recon.transport.conventions import depths_m


class LightConeLayer(nn.Module):
    """(B, C, T, H, W), exponent (B,), snr (B, C) -> (B, C, D, H, W); differentiable in the data and the snr.

    Voxels are averaged to slices of about `slice_widths` wall widths; those between `nearest` and `farthest` wall
    widths come out, at `depths_m` (D,).
    """

    depths_m: Tensor
    relative: Tensor

    def __init__(
        self,
        wall: WallGrid,
        time: TimeAxis,
        slice_widths: float = 0.0096,
        nearest: float = 0.125,
        farthest: float = 2.0,
    ) -> None:
        super().__init__()
        centres = depths_m(time, "physical")
        if centres[-1] <= nearest * wall.width_m:
            raise InvalidData(
                f"the time axis ends {centres[-1]:.3g} m from the wall; a network for a wall of {wall.width_m:g} m "
                f"needs light from beyond {nearest * wall.width_m:.3g} m. Record a longer time axis."
            )
        self.slice = max(1, round(slice_widths * wall.width_m / (centres[1] - centres[0])))
        whole = time.bins // self.slice * self.slice
        slices = centres[:whole].reshape(-1, self.slice).mean(axis=1)
        chosen = np.flatnonzero((slices >= nearest * wall.width_m) & (slices <= farthest * wall.width_m))
        if not chosen.size:
            raise InvalidSettings(
                f"farthest is {farthest:g} wall widths, {farthest * wall.width_m:.3g} m; a network looks from "
                f"{nearest * wall.width_m:.3g} m on. Set it to more than {nearest:g}, far enough for the scene."
            )
        self.first, self.last = int(chosen[0]) * self.slice, (int(chosen[-1]) + 1) * self.slice
        self.register_buffer("depths_m", torch.from_numpy(slices[chosen]).float(), persistent=False)
        relative = np.maximum(centres, 0) / centres[-1]
        self.register_buffer("relative", torch.from_numpy(relative).float(), persistent=False)
        self.inverse = LightConeInverse(wall, time)

    def forward(self, x: Tensor, exponent: Tensor, snr: Tensor) -> Tensor:
        with torch.autocast(x.device.type, enabled=False):
            planes: Tensor = self.inverse(x.float() * undone(self.relative, exponent), snr)[
                :, :, self.first : self.last
            ]
            mean: Tensor = added(planes, self.slice, planes.shape[2] // self.slice) / self.slice
            return mean
