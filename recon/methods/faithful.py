"""NANO exactly as its paper prints it, trained; every place where the paper leaves a choice is a setting."""

from dataclasses import dataclass
from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from pydantic import Field
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.any_noise import any_noise_for
from nlos.recon.layers.any_noise import AnyNoise, noise_traits, unless_photons
from nlos.recon.layers.complex_activation import ActivationName
from nlos.recon.layers.light_cone_fields import LightConeFields
from nlos.recon.layers.light_cone_inverse import brightest
from nlos.recon.layers.noise_level import NoiseLevel
from nlos.recon.layers.noise_operator import Meeting
from nlos.recon.layers.rates import Rates, rates_of
from nlos.recon.layers.spectral_scales import Prolongation, Restriction
from nlos.recon.layers.spectral_unfolding import Readings, SpectralUnfolding
from nlos.recon.layers.transient_lifting import LiftingName, TransientLifting
from nlos.recon.layers.volume_projection import MaximumProjection, Projection
from nlos.recon.method import MethodResult
from nlos.recon.weights.files import WeightsError, put_part, with_weights

MIDDLE_NOISE = -1.0
LEAST = 1e-12
DIMMEST = 0.02  # of the brightest point; below it there is no depth


class Settings(AnySettings):
    """The switches of the paper's tables, and the readings of what it does not say."""

    weights: str | None = "faithful"
    """Weights file, or a name of those that ship; none for an untrained network."""
    lifting: LiftingName = "both"
    """How the transient is lifted: from all points, from each point's surroundings, both, by an MLP, not at all."""
    projection: bool = True
    """Residual convolutions on the maximum projection; False: the bare maximum."""
    nle: bool = True
    """The operator is told the noise level; False: a middling one. `transport` says what falloff and snr follow."""
    noise_estimate: Literal["photons", "any_kind"] = "photons"
    """What tells the level: photon statistics alone, or where it contradicts them what lies below the light cone."""
    transport: Literal["adapted", "fixed"] = "adapted"
    """H_eta: falloff and snr of the inverse follow the noise level, or are those of a middling one."""
    middling: Annotated[float, Field(ge=-3, le=1)] = MIDDLE_NOISE
    """log10 of that middling noise level."""
    embedding: Literal["each_scale", "shared"] = "each_scale"
    """eta^ from an MLP of each scale, or from one for all."""
    meeting: Meeting = "added"
    """How eta^ and F_st come into NLO together."""
    operator_kernel: Literal[1, 3] = 1
    """Of NLO's two convolutions."""
    sfe: bool = True
    """Stochastic frequency encoding at the coarsest scale."""
    sfe_bandwidth: Annotated[int, Field(ge=1)] = 256
    """B. Its complex MLP grows with B^2; the paper's 66 M parameters mean about 5,700."""
    sfe_place: Literal["instead", "beside"] = "instead"
    """At the coarsest scale's last iteration: in the place of NLO, or added to it."""
    sfe_redrawn: bool = False
    """M is drawn anew at every step of training; otherwise once."""
    outer_iterations: Annotated[int, Field(ge=1, le=6)] = 1
    """S of algorithm 1."""
    channels: tuple[int, ...] = (8, 16, 32, 48, 64)
    """One entry per scale (J)."""
    iterations: Annotated[int, Field(ge=1)] = 2
    """A scale (n_j)."""
    start: Literal["inverse", "zero"] = "inverse"
    """u^0 of the first pass: the regularised inverse, or nothing."""
    guide: Literal["inverse", "adjoint"] = "inverse"
    """u_g: "approximated by the LCT solver", or H* tau itself."""
    depth_axis: Literal["squared", "metric"] = "squared"
    """The spectrum over z^2, where H is diagonal, or over z."""
    activation: ActivationName = "prelu"
    """In the complex MLPs."""
    operator_activation: ActivationName = "tanh"
    """In NLO. PReLU lets S u^ grow with the square of the data, which ten iterations do not survive; tanh bounds it."""
    restriction: Restriction = "stride"
    """How a coarser scale is made: every second frequency, or the lowest half of them."""
    prolongation: Prolongation = "insertion"
    """How strided frequencies return: with zeros between them, or spread by a transposed convolution."""
    whiten: bool = False
    """Weigh frequencies by about their own, since pictures fall off as 1 / f."""
    noise_weights: str | None = None
    """Noise level estimation from these weights, frozen: with `noise_estimate: any_kind` theirs of any kind, too."""


@dataclass(frozen=True)
class Prepared:
    """What one measurement gives to every pass."""

    start: Tensor  # (B, 1, cells, h, w)
    guide: Tensor  # (B, 1, cells, h, w)
    lifted: Tensor | None  # (B, 4, cells, h, w)
    log_noise: Tensor  # (B,)
    presence: Tensor  # (B,) 0 = nothing but noise


class Faithful(nn.Module):
    """G_eta = B_p . Phi_eta . B_l, then volume projection (Wang et al., section IV).

    counts (B, 1, T, H, W) and exposure (B, H, W) in any unit, 0 = not measured -> albedo (B, H, W), depth_m (B, H, W),
    NaN where nothing is seen, and the volume (B, D, H, W). Lifting halves the wall's resolution, so u, u_g and F_st
    live on ceil(H / 2) x ceil(W / 2) points; the projection enlarges its picture again, as LFE's does.
    """

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis):
        super().__init__()
        self.settings, self.size = settings, (wall.rows, wall.cols)
        self.physics = LightConeFields(wall, time)
        self.depths_m = self.physics.depths.double().numpy() * self.physics.unit_m
        self.noise_level = NoiseLevel()
        self.lifting = None if settings.lifting == "none" else TransientLifting(settings.lifting)
        self.unfolding = SpectralUnfolding(
            settings.channels,
            settings.iterations,
            lifted=4 if self.lifting else 0,
            readings=Readings(
                activation=settings.activation,
                operator_activation=settings.operator_activation,
                operator_kernel=settings.operator_kernel,
                meeting=settings.meeting,
                embedding=settings.embedding,
                restriction=settings.restriction,
                prolongation=settings.prolongation,
                whiten=settings.whiten,
                sfe_bandwidth=settings.sfe_bandwidth if settings.sfe else 0,
                sfe_place=settings.sfe_place,
                sfe_redrawn=settings.sfe_redrawn,
            ),
        )
        self.projection = MaximumProjection(finish=settings.projection)
        self.any_noise = AnyNoise() if settings.noise_estimate == "any_kind" else None
        for name, parameter in self.named_parameters():
            parameter.requires_grad = not name.startswith(("noise_level.", "any_noise."))

    def forward(self, counts: Tensor, exposure: Tensor | None = None) -> MethodResult[Tensor]:
        given = self.prepared(counts, exposure)
        u = given.start
        for _ in range(self.settings.outer_iterations):
            u = self.one_pass(u, given.lifted, given.guide, given.log_noise)
        seen = self.project(u)
        albedo, depth_m, volume = seen.albedo, seen.depth * self.physics.unit_m, seen.volume
        if not self.training:
            albedo = albedo.clamp(min=0) * given.presence[:, None, None]
            dark = albedo <= DIMMEST * albedo.amax(dim=(1, 2), keepdim=True)
            depth_m = torch.where(dark, torch.nan, depth_m)
            volume = F.interpolate(volume, size=self.size, mode="bilinear", align_corners=False)
        return MethodResult(albedo, depth_m, volume)

    def prepared(self, counts: Tensor, exposure: Tensor | None) -> Prepared:
        """u^0 of the first pass, F_st and u_g, and the noise level. With `start` and `guide` at `inverse` the first
        and the last are the same; F_st has a source of its own."""
        rates = rates_of(self.physics.rebin(counts), exposure)
        log_noise = self.noise(rates)
        adapted = self.settings.transport == "adapted"
        undoing = log_noise if adapted else torch.full_like(log_noise, self.settings.middling)
        tau = self.physics.slices(rates.net)
        light = self.physics.squared(tau, undoing)
        inverse = self.physics.inverse(light, undoing)
        inverse = halved(inverse / brightness(self.physics.metric(inverse))[:, None, None, None, None])
        guide = inverse if self.settings.guide == "inverse" else scaled(halved(self.physics.adjoint(light)), inverse)
        lifted = None if self.lifting is None else self.physics.squared(self.lifting(tau).float(), undoing)
        if self.settings.depth_axis == "metric":
            guide = scaled(self.physics.metric(guide), guide)
            inverse = self.physics.metric(inverse)
            lifted = None if lifted is None else self.physics.metric(lifted)
        if lifted is not None:
            lifted = scaled(lifted, torch.ones_like(lifted[:, :1, :1, :1, :1]))
        start = inverse if self.settings.start == "inverse" else torch.zeros_like(inverse)
        return Prepared(start, guide, lifted, log_noise, rates.presence)

    @torch.no_grad()
    def noise(self, rates: Rates) -> Tensor:
        """eta, log10 of the noise level, (B,)."""
        eta, _, known = self.noise_level.everywhere(rates.raw, rates.exposure)
        if self.any_noise is None:
            return eta
        wall, fine = self.physics.wall, self.physics.fine
        with torch.autocast(eta.device.type, enabled=False):
            traits = noise_traits(rates, known, eta, (wall.height_m, wall.width_m), fine.bin_width_s)
            any_kind = torch.where(rates.presence > 0, self.any_noise(traits, rates.kept), torch.nan)
            return unless_photons(eta, any_kind)

    def one_pass(self, u: Tensor, lifted: Tensor | None, guide: Tensor, log_noise: Tensor) -> Tensor:
        """u^s = G_eta(u^{s-1}, tau, eta), all (B, ., cells, h, w) (algorithm 1)."""
        told = log_noise.clamp(-2.5, 0.5) if self.settings.nle else torch.full_like(log_noise, self.settings.middling)
        eta = (told - MIDDLE_NOISE)[:, None]
        out: Tensor = self.unfolding(u, lifted, guide, eta)
        return out

    def project(self, u: Tensor) -> Projection:
        """u over its depth axis -> the volume at metric depths, its picture and depth map."""
        volume = self.physics.metric(u) if self.settings.depth_axis == "squared" else u
        out: Projection = self.projection(volume[:, 0], self.physics.depths, self.size)
        return out


def brightness(volume: Tensor) -> Tensor:
    """(B,) of the brightest surfaces of (B, 1, D, H, W), at least a quarter of the maximum: the unit ends here."""
    return torch.maximum(brightest(volume)[:, 0], volume.amax(dim=(1, 2, 3, 4)) / 4).clamp(min=LEAST)


def halved(x: Tensor) -> Tensor:
    """Means of 2 x 2 wall points, (B, C, D, H, W) -> (B, C, D, ceil(H / 2), ceil(W / 2))."""
    size = (x.shape[2], -(-x.shape[3] // 2), -(-x.shape[4] // 2))
    return F.adaptive_avg_pool3d(x, size)


def scaled(x: Tensor, like: Tensor) -> Tensor:
    """x with the root mean square of `like`, one sample at a time."""
    power, wanted = (y.float().square().mean(dim=(1, 2, 3, 4), keepdim=True) for y in (x, like))
    return x * (wanted / power.clamp(min=LEAST)).sqrt()


def put_any_noise(network: AnyNoise, weights: str) -> None:
    """The estimate of any kind that was fitted to the photon statistics of these weights of NANO. Raises WeightsError
    where there is none."""
    known = any_noise_for(weights)
    if known is None:
        raise WeightsError(
            f"{weights} comes without an estimate of noise of any kind, which `noise_estimate: any_kind` asks for: "
            "take `noise_weights: nano`, or `noise_estimate: photons`"
        )
    network.load_state_dict(known.state_dict())


def build(settings: AnySettings, wall: WallGrid, time_axis: TimeAxis) -> Faithful:
    """The network for this wall and time axis; raises WeightsError if the weights are not of this shape."""
    assert isinstance(settings, Settings)
    network = Faithful(settings, wall, time_axis)
    if settings.noise_weights is not None:
        put_part(network.noise_level, "noise_level.", settings.noise_weights)
        if network.any_noise is not None:
            put_any_noise(network.any_noise, settings.noise_weights)
    return with_weights(network, settings.weights)
