"""The noise level of scans whose noise is not photons alone: what lies below the light cone, over the signal's peak."""

import math

import torch
from torch import Tensor, nn

from nlos.recon.layers.below_the_cone import below_the_cone
from nlos.recon.layers.noise_level import DIM, FLOOR, KNOWN, LAGS, log10_of
from nlos.recon.layers.rates import Rates

ORDERS = ((2, 6.0), (4, 70.0))  # of differences along time, and what they make of the variance of white noise
BELOW = 6
INPUTS = BELOW + 3 + len(ORDERS) + KNOWN
POWER = 1 + 2 * len(DIM)  # among the statistics of photons: the signal's mean over itself
PEAK = POWER + len(LAGS) + 2  # and its mean peak, of averages over 3 x 3 points
OWN = INPUTS - KNOWN  # where these statistics begin among the traits
POINTS = BELOW + 1  # where log10 of the points measured is
FEW = 300, 700  # points up to which networks of their own correct the ratio, and from which on they do no more
MIDDLE = 800, 960, 1700, 2200  # the same from the second to the third, and not before the first nor after the last
LEARNED = 960, 1024  # points of what `MIDDLE`'s networks have learned from
ENOUGH = 4.0  # frequencies
AGREE = 0.07  # decades: photon statistics that lie no farther from the estimate of any kind are left as they are


class AnyNoise(nn.Module):
    """log10 noise level (B,) of photons, of noise that does not know the light, and of grain that goes with it.

    The noise itself is what a scan holds below its light cone (`below_the_cone`), the signal's peak is that of averages
    over 3 x 3 points; the mean of a few small networks corrects their ratio from how both compare with the photon
    statistics, with differences of higher order along time, and with averages over more points. Where nothing below the
    cone can be told from light, differences along time stand in for it.
    """

    def __init__(self, width: int = 64, members: int = 3):
        super().__init__()
        self.corrections = nn.ModuleList(correction(width) for _ in range(members))
        self.middle = nn.ModuleList(correction(width) for _ in range(members))
        """For scans of whole grids of `MIDDLE` points."""
        self.few = nn.ModuleList(correction(width) for _ in range(members))
        """For scans of whole grids of `FEW` points and fewer."""

    def forward(self, traits: Tensor, kept: Tensor | None = None) -> Tensor:
        """traits (B, INPUTS), as `noise_traits` makes them -> (B,). `kept` (B,): of the grid's points so many were
        measured, all unless given; scans with gaps are no coarse ones."""
        points = traits[:, POINTS]
        near = traits.clone()  # of other numbers of points than it has learned from it knows nothing
        near[:, POINTS] = points.clamp(*(math.log10(number) for number in LEARNED))
        many, middle, few = (
            torch.stack([network(given)[:, 0] for network in members]).mean(dim=0)
            for members, given in ((self.corrections, traits), (self.middle, near), (self.few, traits))
        )
        whole = torch.ones_like(points) if kept is None else (kept.reshape(-1) >= 1).to(points)
        added = torch.lerp(many, few, whole * (1 - risen(points, *FEW)))
        return (
            traits[:, 0]
            - traits[:, OWN + PEAK]
            + torch.lerp(added, middle, whole * risen(points, *MIDDLE[:2]) * (1 - risen(points, *MIDDLE[2:])))
        )


def risen(points: Tensor, first: float, last: float) -> Tensor:
    """How far log10 of the points (B,) lies on the way from one number to another, 0 to 1."""
    start = math.log10(first)
    return ((points - start) / (math.log10(last) - start)).clamp(0, 1)


def correction(width: int) -> nn.Sequential:
    """Traits (B, INPUTS) -> (B, 1) decades, none before it is fitted."""
    last = nn.Linear(width, 1)
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(nn.Linear(INPUTS, width), nn.GELU(), nn.Linear(width, width), nn.GELU(), last)


def noise_traits(
    rates: Rates, known: Tensor, photons: Tensor, size_m: tuple[float, float], bin_width_s: float
) -> Tensor:
    """(B, INPUTS) log10 of what tells kinds of noise apart, on points of a wall of `size_m` (height, width); deviations
    and peaks are over the signal's own mean.

    `known` are the statistics of photon noise (B, KNOWN) and `photons` the level that follows from them (B,).
    """
    power = known[:, POWER]
    measured = (rates.exposure > 0).sum(dim=(1, 2))
    others = torch.stack((photons, measured.to(power).log10(), log10_of(rates.background, 1e-3)), dim=1)
    share = rates.kept.to(power).clamp(min=FLOOR)
    differences = [
        0.5 * log10_of(torch.diff(rates.raw, n=order, dim=2).square().mean(dim=(1, 2, 3, 4)) / share / scale, 1e-12)
        - power
        for order, scale in ORDERS
    ]
    below = torch.tensor(
        [
            traits_below(raw, exposure > 0, size_m, bin_width_s)
            for raw, exposure in zip(rates.raw[:, 0], rates.exposure, strict=True)
        ]
    ).to(power)
    below[:, :2] -= power[:, None]
    below[:, :2] = torch.where(torch.isfinite(below[:, :2]), below[:, :2], differences[-1][:, None])
    own = known.clone()
    own[:, 2:POWER:2] = 0.5 * known[:, 2:POWER:2] - power[:, None]
    own[:, POWER + 1 :] -= power[:, None]
    return torch.cat((below, others, torch.stack(differences, dim=1), own), dim=1)


def traits_below(raw: Tensor, measured: Tensor, size_m: tuple[float, float], bin_width_s: float) -> list[float]:
    """log10 of both deviations of rates (T, H, W) below the cone, NaN where they are not known; how many frequencies
    tell, the room of light, and how far noise of other kinds was weighed otherwise than photons."""
    rest = below_the_cone(raw, measured, size_m, bin_width_s)
    if rest is None or min(rest.variance, rest.least) <= 0:
        return [math.nan] * 2 + [0.0] * (BELOW - 2)
    deviations = [0.5 * math.log10(variance) for variance in (rest.variance, rest.least)]
    return [
        *deviations,
        min(rest.frequencies / ENOUGH, 1.0),
        rest.room,
        0.5 * math.log10(rest.even),
        0.5 * math.log10(rest.bright),
    ]


def unless_photons(photons: Tensor, any_kind: Tensor) -> Tensor:
    """The estimate of photon statistics (B,) as far as that of any kind (B,) agrees with it to `AGREE`, that one from
    twice as far on, and in between what lies between; the photons' where the other is NaN."""
    apart = any_kind - photons
    share = (apart.abs() / AGREE - 1).clamp(0, 1)
    return torch.where(torch.isfinite(any_kind), photons + share * apart, photons)
