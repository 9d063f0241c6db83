"""Fits the head of NANO's intervals to what NANO made of simulated scans."""

import json
from collections.abc import Iterable

import numpy as np
import torch
from torch import Tensor

from nlos.recon.layers.interval_head import IntervalHead
from nlos.recon.layers.symmetries import mirrored
from nlos.recon.training.averaged_fit import AveragedFit
from nlos.recon.training.interval_set import Judged

COVERED = 0.5  # of a pixel: from there on a surface is there
AVERAGE = 0.995
BATCH = 8  # scans of 32 x 32 points; of more points fewer
RATE, DECAY = 3e-3, 1e-2


def tensors_of(made: Judged) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Evidence (C, H, W), brightness, depth and whether a surface is there (H, W)."""
    there = (made.coverage >= COVERED).astype(np.float32)
    return tuple(torch.from_numpy(x) for x in (made.evidence, made.intensity.clip(0, 3), made.depth, there))  # type: ignore[return-value]


def fit(scans: Iterable[Judged], steps: int, begun: IntervalHead | None = None, seed: int = 1) -> IntervalHead:
    """The head after so many steps on `scans`, from its start or from one that was fitted before; weights averaged."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    by_size: dict[int, list[tuple[Tensor, ...]]] = {}
    for made in scans:
        by_size.setdefault(made.coverage.shape[0], []).append(tensors_of(made))
    sizes = sorted(by_size)
    shares = np.array([len(by_size[size]) for size in sizes], dtype=np.float64)
    head = IntervalHead() if begun is None else begun.train()
    rate = RATE if begun is None else RATE / 3
    fitted = AveragedFit(head, rate, DECAY, AVERAGE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(fitted.optimiser, rate, total_steps=steps)
    total = 0.0
    for step in range(steps):
        size = int(rng.choice(sizes, p=shares / shares.sum()))
        count = max(1, BATCH * 32 * 32 // size**2)
        chosen = [by_size[size][k] for k in rng.integers(len(by_size[size]), size=count)]
        fields = [torch.stack(each) for each in zip(*chosen, strict=True)]
        flips = [dim for dim in (-1, -2) if rng.random() < 0.5]
        turned = bool(rng.random() < 0.5)
        evidence, *truth = [mirrored(x, flips, turned).contiguous() for x in fields]
        loss = head.loss(evidence, *truth)
        fitted.step(loss, float(schedule.get_last_lr()[0]))
        schedule.step()
        total += float(loss.detach())
        if step % 250 == 249:
            print(json.dumps({"step": step + 1, "loss": round(total / 250, 4)}), flush=True)
            total = 0.0
    return fitted.mean.eval()
