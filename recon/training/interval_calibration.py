"""Conformalises NANO's intervals on scans of kinds of scene that its head never saw, and judges them."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nlos.recon.interval_scores import ause, calibration_error
from nlos.recon.intervals import GROUPS, NOISES, POINTS, Calibration, adjusted, group_of
from nlos.recon.layers.interval_head import ALBEDO, IntervalHead, RawIntervals
from nlos.recon.predicted_error import ErrorLine, line_through, relative_error, said_by
from nlos.recon.training.interval_fit import tensors_of
from nlos.recon.training.interval_set import Judged

LEVEL = 0.9
FEWEST = 12  # scans of a group
Floats = npt.NDArray[np.float32]


def calibrate(head: IntervalHead, scans: Iterable[Judged]) -> Calibration:
    """What the sides of intervals must be multiplied by, so that nine surface pixels of ten lie in them, by group
    (`group_of`; where its scans are few, by fewer of its words); every scan counts alike. And the logits of `seen` by
    Platt's line (1999)."""
    of_surface: list[int] = []
    of_all: list[int] = []
    scores: dict[str, list[Floats]] = {"albedo": [], "depth": []}
    logits, truths = [], []
    for made in scans:
        evidence, intensity, depth, there = tensors_of(made)
        with torch.inference_mode():
            raw = head(evidence[None])
        group = int(group_of(evidence[None])[0])
        of_all.append(group)
        logits.append(raw.seen.flatten().numpy())
        truths.append(there.flatten().numpy())
        on = there > 0
        if on.any():
            of_surface.append(group)
            for name, score in zip(scores, _scores(raw, intensity, depth), strict=True):
                scores[name].append(score[on].numpy())
    wider = {
        name: tuple(_quantile([held[k] for k in alike(group, of_surface)]) for group in range(GROUPS))
        for name, held in scores.items()
    }
    lines = [
        _platt(np.concatenate([logits[k] for k in chosen]), np.concatenate([truths[k] for k in chosen]))
        for chosen in (alike(group, of_all) for group in range(GROUPS))
    ]
    return Calibration(wider["albedo"], wider["depth"], tuple(a for a, _ in lines), tuple(b for _, b in lines))


def alike(group: int, groups: list[int]) -> list[int]:
    """Which scans count for a group: its own; where they are fewer than `FEWEST` those of as many points and as much
    noise, told a response or not; then of as many points; then all."""
    told = POINTS * NOISES
    same: tuple[Callable[[int], object], ...] = (
        lambda g: g, lambda g: g % told, lambda g: g % told // NOISES, lambda g: None,
    )  # fmt: skip
    chosen: list[int] = []
    for word in same:
        chosen = [k for k, g in enumerate(groups) if word(g) == word(group)]
        if len(chosen) >= FEWEST:
            break
    return chosen


def _quantile(scores: list[Floats]) -> float:
    """The score that `LEVEL` of the pixels stay below, every scan counting alike."""
    values = np.concatenate(scores)
    weights = np.concatenate([np.full(len(score), 1 / len(score)) for score in scores])
    order = np.argsort(values)
    rank = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][np.searchsorted(rank, LEVEL)])


def _scores(raw: RawIntervals, intensity: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """How many times its side the truth is away from the picture; (H, W)."""
    off, deep = intensity - raw.albedo, depth - raw.depth
    albedo = torch.maximum(off / raw.brighter, -off / raw.darker)
    return albedo[0], torch.maximum(deep / raw.farther, -deep / raw.nearer)[0]


def _platt(logits: Floats, truths: Floats) -> tuple[float, float]:
    """Slope and offset of the logit that fit best."""
    x, y = torch.from_numpy(logits).double(), torch.from_numpy(truths).double()
    line = torch.tensor([1.0, 0.0], dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.LBFGS([line], max_iter=50)

    def closure() -> Tensor:
        optimiser.zero_grad()
        loss = torch.nn.functional.binary_cross_entropy_with_logits(line[0] * x + line[1], y)
        loss.backward()  # type: ignore[no-untyped-call]
        return loss

    optimiser.step(closure)  # type: ignore[no-untyped-call]
    slope, offset = (float(value) for value in line.detach())
    return slope, offset


def error_line(head: IntervalHead, calibration: Calibration, scans: Iterable[Judged]) -> ErrorLine:
    """What calibrated intervals say of the error of whole pictures, against their true errors."""
    said, true = [], []
    for made in scans:
        evidence, intensity, _, there = tensors_of(made)
        if not (there > 0).any():
            continue
        with torch.inference_mode():
            sure = adjusted(head(evidence[None]), calibration, group_of(evidence[None]))
        albedo = made.evidence[ALBEDO]
        said.append(said_by(albedo, sure.albedo_low[0].numpy(), sure.albedo_high[0].numpy()))
        true.append(relative_error(albedo, intensity.numpy()))
    return line_through(said, true)


def judge(head: IntervalHead, scans: Iterable[Judged], calibration: Calibration) -> dict[str, Any]:
    """By group, kind of subset and all: coverage, mean width and AUSE of brightness, the same of depth (wall widths),
    the calibration error of `seen`, and how many scans; of empty scans the share of pixels where one is seen."""
    found: dict[str, list[tuple[float, ...]]] = {}
    for made in scans:
        evidence, intensity, depth, there = tensors_of(made)
        group = group_of(evidence[None])
        with torch.inference_mode():
            raw = head(evidence[None])
            sure = adjusted(raw, calibration, group)
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
        for name in (f"group {int(group[0])}", str(made.about["points"]), "all"):
            found.setdefault(name, []).append((*row, ece))
    return {
        name: [round(float(x), 4) for x in np.nanmean(np.array(rows), axis=0)] + [len(rows)]
        for name, rows in sorted(found.items())
    }
