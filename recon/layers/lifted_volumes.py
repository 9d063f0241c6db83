"""Lifted transient features carried to object space: the light-cone change of variable on a coarse grid."""

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.light_cone_inverse import LightConeInverse
from nlos.recon.layers.noise_adapted import BY_NOISE_LEVEL, DIFFUSE
from nlos.recon.layers.told_response import MIDDLE, Told
from nlos.recon.layers.transient_lifting import LiftingName, TransientLifting
from nlos.recon.layers.wiener_volumes import WienerVolumes

UNDONE = 3.0  # of the falloff of diffuse surfaces


class LiftedVolumes(nn.Module):
    """tau -> F_st -> F^_st: lifting at the operator's pitch, then the noise-adapted Wiener inverse of every channel.

    The paper resamples F_st and transforms it; here it is inverted as well, so that lifted features lie where the
    surfaces are and a network in space can use them. net rates (B, 1, bins, H, W) -> (B, 4, slices, rows, cols), of
    root mean square 1 over the first `reach` slices, at the operator's depths and half its `points` (rows, cols) along
    the wall.
    """

    def __init__(self, kind: LiftingName, physics: WienerVolumes, points: tuple[int, int]):
        super().__init__()
        assert kind != "none"
        self.lifting = TransientLifting(kind)
        self.points = points
        rows, cols = (points[0] + 1) // 2, (points[1] + 1) // 2
        wall = WallGrid(physics.wall.width_m, physics.wall.height_m, rows, cols)
        self.slices = (physics.slices + 1) // 2
        extent_s = 2 * physics.slices * physics.pitch[0] * physics.unit_m / SPEED_OF_LIGHT_M_PER_S
        self.first = physics.first
        self.inverse = LightConeInverse(wall, TimeAxis(self.slices, extent_s / self.slices))
        fall = ((torch.arange(self.slices) + 0.5) / self.slices) ** max(0.0, UNDONE - (DIFFUSE - physics.falloff))
        self.register_buffer("fall", fall[:, None, None], persistent=False)

    fall: Tensor

    def forward(self, net: Tensor, log_noise: Tensor, reach: int, response: Told | None = None) -> Tensor:
        """A `response` is inverted as it is about the middle of the light."""
        tau = F.interpolate(net[:, :, self.first :], size=(self.slices, *self.points), mode="area")
        lifted = self.lifting(tau).float()
        spectrum = None if response is None else self.inverse.spectra(response)[:, MIDDLE]
        volume: Tensor = self.inverse(lifted * self.fall, BY_NOISE_LEVEL.snr(log_noise), spectrum)
        power = volume[:, :, : (reach + 1) // 2].square().mean(dim=(1, 2, 3, 4), keepdim=True)
        return volume / power.sqrt().clamp(min=1e-12)
