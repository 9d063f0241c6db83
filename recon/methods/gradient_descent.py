"""Steepest descent on the Tikhonov problem: the plain iteration that learned unfoldings start from."""

from typing import Annotated, ClassVar

import torch
from pydantic import Field

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.light_cone_method import LightConeMethod
from nlos.recon.parts import counted
from nlos.recon.physics_settings import LightConeSettings
from nlos.recon.transport.light_cone import Snr
from nlos.recon.transport.response_bands import BANDS, bands_of
from nlos.recon.transport.response_on_cone import ResponseOnCone

AXES = (-3, -2, -1)
SMOOTHED = 0.01  # gradients below this part of the albedo's maximum are not kept sharp by total variation


class Settings(LightConeSettings):
    """Settings of steepest descent; 1 / snr is the weight of the Tikhonov term."""

    cubes: ClassVar[float] = 9.5
    told_spectra: ClassVar[float] = 3.0

    iterations: Annotated[int, Field(ge=1, le=10_000)] = 30
    """Steps of the descent."""
    momentum: bool = False
    """Conjugate directions in place of the plain gradient."""
    tv: Annotated[float, Field(ge=0)] = 0.0
    """Weight of total variation, relative to the Tikhonov term at the albedo's own level."""


class GradientDescent(LightConeMethod):
    """(B, C, T, H, W) counts -> (B, C, D, H, W), not below 0.

    Minimises |H u - y|^2 / 2 + |u|^2 / (2 snr) + tv TV(u) on the light cone, from u = 0, with the exact step of the
    quadratic (that majorises TV where there is one). Source: the unfolded iteration u - dt (H*(H u - y) + u / snr).
    """

    settings: Settings

    def solved(self, signal: torch.Tensor, snr: Snr, response: torch.Tensor | None) -> torch.Tensor:
        """The albedo after all iterations; a `response` (1, K) is part of the forward model."""
        y = self.resample(signal)
        ridge = (1 / torch.as_tensor(snr, dtype=y.dtype, device=y.device)).expand(len(y)).view(-1, 1, 1, 1, 1)
        return self._descend(y, ridge, None if response is None else self._recorded(signal, response))

    def _recorded(self, signal: torch.Tensor, response: torch.Tensor) -> ResponseOnCone:
        """What the instrument makes of light on the cone."""
        profile, padded = signal.mean(dim=(0, 1, 3, 4)).cpu().numpy(), self.cone.padded[0]
        taps = response[0].cpu().double().numpy()
        bands = bands_of(profile, BANDS, taps, self.time, self.resample.cells, padded)
        return ResponseOnCone(bands, self.resample.matrix, padded)

    def _descend(self, y: torch.Tensor, ridge: torch.Tensor, recorded: ResponseOnCone | None = None) -> torch.Tensor:
        u = torch.zeros_like(y)
        residual = -y
        direction, before = torch.zeros_like(y), torch.ones_like(ridge)
        for _ in counted(range(self.settings.iterations), self.settings.iterations, "iterations"):
            unmatched = residual if recorded is None else recorded.adjoint(residual)
            gradient = self.cone.adjoint(unmatched) + ridge * u
            weights = self._tv_weights(u, ridge)
            if weights is not None:
                gradient = gradient - _divergence(weights * _gradient(u))
            squared = _dot(gradient, gradient)
            keep = squared / before if self.settings.momentum else torch.zeros_like(squared)
            direction, before = keep * direction - gradient, squared.clamp(min=1e-30)
            seen = self.cone(direction)
            if recorded is not None:
                seen = recorded(seen)
            curvature = _dot(seen, seen) + ridge * _dot(direction, direction)
            if weights is not None:
                curvature = curvature + (weights * _gradient(direction).square()).sum((0, 2, 3, 4, 5)).view_as(ridge)
            step = -_dot(gradient, direction) / curvature.clamp(min=1e-30)
            u, residual = u + step * direction, residual + step * seen
        return u

    def _tv_weights(self, u: torch.Tensor, ridge: torch.Tensor) -> torch.Tensor | None:
        """Lagged diffusivity: the weights with which |gradient|^2 touches smoothed total variation from above."""
        if self.settings.tv == 0:
            return None
        level = u.abs().amax((1, 2, 3, 4), keepdim=True)
        magnitude = (_gradient(u) / level.clamp(min=1e-30)).square().sum(0) + SMOOTHED**2
        return (level > 0) * self.settings.tv * ridge / magnitude.sqrt()


def _dot(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    return (a * b).sum((1, 2, 3, 4), keepdim=True)


def _gradient(u: torch.Tensor) -> torch.Tensor:
    """Forward differences with 0 at the far edges, (3, B, C, V, H, W)."""
    parts = []
    for axis in AXES:
        part = torch.zeros_like(u)
        part.narrow(axis, 0, u.shape[axis] - 1).copy_(u.diff(dim=axis))
        parts.append(part)
    return torch.stack(parts)


def _divergence(field: torch.Tensor) -> torch.Tensor:
    """Minus the transpose of `_gradient`."""
    total = torch.zeros_like(field[0])
    for part, axis in zip(field, AXES, strict=True):
        inner = part.narrow(axis, 0, part.shape[axis] - 1)
        total.narrow(axis, 0, inner.shape[axis]).add_(inner)
        total.narrow(axis, 1, inner.shape[axis]).sub_(inner)
    return total


def build(settings: AnySettings, wall: WallGrid, time: TimeAxis) -> GradientDescent:
    """The iteration for one geometry."""
    assert isinstance(settings, Settings)
    return GradientDescent(settings, wall, time)
