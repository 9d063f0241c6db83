"""Conformalises NANO's intervals on scans of kinds of scene that its head never saw, and judges them."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.recon.interval_scores import ause, calibration_error
from nlos.recon.intervals import RESPONSE, TOLD_EDGE, Calibration, adjusted, traits_of
from nlos.recon.layers.interval_head import ALBEDO, IntervalHead, RawIntervals
from nlos.recon.predicted_error import ErrorLine, line_through, relative_error, said_by
from nlos.recon.training.interval_fit import tensors_of
from nlos.recon.training.interval_set import Judged

LEVEL = 0.9
LEAST = 1e-3  # of a side, as a distance
PIXELS = 256  # of a scan that count
SOFT = 0.02  # of a logarithm: how far the loss is rounded at its corner
PENALTY = 1e-2  # on coefficients of standard scores


@dataclass(frozen=True)
class Seen:
    """What a head says of one scan and how it compares with the truth: `TRAITS`; of surface pixels by how many sides
    truth and picture differ, as logarithms, (N,) each, none of an empty scan; and logits of `seen` with the truth."""

    traits: Tensor
    albedo: Tensor
    depth: Tensor
    logits: Tensor
    truths: Tensor


def seen_by(head: IntervalHead, scans: Iterable[Judged]) -> list[Seen]:
    """The same for many scans; of each as many pixels, evenly."""
    found = []
    for made in scans:
        evidence, intensity, depth, there = tensors_of(made)
        with torch.inference_mode():
            raw = head(evidence[None])
        on = there > 0
        albedo, deep = (
            _some(score[on].clamp(min=LEAST).log().sort().values) for score in _scores(raw, intensity, depth)
        )
        logits, truths = (_some(each.flatten()) for each in (raw.seen[0], there))
        found.append(Seen(traits_of(evidence[None])[0], albedo, deep, logits, truths))
    return found


def calibrate(head: IntervalHead, scans: Iterable[Judged]) -> Calibration:
    """What the sides of intervals must be multiplied by, so that nine surface pixels of ten lie in them: log factors
    linear in `TRAITS` by quantile regression (Koenker and Bassett 1978; conformalised as in Romano et al. 2019 by what
    nine of ten then stay below), every scan counting alike. And the logits of `seen` by Platt's line (1999), slope and
    offset of which are linear in the same traits."""
    return calibrated(seen_by(head, scans))


def calibrated(found: Sequence[Seen]) -> Calibration:
    """The same, of what a head says."""
    traits = torch.stack([each.traits for each in found])
    least, most = traits.amin(dim=0), traits.amax(dim=0)
    surfaces = [each for each in found if len(each.albedo)]
    of_surfaces = torch.stack([each.traits for each in surfaces])
    wider = [
        _quantile_line(of_surfaces, torch.stack([getattr(each, name) for each in surfaces]))
        for name in ("albedo", "depth")
    ]
    slope, offset = _platt(
        traits, torch.stack([each.logits for each in found]), torch.stack([each.truths for each in found])
    )
    return Calibration(*(tuple(x.tolist()) for x in (least, most, *wider, slope, offset)))


def _some(x: Tensor) -> Tensor:
    """`PIXELS` of them, evenly; none of none."""
    return x[torch.linspace(0, len(x) - 1, PIXELS).round().long()] if len(x) else x


def _standard(traits: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """A constant and the traits as standard scores (N, 1 + K), and what they were by, so that one penalty fits all."""
    mean, spread = traits.mean(dim=0), traits.std(dim=0, unbiased=False).clamp(min=1e-3)
    scores = (traits - mean) / spread
    return torch.cat((torch.ones(len(traits), 1), scores), dim=1).double(), mean.double(), spread.double()


def _plain(line: Tensor, mean: Tensor, spread: Tensor) -> Tensor:
    """Coefficients of traits from those of their standard scores."""
    each = line[1:] / spread
    return torch.cat((line[:1] - (each @ mean)[None], each))


def _quantile_line(traits: Tensor, scores: Tensor) -> Tensor:
    """The coefficients (1 + K,) of the line that `LEVEL` of the scores (N, M) stay below."""
    x, mean, spread = _standard(traits)
    y = scores.double()

    def loss(line: Tensor) -> Tensor:
        over = y - (x @ line)[:, None]
        smooth = LEVEL * over + SOFT * F.softplus(-over / SOFT)
        return smooth.mean() + PENALTY * line[1:].square().sum()

    line = _least(loss, torch.zeros(x.shape[1], dtype=torch.float64))
    line[0] += torch.quantile((y - (x @ line)[:, None]).flatten(), LEVEL)
    return _plain(line, mean, spread)


def _platt(traits: Tensor, logits: Tensor, truths: Tensor) -> tuple[Tensor, Tensor]:
    """Slope and offset of the logits (N, M), the coefficients of both, (1 + K,) each."""
    x, mean, spread = _standard(traits)
    logit, truth, size = logits.double(), truths.double(), x.shape[1]

    def loss(lines: Tensor) -> Tensor:
        told = (x @ lines[:size])[:, None] * logit + (x @ lines[size:])[:, None]
        entropy = F.binary_cross_entropy_with_logits(told, truth)
        return entropy + PENALTY * (lines[1:size].square().sum() + lines[size + 1 :].square().sum())

    begun = torch.zeros(2 * size, dtype=torch.float64)
    begun[0] = 1
    lines = _least(loss, begun)
    return _plain(lines[:size], mean, spread), _plain(lines[size:], mean, spread)


def _least(loss: Callable[[Tensor], Tensor], begun: Tensor) -> Tensor:
    """Where a smooth convex loss is least."""
    at = begun.clone().requires_grad_(True)
    optimiser = torch.optim.LBFGS([at], max_iter=300, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimiser.zero_grad()
        value = loss(at)
        value.backward()  # type: ignore[no-untyped-call]
        return value

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    return at.detach()


def _scores(raw: RawIntervals, intensity: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """How many times its side the truth is away from the picture; (H, W)."""
    off, deep = intensity - raw.albedo, depth - raw.depth
    albedo = torch.maximum(off / raw.brighter, -off / raw.darker)
    return albedo[0], torch.maximum(deep / raw.farther, -deep / raw.nearer)[0]


def error_line(head: IntervalHead, calibration: Calibration, scans: Iterable[Judged]) -> ErrorLine:
    """What calibrated intervals say of the error of whole pictures, against their true errors."""
    said, true = [], []
    for made in scans:
        evidence, intensity, _, there = tensors_of(made)
        if not (there > 0).any():
            continue
        with torch.inference_mode():
            sure = adjusted(head(evidence[None]), calibration, traits_of(evidence[None]))
        albedo = made.evidence[ALBEDO]
        said.append(said_by(albedo, sure.albedo_low[0].numpy(), sure.albedo_high[0].numpy()))
        true.append(relative_error(albedo, intensity.numpy()))
    return line_through(said, true)


def groups_of(made: Judged) -> tuple[str, ...]:
    """What a scan is alike to others in: points, kind of subset and noise."""
    about = made.about
    kept = int(str(about["points"]).partition("/")[2] or 1)
    noise = int(np.floor(2 * np.log10(max(about["noise"], 1e-4)))) / 2
    told = "" if made.evidence[RESPONSE, 0, 0] < TOLD_EDGE else ", told"
    return f"{about['rows'] // kept} a side{told}", str(about["points"]), f"noise from 1e{noise:+.1f}"


def judge(head: IntervalHead, scans: Iterable[Judged], calibration: Calibration) -> dict[str, Any]:
    """By `groups_of` and all: coverage, mean width and AUSE of brightness, the same of depth (wall widths),
    the calibration error of `seen`, and how many scans; of empty scans the share of pixels where one is seen."""
    found: dict[str, list[tuple[float, ...]]] = {}
    for made in scans:
        evidence, intensity, depth, there = tensors_of(made)
        with torch.inference_mode():
            raw = head(evidence[None])
            sure = adjusted(raw, calibration, traits_of(evidence[None]))
        on = there > 0
        ece = calibration_error(sure.seen[0].numpy(), on.numpy())
        if not on.any():
            found.setdefault("empty", []).append((float((sure.seen > 0.5).float().mean()), ece))
            continue
        row: list[float] = []
        for truth, picture, low, high in (
            (intensity, raw.albedo, sure.albedo_low, sure.albedo_high),
            (depth, raw.depth, sure.depth_low, sure.depth_high),
        ):
            width, error = (high - low)[0][on], (picture[0] - truth).abs()[on]
            row += [float(((truth >= low[0]) & (truth <= high[0]))[on].float().mean()), float(width.mean())]
            row.append(ause(error.numpy(), width.numpy()))
        for name in (*groups_of(made), "all"):
            found.setdefault(name, []).append((*row, ece))
    return {
        name: [round(float(x), 4) for x in np.nanmean(np.array(rows), axis=0)] + [len(rows)]
        for name, rows in sorted(found.items())
    }
