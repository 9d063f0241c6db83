"""Intervals of a picture that hold as often as they say: NANO's head, calibrated, in metres and the picture's units."""

import math
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nlos.recon.layers.interval_head import KEPT, NOISE, RESPONSE, IntervalHead, RawIntervals
from nlos.recon.layers.wiener_volumes import WienerVolumes
from nlos.recon.predicted_error import ErrorLine
from nlos.recon.weights.files import OWN_FOLDER, goes_with, put_weights, read_weights

CALIBRATED = "nano.intervals"  # safetensors; by another name, for it is no weights of a method
NOISE_EDGES = (-0.25, 0.25)  # of the evidence `noise`, log10 of the noise level + 1
POINTS_EDGES = (5.0, 7.0, 9.0)  # log2 of the number of points that were measured
TOLD_EDGE = -0.5  # of `response`, where one is told
NOISES, POINTS = len(NOISE_EDGES) + 1, len(POINTS_EDGES) + 1
GROUPS = 2 * POINTS * NOISES


@dataclass(frozen=True)
class Calibration:
    """One number a group of scans each: what intervals' sides are multiplied by, and the line of `seen`'s logit."""

    albedo: tuple[float, ...]
    depth: tuple[float, ...]
    slope: tuple[float, ...]
    offset: tuple[float, ...]

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


@dataclass(frozen=True)
class Intervals:
    """90 % intervals and the probability of a surface, (B, H, W) each; depth in the unit that the head was given."""

    albedo_low: Tensor
    albedo_high: Tensor
    depth_low: Tensor
    depth_high: Tensor
    seen: Tensor


def group_of(evidence: Tensor) -> Tensor:
    """The group of each scan, (B,): by whether its response was told, number of measured points, and noise level."""
    noise, told = (evidence[:, channel, 0, 0].contiguous() for channel in (NOISE, RESPONSE))
    points = 2 * evidence[:, KEPT, 0, 0] + math.log2(evidence.shape[2] * evidence.shape[3])
    of_noise = torch.bucketize(noise, torch.tensor(NOISE_EDGES, device=noise.device))
    of_points = torch.bucketize(points, torch.tensor(POINTS_EDGES, device=noise.device))
    return ((told > TOLD_EDGE) * POINTS + of_points) * NOISES + of_noise


def adjusted(raw: RawIntervals, calibration: Calibration, group: Tensor) -> Intervals:
    """The head's intervals as wide as the calibration on scenes that it never saw asks for."""

    def of(values: tuple[float, ...]) -> Tensor:
        return torch.tensor(values, device=group.device)[group][:, None, None]

    wider, deeper = of(calibration.albedo), of(calibration.depth)
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
    """The head calibrated for these weights of NANO; None for others. Raises WeightsError."""
    path = OWN_FOLDER / CALIBRATED
    if weights is None or not path.is_file():
        return None
    if not goes_with(path, weights):
        return None
    return head_in(path)


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
    made = adjusted(head.network.to(found.device)(found), head.calibration, group_of(found))
    return {
        "albedo_low": made.albedo_low,
        "albedo_high": made.albedo_high,
        "depth_low_m": made.depth_low * physics.unit_m,
        "depth_high_m": made.depth_high * physics.unit_m,
        "seen": made.seen * presence[:, None, None],
    }
