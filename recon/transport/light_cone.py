"""Light transport on the light cone: a convolution, and its regularised inverses.

Where v = (c t / 2)^2 and s = z^2, light from (x, y, s) reaches the wall point at lateral distance rho at v = s + rho^2
(O'Toole et al., Nature 2018, eq. 3): a convolution with delta(v - x^2 - y^2), whose spectrum `light_cone_kernel.py`
has in closed form.
"""

from typing import Any

import numpy as np
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.fourier import array_of, tensor_of
from nlos.recon.transport.light_cone_filter import Gain, LightConeFilter
from nlos.recon.transport.linear import linear
from nlos.recon.transport.response_bands import gain_of_both

Snr = float | torch.Tensor


class LightConeConvolution(nn.Module):
    """The light-cone kernel over (B, C, V, H, W), V the cells of `LightConeResampling`; see `LightConeFilter`."""

    def __init__(
        self, wall: WallGrid, time: TimeAxis, conventions: Conventions = "physical", tile: int | None = None
    ) -> None:
        super().__init__()
        self.filter = LightConeFilter(wall, time, conventions, tile)
        self.wall, self.time, self.conventions = wall, time, conventions
        self.cells, self.padded = self.filter.cells, self.filter.padded

    def forward(self, u: torch.Tensor, gain: torch.Tensor | None = None) -> torch.Tensor:
        """What the wall sees of albedo `u`: H u; each frequency along v times a real `gain` (F,) where given."""
        weight = None if gain is None else _plane_gain(gain.to(u.device, u.dtype))
        return linear(u, lambda x: self._filtered(x, False, weight), lambda y: self._filtered(y, True, weight))

    def adjoint(self, y: torch.Tensor, gain: torch.Tensor | None = None) -> torch.Tensor:
        """Back-projection on the light cone: H* y; each frequency along v times a real `gain` (F,) where given."""
        weight = None if gain is None else _plane_gain(gain.to(y.device, y.dtype))
        return linear(y, lambda x: self._filtered(x, True, weight), lambda x: self._filtered(x, False, weight))

    def wiener(self, y: torch.Tensor, snr: Snr, response: torch.Tensor | None = None) -> torch.Tensor:
        """The Wiener inverse conj(H) / (|H|^2 + 1 / snr) applied to `y`.

        `snr` is against a kernel of mean power 1: one number, or one a sample, (B,) or (B, C); differentiable in both.
        With a `response` K (B, C, F), complex, along v (`response_bands.py`) it inverts H K; `snr` is then constant.
        """
        if response is not None:
            return self._wiener_of_both(y, snr, response)
        if isinstance(snr, torch.Tensor):
            level = _one_each(snr.to(y.device), y)
            result: torch.Tensor = _Wiener.apply(y, level, self)  # type: ignore[no-untyped-call]
            return result
        if not snr > 0:
            raise ValueError(f"snr is {snr:g}; it must be above 0 (try 0.1)")
        gain = _wiener_gain(torch.full((y.shape[0] * y.shape[1],), snr, dtype=y.dtype, device=y.device))
        return linear(y, lambda x: self._filtered(x, True, gain), lambda x: self._filtered(x, False, gain))

    def wiener_of_each(self, y: torch.Tensor, snr: torch.Tensor) -> torch.Tensor:
        """`wiener` of one channel (B, 1, V, H, W) by each snr of (B, C), which is quicker; without a gradient."""
        gains = [_wiener_gain(each.to(y.device, y.dtype)) for each in snr.unbind(dim=1)]
        done = self.filter.by_each(array_of(y[:, 0]), True, gains)
        return torch.stack([tensor_of(each) for each in done], dim=1)

    def _wiener_of_both(self, y: torch.Tensor, snr: Snr, response: torch.Tensor) -> torch.Tensor:
        """conj(H K) / (|H K|^2 + 1 / snr) applied to `y`."""
        level = _one_each(torch.as_tensor(snr, dtype=y.dtype, device=y.device).detach(), y)
        spread = response.to(y.device).expand(*y.shape[:2], -1).flatten(0, 1)
        noise, k = array_of((1 / level)[:, None, None, None]), array_of(spread)
        there, back = gain_of_both(noise, k), gain_of_both(noise, k, adjoint=True)
        return linear(y, lambda x: self._filtered(x, True, there), lambda x: self._filtered(x, False, back))

    def gram_inverse(
        self, y: torch.Tensor, snr: torch.Tensor, flatness: float, response: torch.Tensor | None = None
    ) -> torch.Tensor:
        """(H* H + (flatness + G) / snr)^-1 H* y: the Gram operator's inverse under a prior of small gradients.

        G is the spectrum of the squared gradient, mean 1/2 a direction; `snr` (B,), (B, 1) or (B, C). With a `response`
        K (B, C, F), complex, along v it is that of H K. Source: Ahn et al., ICCV 2019, whose convolution H* H becomes
        exact on the light cone.
        """
        sizes = (self.padded[0] // 2 + 1, self.padded[1] // 2 + 1, self.padded[2] // 2 + 1)
        along = [
            torch.sin(torch.arange(count) * (torch.pi / size)).square().to(y.device, y.dtype)
            for count, size in zip(sizes, self.padded, strict=True)
        ]
        lateral = flatness + along[1][:, None] + along[2]
        noise = (1 / _one_each(snr.to(y.device, y.dtype), y))[:, None, None, None]

        spread = None if response is None else array_of(response.to(y.device).expand(*y.shape[:2], -1).flatten(0, 1))

        def gain(power: Any, planes: slice, adjoint: bool = False) -> Any:
            prior = _beside(power, lateral) + _beside(power, along[0])[planes][:, None, None]
            weight = prior * _beside(power, noise)
            return 1 / (power + weight) if spread is None else gain_of_both(weight, spread, adjoint)(power, planes)

        return linear(
            y,
            lambda x: self._filtered(x, True, gain),
            lambda x: self._filtered(x, False, lambda power, planes: gain(power, planes, adjoint=True)),
        )

    def transfer(self, planes: slice = slice(None)) -> torch.Tensor:
        """See `LightConeFilter.transfer`."""
        return torch.from_numpy(self.filter.transfer(planes))

    def _filtered(self, x: torch.Tensor, conjugate: bool, gain: Gain | None = None) -> torch.Tensor:
        """x * H, or x * conj(H), times a gain that may depend on |H|^2."""
        batch, channels, *size = x.shape
        done = self.filter(array_of(x.reshape(batch * channels, *size)), conjugate, gain)
        return tensor_of(done).reshape(x.shape)


class _Wiener(torch.autograd.Function):
    """The Wiener inverse as a function of the data and of the snr."""

    @staticmethod
    def forward(ctx: Any, y: torch.Tensor, snr: torch.Tensor, cone: LightConeConvolution) -> torch.Tensor:
        y = y.float() if y.dtype in (torch.float16, torch.bfloat16) else y
        ctx.save_for_backward(y, snr)
        ctx.cone = cone
        return cone._filtered(y, True, _wiener_gain(snr.to(y.dtype)))

    @staticmethod
    def backward(ctx: Any, *gradients: torch.Tensor) -> tuple[torch.Tensor | None, torch.Tensor | None, None]:
        y, snr = ctx.saved_tensors
        cone: LightConeConvolution = ctx.cone
        of_data = of_snr = None
        if ctx.needs_input_grad[0]:
            of_data = cone._filtered(gradients[0], False, _wiener_gain(snr.to(y.dtype)))
        if ctx.needs_input_grad[1]:
            slope = cone._filtered(y, True, _wiener_slope(snr.to(y.dtype)))
            of_snr = (gradients[0] * slope).sum((2, 3, 4)).reshape(snr.shape).to(snr.dtype)
        return of_data, of_snr, None


def _wiener_gain(snr: torch.Tensor) -> Gain:
    """1 / (|H|^2 + 1 / snr) for one snr a sample, (N,)."""
    noise = (1 / snr.detach())[:, None, None, None]
    return lambda power, planes: 1 / (power + _beside(power, noise))


def _wiener_slope(snr: torch.Tensor) -> Gain:
    """The derivative of `_wiener_gain` in snr."""
    noise = (1 / snr.detach())[:, None, None, None]
    return lambda power, planes: (_beside(power, noise) / (power + _beside(power, noise))) ** 2


def _plane_gain(gain: torch.Tensor) -> Gain:
    """The same at every lateral frequency, (F,)."""
    values = gain[:, None, None]
    return lambda power, planes: _beside(power, values)[planes]


def _beside(power: Any, constants: torch.Tensor) -> Any:
    return constants.numpy() if isinstance(power, np.ndarray) else constants


def _one_each(snr: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    """snr (), (B,), (B, 1) or (B, C) -> one number a sample and channel, (B * C,)."""
    batch, channels = y.shape[:2]
    if snr.ndim == 1:
        snr = snr[:, None]
    return snr.expand(batch, channels).reshape(batch * channels)
