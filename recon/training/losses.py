"""What training minimises, and the two figures it watches: picture, depth, and smoothness of the volume."""

from collections.abc import Mapping
from typing import Annotated

import torch
import torch.nn.functional as F
from pydantic import Field

from nlos.configs.settings import Settings
from nlos.recon.method import MethodResult

LEAST_ERROR = 3e-4
"""Mean square error below which a picture is as good as perfect: 35 dB."""

NotBelow0 = Annotated[float, Field(ge=0)]


class LossSettings(Settings):
    """Weights of the terms; 0 skips one."""

    picture: NotBelow0 = 10.0
    """Weight of the square error of the front view."""
    log_picture: NotBelow0 = 0.0
    """Weight of the mean logarithm of the pictures' square errors, halfway between own and best scale: decibels."""
    depth: NotBelow0 = 0.3
    """Weight of the depth error, where there is a surface."""
    total_variation: NotBelow0 = 0.0
    """Weight of the volume's total variation."""


def picture_of(batch: Mapping[str, torch.Tensor]) -> torch.Tensor:
    """The picture that a reconstruction is to show, (B, H, W): intensity divided by its maximum."""
    intensity = batch["intensity"]
    return intensity / intensity.amax(dim=(1, 2), keepdim=True).clamp(min=1e-6)


def losses(
    prediction: MethodResult[torch.Tensor], batch: Mapping[str, torch.Tensor], settings: LossSettings
) -> dict[str, torch.Tensor]:
    """The weighted terms and their sum, `loss`: mean square error of the picture, smooth L1 of the depth in metres.

    Depth counts where there is something, by its coverage. Total variation is the isotropic one of the volume
    (NANO, section IV-D), which a method without volume does not have.
    """
    albedo, depth = prediction.albedo.float(), prediction.depth_m.float()
    volume = None if prediction.volume is None else prediction.volume.float()
    truth, terms = picture_of(batch), {}
    if settings.picture:
        terms["picture"] = settings.picture * F.mse_loss(albedo, truth)
    if settings.log_picture:
        own = (albedo - truth).square().mean(dim=(1, 2))
        error = 0.5 * (own + (best_scale(albedo, truth) * albedo - truth).square().mean(dim=(1, 2)))
        terms["log_picture"] = settings.log_picture * (error + LEAST_ERROR).log().mean()
    if settings.depth:
        weight = batch["coverage"] * (batch["depth_m"] > 0)
        error = F.smooth_l1_loss(depth, batch["depth_m"], beta=0.05, reduction="none")
        per_sample = (error * weight).sum(dim=(1, 2)) / weight.sum(dim=(1, 2)).clamp(min=1)
        terms["depth"] = settings.depth * per_sample.mean()
    if settings.total_variation and volume is not None:
        terms["total_variation"] = settings.total_variation * total_variation(volume)
    terms["loss"] = torch.stack(list(terms.values())).sum()
    return terms


def best_scale(picture: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """The factor (B, 1, 1) that brings a picture nearest to the truth, within a factor of 5, without gradient."""
    power = picture.square().sum(dim=(1, 2), keepdim=True).clamp(min=1e-6)
    return ((picture * truth).sum(dim=(1, 2), keepdim=True) / power).detach().clamp(0.2, 5.0)


def total_variation(volume: torch.Tensor) -> torch.Tensor:
    """Mean length of the gradient of (B, D, H, W)."""
    steps = [torch.diff(volume, dim=d, append=volume.select(d, -1).unsqueeze(d)) for d in (1, 2, 3)]
    return torch.stack(steps).square().sum(dim=0).add(1e-12).sqrt().mean()


def psnr(picture: torch.Tensor, truth: torch.Tensor) -> torch.Tensor:
    """Decibels of each picture (B, H, W) at its best least-squares scale against a truth of maximum 1, shape (B,)."""
    scale = (picture * truth).sum(dim=(1, 2)) / picture.square().sum(dim=(1, 2)).clamp(min=1e-12)
    error = (scale[:, None, None] * picture - truth).square().mean(dim=(1, 2))
    return -10 * torch.log10(error + 1e-8)
