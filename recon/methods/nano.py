"""NANO: the noise-adapted neural operator, trained on 8 x 8 to 128 x 128 points (32 a wall inside), few photons."""

import math
from collections.abc import Callable, Mapping
from typing import cast

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.any_noise import any_noise_for
from nlos.recon.intervals import CalibratedHead, head_for, intervals_of
from nlos.recon.kept_noise import kept_noise
from nlos.recon.layers.any_noise import AnyNoise, noise_traits, unless_photons
from nlos.recon.layers.evidence import evidence
from nlos.recon.layers.fine_detail import halves, in_the_large, with_detail
from nlos.recon.layers.in_bfloat16 import in_bfloat16
from nlos.recon.layers.lifted_volumes import LiftedVolumes
from nlos.recon.layers.light_cone_inverse import brightest
from nlos.recon.layers.noise_level import NoiseLevel, noise_map_of
from nlos.recon.layers.operator_grid import to_grid
from nlos.recon.layers.physical_unfolding import PhysicalUnfolding
from nlos.recon.layers.prepared import Prepared
from nlos.recon.layers.rates import Rates, lit_bins, rates_of
from nlos.recon.layers.refinement import Refinement, as_it_was
from nlos.recon.layers.symmetries import Fields, mean_over_symmetries
from nlos.recon.layers.told_conditions import conditions, confidence
from nlos.recon.layers.told_response import Told
from nlos.recon.layers.volume_projection import AttentionProjection, MaximumProjection, Projection
from nlos.recon.layers.wiener_volumes import SLICE, TRAINED_SLICES, VOLUMES, WienerVolumes
from nlos.recon.method import MethodResult
from nlos.recon.method import sure as with_intervals
from nlos.recon.nano_settings import Settings as Settings
from nlos.recon.refined import correction_for
from nlos.recon.weights.companions import own_copy
from nlos.recon.weights.files import holds, put_part, with_weights

POINTS = 32  # per wall width: the operator's own pitch, whatever the scan's
CONDITIONS = 3
TOLD = "unfolding.response."  # the parameters of networks that are told the instrument's response
OWN_FEATURES = 2 * VOLUMES + 3  # volumes averaged and at their maximum, depth, confidence, the last pass
MIDDLE_NOISE = -1.0
FEWEST_SLICES = 80
PROFILE = 3  # slices before and behind a surface that the last network sees
FEWEST_LEFT = 48
MARGIN = 8  # slices behind the last light, and before the first
REFINED = 16  # points a side from which on pictures are refined: fitted at 32 and 64, it gains 0.1 dB at 16 to 22 too
DIMMEST = 0.003  # of the brightest point; below it there is no depth


class Nano(nn.Module):
    """G_eta = B_p . Phi_eta . B_l after noise level estimation, then volume projection (Wang et al., section IV).

    counts (B, 1, T, H, W) in any unit, exposure (B, H, W) in any unit, 0 = not measured, or None for an even one, and
    where it is known what an instant of light becomes, `response` (B, K), shares a bin, K odd, the middle on time ->
    albedo (B, H, W) from 0 to 1 at the brightest point, depth_m (B, H, W), NaN where nothing is seen, and the volume
    (B, D, H, W).
    The parameters do not depend on wall or time axis; `noise` gives the predicted noise.
    """

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis):
        super().__init__()
        self.settings, self.time = settings, time
        self.grid = settings.grid(wall)
        wall = self.grid.wall
        self.physics = WienerVolumes(wall, time, settings.falloff)
        self.depths_m = self.physics.depths.double().numpy() * self.physics.unit_m
        pitch = self.physics.pitch
        rows, cols = max(4, round(wall.rows * pitch[1] * POINTS)), max(4, round(wall.cols * pitch[2] * POINTS))
        self.points = (rows, cols)
        self.pitch = (2 * pitch[0], wall.rows * pitch[1] / rows, wall.cols * pitch[2] / cols)

        self.head_of_intervals: CalibratedHead | None = None
        self.refinement: Refinement | None = None
        self.halved: list[Nano] = []  # the same for half the points a side, where that sees better in the large
        self.noise_level = NoiseLevel()
        self.any_noise: AnyNoise | None = None
        self.lifted = None
        if settings.lifting != "none":
            self.lifted = LiftedVolumes(settings.lifting, self.physics, (rows, cols))
        features = OWN_FEATURES + (4 if self.lifted else 0)
        bandwidth = settings.sfe_bandwidth if settings.sfe else 0
        scales = (settings.channels, settings.iterations, settings.spectral_scales)
        self.unfolding = PhysicalUnfolding(features, *scales, CONDITIONS, sfe_bandwidth=bandwidth)
        for lift in (self.unfolding.lift_u, self.unfolding.lift_g):
            lift.weight.data[:, OWN_FEATURES - 1 :] = 0  # the last pass and the lifted features come in from zero
        self.added_later = (TOLD,)
        self.takes_response = True
        self.head = nn.Conv3d(settings.channels[0], 1 + settings.features, 1)
        nn.init.normal_(self.head.weight, std=0.05)
        nn.init.zeros_(cast(Tensor, self.head.bias))
        self.projection: AttentionProjection | MaximumProjection
        if settings.projection:
            self.projection = AttentionProjection(VOLUMES, settings.features, 2, reach=PROFILE)
        else:
            self.projection = MaximumProjection(finish=False)
        trained = self.noise_level if settings.stage == "noise" else None
        for name, parameter in self.named_parameters():
            parameter.requires_grad = name.startswith("noise_level.") == (trained is not None)

    def forward(
        self, counts: Tensor, exposure: Tensor | None = None, response: Tensor | None = None
    ) -> MethodResult[Tensor]:
        counts, exposure = self.grid.spread(counts, exposure)
        coarse = None if self.training else in_the_large(self.halved, counts, exposure, response)
        given = self.prepared(counts, exposure, response)
        volumes, eta, maps, lifted, presence, first = given
        if self.settings.symmetries and not self.training:
            seen = self.over_symmetries(volumes, eta, maps, lifted, first)
        else:
            seen = self.iterate(volumes, eta, maps, lifted, first)
        present = presence[:, None, None]
        albedo = seen.albedo if self.training else with_detail(coarse, seen.albedo.clamp(0, 1))
        refined = as_it_was(albedo, seen.depth)
        if self.refinement is not None:
            refined = self.refinement(counts, exposure, response, albedo, seen.depth)
        albedo, depth_m = refined.albedo * present, refined.depth * self.physics.unit_m
        if not self.training:  # a picture's brightest point is 1 and its darkest 0, by definition
            albedo = albedo.clamp(0, 1)
            dark = albedo < DIMMEST * albedo.amax(dim=(1, 2), keepdim=True).clamp(min=1e-12)
            depth_m = torch.where(dark, torch.nan, depth_m)
        sure = None
        if self.head_of_intervals is not None and seen.spreads is not None:
            found = evidence(seen, refined, given, self.physics.depths[first:])
            sure = intervals_of(self.head_of_intervals, found, presence, self.physics)
        behind = self.physics.slices - first - seen.volume.shape[1]  # too far for any light
        volume = F.pad(seen.volume * present[..., None], (0, 0, 0, 0, first, behind))
        return self.grid.gathered(with_intervals(MethodResult(albedo, depth_m, volume), sure))

    def prepared(self, counts: Tensor, exposure: Tensor | None, response: Tensor | None = None) -> Prepared:
        """What the operator is given of counts and exposure as `forward` takes them."""
        rates = rates_of(self.physics.rebin(counts), exposure)
        log_noise, noise_map = self.noise(rates, counts)
        first, reach = self.reach(rates.net)
        scaled = max(reach, TRAINED_SLICES)
        known = None if response is None else self.physics.told(response, self.time.bin_width_s, rates.net)
        volumes = self.normalised(self.physics(rates, log_noise, known)[:, :, :scaled])[:, :, first:reach]
        lifted = None if self.lifted is None else self.lifted(rates.net, log_noise, scaled, known)
        maps = confidence(log_noise, noise_map, rates.exposure)
        told = log_noise if self.settings.nle else torch.full_like(log_noise, MIDDLE_NOISE)
        eta = conditions(told, rates)
        if known is not None:
            eta = torch.cat((eta, self.width(known)[:, None]), dim=1)
        return Prepared(volumes, eta, maps, lifted, rates.presence, first)

    def width(self, response: Told) -> Tensor:
        """(B,) of order 1: the response's width in slices, as it grows in decades."""
        return torch.log1p(response.width_s * (SPEED_OF_LIGHT_M_PER_S / 2 / self.physics.unit_m / SLICE))

    # A. Noise level estimation

    def noise(self, rates: Rates, counts: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """eta, log10 of the noise level (B,), and D_n, log10 of the noise of every wall point (B, H, W), inf = none.
        Of a look at a scene that was looked at before, known by its `counts`, they may be told by those (`KeptNoise`).
        """

        def find() -> tuple[Tensor, Tensor]:
            photons, spread, any_kind = self._noise_everywhere(rates)
            return unless_photons(photons, any_kind), spread

        kept = kept_noise()
        if kept is None or counts is None:
            eta, spread = find()
        else:
            counts_a_point = counts.sum(dim=(1, 2, 3, 4)) / (rates.exposure > 0).sum(dim=(1, 2))
            eta, spread = kept.of((rates.exposure.shape, rates.exposure.device), counts_a_point, find)
        return eta, noise_map_of(eta, spread, rates.exposure)

    def noise_of_all_kinds(self, rates: Rates) -> tuple[Tensor, Tensor, Tensor]:
        """eta and D_n as `noise`, both from photon statistics, and eta of noise of any kind, NaN where it is not
        known: of weights without such an estimate, without signal, or where too few points were measured."""
        eta, spread, any_kind = self._noise_everywhere(rates)
        return eta, noise_map_of(eta, spread, rates.exposure), any_kind

    def _noise_everywhere(self, rates: Rates) -> tuple[Tensor, Tensor, Tensor]:
        """eta, its spread over the wall as in `NoiseLevel.everywhere`, and eta of noise of any kind."""
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.settings.stage == "noise"):
            eta, spread, known = self.noise_level.everywhere(rates.raw, rates.exposure)
        if self.any_noise is None or self.training:
            return eta, spread, torch.full_like(eta, torch.nan)
        wall = self.physics.wall
        traits = noise_traits(rates, known, eta, (wall.height_m, wall.width_m), self.physics.time.bin_width_s)
        return eta, spread, torch.where(rates.presence > 0, self.any_noise(traits, rates.kept), torch.nan)

    # B. The operator, S times (algorithm 1)

    def reach(self, net: Tensor) -> tuple[int, int]:
        """From which slice to which there is light, even numbers unless the last is that of all of them; the first is
        the wall's unless the settings skip what is nearer."""
        physics = self.physics
        lit = lit_bins(net)
        nearest, farthest = ((at - physics.first) / (physics.bins - physics.first) * physics.slices for at in lit)
        reach = min(physics.slices, max(FEWEST_SLICES, 2 * math.ceil(farthest / 2) + MARGIN))
        if self.training or not self.settings.from_first_light or self.lifted is not None:
            return 0, reach
        return max(0, 2 * (min(int(nearest) - MARGIN, reach - FEWEST_LEFT) // 2)), reach

    def normalised(self, volumes: Tensor) -> Tensor:
        """Every volume over its brightest surfaces: the count unit ends here."""
        return (volumes / brightest(volumes).clamp(min=1e-12)[:, :, None, None, None]).clamp(-3, 4)

    def iterate(self, volumes: Tensor, eta: Tensor, maps: Tensor, lifted: Tensor | None, first: int = 0) -> Projection:
        """u^s = G(u^{s-1}), s = 1..S, from u^0 = 0; trained through all of them."""
        features = self.features(volumes, maps, lifted, first)
        seen = self.operator(features, volumes, eta, maps, first)
        for _ in range(1, self.settings.outer_iterations):
            seen = self.operator(self.with_last(features, seen.volume), volumes, eta, maps, first)
        return seen

    def with_last(self, features: Tensor, u: Tensor) -> Tensor:
        """The features with the volume of the last pass, u^{s-1} (B, D, H, W), in its place among them."""
        size = features.shape[2:]
        last = to_grid(u[:, None] * (u.shape[1] / size[0]), (size[0], size[1], size[2]))
        own = (features[:, : OWN_FEATURES - 1], last, features[:, OWN_FEATURES:])
        return torch.cat(own, dim=1).contiguous(memory_format=torch.channels_last_3d)

    def over_symmetries(
        self, volumes: Tensor, eta: Tensor, maps: Tensor, lifted: Tensor | None, first: int = 0
    ) -> Projection:
        """The mean of what the operator makes of every mirror image of the measurement, mirrored back."""
        pitch = self.physics.pitch
        square = volumes.shape[3] == volumes.shape[4] and pitch[1] == pitch[2]

        def see(images: Fields) -> tuple[Tensor, ...]:
            each = cast(Tensor, images[0])
            told = eta.repeat(len(each) // len(eta), 1)
            seen = self.iterate(each, told, cast(Tensor, images[1]), images[2], first)
            return seen.albedo, seen.depth, seen.volume, seen.albedo.square(), seen.depth.square()

        albedo, depth, volume, *squares = mean_over_symmetries(see, (volumes, maps, lifted), square)
        means = zip(squares, (albedo, depth), strict=True)
        of_albedo, of_depth = ((mean - whole.square()).clamp(min=0).sqrt() for mean, whole in means)
        return Projection(albedo, depth, volume, (of_albedo, of_depth))

    def features(self, volumes: Tensor, maps: Tensor, lifted: Tensor | None, first: int = 0) -> Tensor:
        """B_l: what is lifted to u^0, u_g and F_st, on the operator's own metric grid, (B, F, d, h, w)."""
        batch, slices = len(volumes), volumes.shape[2]
        size = (math.ceil(slices / 2), *self.points)
        depths = self.physics.depths[first : first + slices]
        depth = F.interpolate(depths[None, None], size=size[0], mode="linear")[0, 0]
        depth = depth.clamp(max=TRAINED_SLICES * SLICE) - 0.5
        depth = depth[None, None, :, None, None].expand(batch, 1, *size)
        sure = F.interpolate(maps[:, 1:], size=self.points, mode="area")[:, :, None].expand(batch, 1, *size)
        parts = [to_grid(volumes, size), to_grid(volumes, size, highest=True), depth, sure, depth * 0]
        if lifted is not None:
            parts.append(F.interpolate(lifted[:, :, : size[0]], size=size, mode="trilinear"))
        return torch.cat(parts, dim=1).contiguous(memory_format=torch.channels_last_3d)

    def operator(self, features: Tensor, volumes: Tensor, eta: Tensor, maps: Tensor, first: int = 0) -> Projection:
        """One pass: Phi_eta, B_p, and the volume projection (C)."""
        width = eta[:, CONDITIONS] if eta.shape[1] > CONDITIONS else None
        u = self.unfolding(features, eta[:, :CONDITIONS], self.pitch, width)
        u = u if torch.is_grad_enabled() else u.float()
        out, depths = self.head(u).float(), self.physics.depths[first : first + volumes.shape[2]]
        if isinstance(self.projection, AttentionProjection):
            return cast(Projection, self.projection(out[:, 0], out[:, 1:], volumes, maps, depths))
        correction = F.interpolate(out[:, :1], size=volumes.shape[2:], mode="trilinear")[:, 0]
        return cast(Projection, self.projection(0.8 * volumes[:, 0] + correction, depths))

    @property
    def training_loss(self) -> Callable[[Mapping[str, Tensor]], dict[str, Tensor]] | None:
        """The loss of noise level estimation while that is what is trained."""
        return self.noise_loss if self.settings.stage == "noise" else None

    def noise_loss(self, batch: Mapping[str, Tensor], beta: float = 0.5) -> dict[str, Tensor]:
        """L1(eta) + beta L1(D_n), both in decades (section IV-A)."""
        rates = rates_of(self.physics.rebin(batch["counts"]), batch["exposure"])
        eta, noise_map = self.noise_level(rates.raw, rates.exposure)
        scalar = (eta - batch["noise_level"].log10()).abs().mean()
        measured = torch.isfinite(batch["noise_map"]) & torch.isfinite(noise_map)
        distance = (noise_map - batch["noise_map"].clamp(min=1e-6).log10())[measured].abs().mean()
        return {"level": scalar, "map": beta * distance, "loss": scalar + beta * distance}


def build(settings: AnySettings, wall: WallGrid, time_axis: TimeAxis) -> Nano:
    """The operator for this wall and time axis; raises WeightsError if the weights are not of this shape."""
    assert isinstance(settings, Settings)
    network = Nano(settings, wall, time_axis)
    if settings.noise_weights is not None:
        put_part(network.noise_level, "noise_level.", settings.noise_weights)
    network = with_weights(network, settings.weights)
    if settings.weights is not None:  # weights that were never told a response are better off without
        network.takes_response = holds(settings.weights, TOLD)
    network.any_noise = own_copy(any_noise_for(settings.weights)) if settings.noise_weights is None else None
    network.head_of_intervals = own_copy(head_for(settings.weights)) if settings.refine else None
    wall = network.grid.wall
    refined = settings.refine and min(wall.rows, wall.cols) >= REFINED
    correction = own_copy(correction_for(settings.weights)) if refined else None
    if correction is not None:
        network.refinement = Refinement(correction, wall, time_axis, settings.falloff)
    network.halved = halves(network, wall, lambda coarser: build(settings, coarser, time_axis))
    if settings.bfloat16:
        in_bfloat16(network)
    for half in network.halved:
        half.head_of_intervals = None  # nobody asks how sure it is
    return network
