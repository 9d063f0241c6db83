"""Intervals of a picture that hold as often as they say: NANO's head, calibrated, in metres and the picture's units."""

import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nlos.recon.layers.evidence import NAMES
from nlos.recon.layers.interval_head import IntervalHead, RawIntervals
from nlos.recon.layers.wiener_volumes import WienerVolumes
from nlos.recon.predicted_error import ErrorLine
from nlos.recon.refined import REFINEMENT
from nlos.recon.weights.files import OWN_FOLDER, goes_with, put_weights, read_about, read_weights, sha256_of

NOISE, KEPT, RESPONSE = (NAMES.index(name) for name in ("noise", "kept", "response"))
CALIBRATED = "nano.intervals"  # safetensors; by another name, for it is no weights of a method
TRAITS = ("noise", "points", "told")
"""Of a whole scan: log10 of its noise level, log2 of the points that were measured, whether a response was told."""
TOLD_EDGE = -0.5  # of the evidence `response`, where one is told


@dataclass(frozen=True)
class Calibration:
    """What the sides of intervals are multiplied by and the line of `seen`'s logit, by a scan's `TRAITS`: a constant
    and a coefficient for each, of the logarithms of the factors, of the slope and of the offset. Beyond what scans it
    was calibrated on had, `least` to `most`, traits count as at the edge."""

    least: tuple[float, ...]
    most: tuple[float, ...]
    albedo: tuple[float, ...]
    depth: tuple[float, ...]
    slope: tuple[float, ...]
    offset: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        return asdict(self)

    def of(self, traits: Tensor, coefficients: tuple[float, ...]) -> Tensor:
        """Their sum for scans of such traits (B, len(TRAITS)): (B, 1, 1)."""
        low, high, each = (torch.tensor(values).to(traits) for values in (self.least, self.most, coefficients))
        return (each[0] + torch.minimum(torch.maximum(traits, low), high) @ each[1:])[:, None, None]


UNCALIBRATED = Calibration(
    (-math.inf,) * len(TRAITS), (math.inf,) * len(TRAITS), (0.0,) * (1 + len(TRAITS)), (0.0,) * (1 + len(TRAITS)),
    (1.0, *(0.0,) * len(TRAITS)), (0.0,) * (1 + len(TRAITS)),
)  # fmt: skip
"""Leaves the head's intervals as they are."""


@dataclass(frozen=True)
class Intervals:
    """90 % intervals and the probability of a surface, (B, H, W) each; depth in the unit that the head was given."""

    albedo_low: Tensor
    albedo_high: Tensor
    depth_low: Tensor
    depth_high: Tensor
    seen: Tensor


def traits_of(evidence: Tensor) -> Tensor:
    """`TRAITS` of each scan, (B, len(TRAITS))."""
    noise, kept, response = (evidence[:, channel, 0, 0] for channel in (NOISE, KEPT, RESPONSE))
    points = 2 * kept + math.log2(evidence.shape[2] * evidence.shape[3])
    return torch.stack((noise, points, (response > TOLD_EDGE).to(noise)), dim=1)


def adjusted(raw: RawIntervals, calibration: Calibration, traits: Tensor) -> Intervals:
    """The head's intervals as wide as the calibration on scenes that it never saw asks for."""

    def of(coefficients: tuple[float, ...]) -> Tensor:
        return calibration.of(traits, coefficients)

    wider, deeper = of(calibration.albedo).exp(), of(calibration.depth).exp()
    return Intervals(
        (raw.albedo - wider * raw.darker).clamp(min=0),
        raw.albedo + wider * raw.brighter,
        (raw.depth - deeper * raw.nearer).clamp(min=0),
        raw.depth + deeper * raw.farther,
        torch.sigmoid(of(calibration.slope) * raw.seen + of(calibration.offset)),
    )


@dataclass(frozen=True)
class CalibratedHead:
    """The head that ships, its calibration, and what follows for the error of a whole picture."""

    network: IntervalHead
    calibration: Calibration
    error: ErrorLine


@lru_cache(maxsize=4)
def head_for(weights: str | None) -> CalibratedHead | None:
    """The head calibrated for pictures by these weights of NANO, refined by the refinement that ships; None for others.
    Raises WeightsError."""
    path = OWN_FOLDER / CALIBRATED
    if weights is None or not path.is_file() or not goes_with(path, weights) or not goes_with_refinement(path):
        return None
    return head_in(path)


def goes_with_refinement(path: Path) -> bool:
    """Whether what is in `path` was fitted to pictures that the refinement which ships made. Raises WeightsError."""
    refinement = OWN_FOLDER / REFINEMENT
    return refinement.is_file() and read_about(path).get("refinement") == sha256_of(str(refinement))


def head_in(path: Path) -> CalibratedHead:
    """The head in a file, whatever weights it was calibrated for. Raises WeightsError."""
    held = read_weights(path)
    head = IntervalHead()
    put_weights(head, {name: x.float() for name, x in held.tensors.items()}, str(path))
    told = held.about["calibration"]
    calibration = Calibration(**{name: tuple(values) for name, values in told.items()})
    return CalibratedHead(head.eval(), calibration, ErrorLine(**held.about["error"]))


def intervals_of(head: CalibratedHead, found: Tensor, presence: Tensor, physics: WienerVolumes) -> dict[str, Tensor]:
    """The fields of `MethodResult.intervals`, (B, H, W) each, from what NANO knows beside its picture (`evidence`)."""
    made = adjusted(head.network.to(found.device)(found), head.calibration, traits_of(found))
    return {
        "albedo_low": made.albedo_low,
        "albedo_high": made.albedo_high,
        "depth_low_m": made.depth_low * physics.unit_m,
        "depth_high_m": made.depth_high * physics.unit_m,
        "seen": made.seen * presence[:, None, None],
    }
