"""Multi-scale unfolding by small complex kernels over the frequency grid, as the paper prints it.

Such a kernel is a window in space and stride 2 over frequencies folds the volume, so this is no filter of physical
frequencies; it is built because the paper's tables are about it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, cast

import torch
from torch import Tensor, nn

from nlos.recon.layers.complex_activation import ActivationName
from nlos.recon.layers.complex_convolution import ComplexConv3d
from nlos.recon.layers.complex_mlp import ComplexMLP
from nlos.recon.layers.frequency_encoding import DenseFrequencyEncoding
from nlos.recon.layers.noise_operator import Meeting, NoiseEmbedding, NoiseInducedOperator
from nlos.recon.layers.spectral_scales import AXES, Prolong, Prolongation, Restrict, Restriction, shifted, unshifted


@dataclass(frozen=True)
class Readings:
    """Where the paper leaves a choice; see the method's settings of the same names."""

    activation: ActivationName = "prelu"
    operator_activation: ActivationName = "tanh"
    operator_kernel: int = 1
    meeting: Meeting = "added"
    embedding: Literal["each_scale", "shared"] = "each_scale"
    restriction: Restriction = "stride"
    prolongation: Prolongation = "insertion"
    whiten: bool = False
    sfe_bandwidth: int = 0
    sfe_place: Literal["instead", "beside"] = "instead"
    sfe_redrawn: bool = False

    def operator(self, channels: int) -> NoiseInducedOperator:
        """An NLO for so many channels."""
        return NoiseInducedOperator(channels, self.operator_activation, self.operator_kernel, self.meeting)


PUBLISHED = Readings()


class LiteralIteration(nn.Module):
    """u^ <- u^ + Conv_C(u_g + S_eta u^), the step size absorbed in the convolution (NANO, eq. 12)."""

    def __init__(self, channels: int, readings: Readings):
        super().__init__()
        self.operator = readings.operator(channels)
        self.convolution = ComplexConv3d(channels, channels, gain=0.1)

    def forward(self, u: Tensor, guide: Tensor, lifted: Tensor | None, embedding: Tensor) -> Tensor:
        out: Tensor = self.convolution(guide + self.operator(u, lifted, embedding))
        return u + out


class EncodedIteration(nn.Module):
    """The same with S u^ from stochastic frequency encoding and its complex MLP (eq. 13): the last at the coarsest.
    With `sfe_place` at `beside`, S u^ is the sum of that and of an operator like the others'."""

    def __init__(self, channels: int, readings: Readings):
        super().__init__()
        self.encoding = DenseFrequencyEncoding(
            channels, readings.sfe_bandwidth, activation=readings.activation, redrawn=readings.sfe_redrawn
        )
        self.beside = readings.operator(channels) if readings.sfe_place == "beside" else None
        self.convolution = ComplexConv3d(channels, channels, gain=0.1)

    def forward(self, u: Tensor, guide: Tensor, lifted: Tensor | None, embedding: Tensor) -> Tensor:
        step = guide + self.encoding(u)
        if self.beside is not None:
            step = step + self.beside(u, lifted, embedding)
        out: Tensor = self.convolution(step)
        return u + out


def whitening(size: Sequence[int], device: torch.device) -> Tensor:
    """sqrt(1 + (f / 1.5)^2) on the shifted grid, f in cycles per volume: pictures fall off about as 1 / f."""
    axes = [torch.arange(n, device=device) - n // 2 for n in size]
    z, y, x = torch.meshgrid(*axes, indexing="ij")
    return (1 + (z.square() + y.square() + x.square()) / 1.5**2).sqrt()


class SpectralUnfolding(nn.Module):
    """B_p . Phi_eta . B_l (section IV-B2): u^0 = MLP_C(u~^0), J scales of n_j iterations on (u^, F^_st, u_g) each
    restricted for itself, skips upwards, u~ = MLP_C(u^K).

    start u^{s-1} (B, 1, D, H, W), lifted F_st (B, L, D, H, W) or None, guide u_g (B, 1, D, H, W), all real, over cells
    in which light transport is a convolution; eta (B, conditions) -> (B, 1, D, H, W) real. With every convolution of
    the iterations and of the way up at zero the result is `start`.
    """

    def __init__(
        self,
        channels: Sequence[int],
        iterations: int = 2,
        lifted: int = 4,
        conditions: int = 1,
        readings: Readings = PUBLISHED,
    ):
        super().__init__()
        self.readings, activation = readings, readings.activation
        finest = channels[0]
        self.lift = ComplexMLP(1, 2 * finest, finest, activation, start_as_identity=True)
        self.take_guide = ComplexConv3d(1, finest, kernel=1)
        self.take_lifted = ComplexConv3d(lifted, finest, kernel=1) if lifted else None
        self.channels = tuple(channels)
        told = channels if readings.embedding == "each_scale" else [max(channels)]
        self.embeddings = nn.ModuleList(NoiseEmbedding(conditions, width) for width in told)
        self.iterations = nn.ModuleList(
            nn.ModuleList(LiteralIteration(width, readings) for _ in range(iterations)) for width in channels
        )
        if readings.sfe_bandwidth:
            del cast(nn.ModuleList, self.iterations[-1])[-1]  # the encoded one is the last of the coarsest scale
        pairs = list(pairwise(channels))
        kinds = 2 + bool(lifted)
        self.restrict = nn.ModuleList(
            nn.ModuleList(Restrict(fine, coarse, readings.restriction) for _ in range(kinds)) for fine, coarse in pairs
        )
        self.prolong = nn.ModuleList(
            Prolong(coarse, fine, readings.restriction, readings.prolongation) for fine, coarse in pairs
        )
        self.aggregate = nn.ModuleList(ComplexConv3d(fine, fine, gain=0.1) for fine, _ in pairs)
        self.encoded = EncodedIteration(channels[-1], readings) if readings.sfe_bandwidth else None
        self.project = ComplexMLP(finest, 2 * finest, 1, activation, start_as_identity=True)

    def forward(self, start: Tensor, lifted: Tensor | None, guide: Tensor, eta: Tensor) -> Tensor:
        states = [self.lift(self.spectrum(start)), self.take_guide(self.spectrum(guide))]
        if self.take_lifted is not None:
            assert lifted is not None
            states.append(self.take_lifted(self.spectrum(lifted)))
        u = self.project(self.multiscale(states, eta))
        with torch.autocast(start.device.type, enabled=False):
            if self.readings.whiten:
                u = u / whitening(u.shape[2:], u.device)
            volume: Tensor = torch.fft.ifftn(unshifted(u), dim=AXES, norm="ortho").real
        return volume

    def spectrum(self, field: Tensor) -> Tensor:
        """(B, C, D, H, W) real -> its spectrum, zero frequency in the middle, whitened where that is asked for."""
        with torch.autocast(field.device.type, enabled=False):
            spectrum = shifted(torch.fft.fftn(field.float(), dim=AXES, norm="ortho"))
            return spectrum * whitening(field.shape[2:], field.device) if self.readings.whiten else spectrum

    def embedded(self, eta: Tensor) -> list[Tensor]:
        """eta^ of every scale (B, C, 1, 1, 1): an MLP's own, or as many channels as it has of one for all."""
        if self.readings.embedding == "each_scale":
            return [embed(eta) for embed in self.embeddings]
        whole = self.embeddings[0](eta)
        return [whole[:, :width] for width in self.channels]

    def multiscale(self, states: list[Tensor], eta: Tensor) -> Tensor:
        """Phi_eta on the lifted spectra (u^0, u_g[, F^_st])."""
        outputs: list[Tensor] = []
        for scale, embedding in enumerate(self.embedded(eta)):
            if scale:
                layers = cast(nn.ModuleList, self.restrict[scale - 1])
                states = [layer(x) for layer, x in zip(layers, states, strict=True)]
            u, guide, lifted = (*states, None)[:3]
            assert u is not None
            assert guide is not None
            for iteration in cast(nn.ModuleList, self.iterations[scale]):
                u = iteration(u, guide, lifted, embedding)
            if self.encoded is not None and scale == len(self.channels) - 1:
                u = self.encoded(u, guide, lifted, embedding)
            states = [u, *states[1:]]
            outputs.append(u)
        u = outputs.pop()
        for scale in range(len(outputs) - 1, -1, -1):
            fine = outputs[scale]
            raised = fine + self.prolong[scale](u, fine.shape[2:])
            u = raised + self.aggregate[scale](raised)
        return u
