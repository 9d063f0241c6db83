"""Fits NANO's refinement to pictures of simulated scans, and says what it gains on others."""

import json
import math
import time
from collections.abc import Iterable

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.recon.layers.refinement import ALBEDO, ASKED, Correction
from nlos.recon.layers.symmetries import mirrored
from nlos.recon.training.averaged_fit import AveragedFit, falling
from nlos.recon.training.losses import best_scale
from nlos.recon.training.refinement_set import Held

AVERAGE = 0.998
BATCH = 6
RATE, LAST_RATE, DECAY, WARM_UP = 2e-3, 1e-5, 1e-3, 50
LEAST_ERROR = 3e-5
BY_MAXIMUM, DEPTH = 0.6, 1.2  # weights beside the error at the best scale
ROBUST = 0.25  # pixels' pitches: depths that are farther off count no more than by their distance


def errors(albedo: Tensor, intensity: Tensor) -> tuple[Tensor, Tensor]:
    """Mean squares at the best scale and by the maximum, (B,) each, in units of the brightest point of the truth."""
    truth = intensity / intensity.amax(dim=(1, 2), keepdim=True).clamp(min=1e-9)
    best = (best_scale(albedo, truth) * albedo - truth).square().mean(dim=(1, 2))
    over = albedo / albedo.amax(dim=(1, 2), keepdim=True).clamp(min=1e-9)
    return best, (over - truth).square().mean(dim=(1, 2))


def depth_errors(deeper: Tensor, held: Held) -> Tensor:
    """What is off where there is something to be seen, in pixels' pitches."""
    there = (held.truth > 0) & (held.found[..., ASKED, :, :] > 0)
    return ((held.depth + deeper - held.truth) * deeper.shape[-1])[there]


def loss_of(correction: Correction, held: Held) -> Tensor:
    """Of a batch."""
    albedo, deeper = correction(held.found)
    best, over = errors(albedo, held.intensity)
    off = depth_errors(deeper, held)
    deep = F.huber_loss(off, torch.zeros_like(off), delta=ROBUST) if len(off) else off.sum()
    pictures = (best + LEAST_ERROR).log() + BY_MAXIMUM * (over + LEAST_ERROR).log()
    return pictures.mean() + DEPTH * deep


def fit(scans: Iterable[Held], minutes: float, begun: Correction | None = None, seed: int = 0) -> Correction:
    """The network after so many minutes on `scans`, from its start or from one that was fitted before; weights
    averaged."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    by_size: dict[int, list[Held]] = {}
    for held in scans:
        by_size.setdefault(held.depth.shape[0], []).append(held)
    sizes = sorted(by_size)
    shares = np.array([size * len(by_size[size]) for size in sizes], dtype=np.float64)
    correction = Correction() if begun is None else begun.train().requires_grad_(True)
    fitted = AveragedFit(correction, RATE, DECAY, AVERAGE)
    start, total, over = time.monotonic(), 0.0, 0.0
    while over < 1:
        over = (time.monotonic() - start) / (60 * minutes)
        size = int(rng.choice(sizes, p=shares / shares.sum()))
        chosen = [by_size[size][k] for k in rng.integers(len(by_size[size]), size=BATCH)]
        loss = loss_of(correction, _batch(chosen, rng.integers(8, size=BATCH)))
        fitted.step(loss, falling(RATE, LAST_RATE, over) * min(1.0, (fitted.steps + 1) / WARM_UP))
        total += float(loss.detach())
        if fitted.steps % 500 == 0:
            print(json.dumps({"step": fitted.steps, "loss": round(total / 500, 4), "over": round(over, 3)}), flush=True)
            total = 0.0
    return fitted.mean.eval()


@torch.inference_mode()
def judge(correction: Correction, scans: Iterable[Held]) -> dict[str, list[float]]:
    """PSNR at the best scale and by the maximum, dB, and the median depth error in pixels' pitches: before, after."""
    rows = []
    for held in scans:
        albedo, deeper = (x[0] for x in correction(held.found[None]))
        truth, row = held.intensity[None], []
        for picture in (held.found[ALBEDO][None], albedo.clamp(0, 1)[None]):
            row += [-10 * math.log10(float(error) + 1e-12) for error in errors(picture, truth)]
        offs = [depth_errors(each, held).abs() for each in (torch.zeros_like(deeper), deeper)]
        rows.append(row + [float(off.median()) if len(off) else math.nan for off in offs])
    mean = np.nanmean(np.array(rows), axis=0).round(3).tolist()
    return {"psnr": mean[0:3:2], "psnr_by_maximum": mean[1:4:2], "depth_off": mean[4:]}


def _batch(scans: list[Held], images: np.ndarray) -> Held:
    """As one, each mirrored in its own way."""

    def turned(x: Tensor, image: int) -> Tensor:
        return mirrored(x, [axis for axis, bit in ((-1, 1), (-2, 2)) if image & bit], bool(image & 4))

    fields = [
        [turned(x, k) for x in (s.found, s.depth, s.intensity, s.truth)] for s, k in zip(scans, images, strict=True)
    ]
    return Held(*(torch.stack(each).contiguous() for each in zip(*fields, strict=True)))
