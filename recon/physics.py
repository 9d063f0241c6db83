"""What the physics methods share: the way counts become what their operators expect."""

import numpy as np
import numpy.typing as npt
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.recon.front_view import DepthBy, depth_map
from nlos.recon.gridding import fill_unmeasured
from nlos.recon.method import MethodResult
from nlos.recon.noise import estimate, without_background
from nlos.recon.physics_settings import PUBLISHED_SNR, PhysicsSettings
from nlos.recon.transport.falloff import Falloff
from nlos.recon.transport.response_over_time import without_response


def prepare(
    counts: torch.Tensor,
    exposure_s: torch.Tensor | None,
    settings: PhysicsSettings,
    time: TimeAxis,
    falloff: Falloff | None,
    response: torch.Tensor | None = None,
) -> tuple[torch.Tensor, float | torch.Tensor]:
    """Counts (B, C, T, H, W) as signal alone with its falloff undone, and the snr.

    Exposure is divided out, the background subtracted, points that were not measured are interpolated; how much of the
    falloff is undone, as far as there is light, and the snr follow from the noise found. Under the authors' conventions
    nothing is subtracted, all falloff undone, and the snr theirs. A `response` (B, K) is undone along time, before the
    falloff: for methods that have no place for it among their own steps.
    """
    rates = equally_exposed(counts, exposure_s)
    noise = estimate(rates, None if exposure_s is None else exposure_s > 0, time)
    physical = settings.conventions == "physical"
    found: float | torch.Tensor = noise.snr() if physical else PUBLISHED_SNR
    snr = found if settings.snr is None else settings.snr
    signal = without_background(rates, noise) if physical else rates.clone()
    if response is not None:
        signal = _without_response(signal, exposure_s, response)
    if falloff is not None:
        weights = falloff.weights(noise.undone() if physical else None)
        if physical:  # beyond the last light there is only noise, which must not be made the brightest of all
            held = torch.arange(time.bins, device=weights.device).minimum(noise.end[:, None] - 1)
            weights = weights.gather(2, held.view(len(held), 1, -1, 1, 1))
        signal *= weights.to(signal.dtype)
    if exposure_s is not None:
        signal = fill_unmeasured(signal, exposure_s > 0)
    return signal, snr


def _without_response(signal: torch.Tensor, exposure_s: torch.Tensor | None, response: torch.Tensor) -> torch.Tensor:
    """(B, C, T, H, W), each sample's response (B, K) undone along time."""
    measured = torch.ones_like(signal[:, 0, 0], dtype=torch.bool) if exposure_s is None else exposure_s > 0
    taps = response.expand(len(signal), -1).cpu().double().numpy()
    undone = [
        np.stack([without_response(each.cpu().numpy(), there.cpu().numpy(), numbers) for each in sample])
        for sample, there, numbers in zip(signal.detach(), measured, taps, strict=True)
    ]
    return torch.from_numpy(np.stack(undone)).to(signal)


def seen_in(
    volume: torch.Tensor, depths_m: npt.NDArray[np.float64], depth_by: DepthBy = depth_map
) -> MethodResult[torch.Tensor]:
    """A volume (B, 1, D, H, W) at `depths_m` with what one sees of it from the wall; the depth map has no gradient."""
    if volume.shape[1] != 1:
        raise ValueError(f"{volume.shape[1]} channels; a picture is made of one at a time")
    whole = volume[:, 0]
    maps = [depth_by(one.detach().cpu().numpy(), depths_m) for one in whole]
    return MethodResult(whole.amax(dim=1), torch.from_numpy(np.stack(maps)).to(volume.device), whole)


def equally_exposed(counts: torch.Tensor, exposure_s: torch.Tensor | None) -> torch.Tensor:
    """Counts (B, C, T, H, W) as if every point had been exposed for the mean exposure; 0 where none was measured."""
    if exposure_s is None or bool((exposure_s == exposure_s[:, :1, :1]).all()):
        return counts
    measured = exposure_s > 0
    mean = exposure_s.sum((-2, -1), keepdim=True) / measured.sum((-2, -1), keepdim=True).clamp(min=1)
    weight = torch.where(measured, mean / exposure_s.clamp(min=1e-30), 0.0)
    return counts * weight[:, None, None].to(counts.dtype)
