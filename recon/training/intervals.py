"""Trains and calibrates NANO's intervals: `python -m nlos.recon.training.intervals VERB FOLDER`.

`collect` lets NANO see simulated scans (`interval_set.py`), `train` fits the head to those of the training kinds of
scene, `calibrate` conformalises it on scenes of kinds that neither ever saw (Romano et al., NeurIPS 2019) and writes
recon/weights/nano.intervals. After a change of NANO's weights: `collect` into a new folder and `calibrate`.
"""

import argparse
import copy
import hashlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nlos.recon.intervals import CALIBRATED, GROUPS, NOISES, Calibration, adjusted, group_of, head_in
from nlos.recon.layers.interval_head import IntervalHead, RawIntervals
from nlos.recon.layers.symmetries import mirrored
from nlos.recon.training.interval_set import CALIBRATION, TEST, TRAINING, Judged, all_judged, judged
from nlos.recon.weights.files import OWN_FOLDER, find_weights, put_weights, read_weights, save

DRAFT = "head.safetensors"
COVERED = 0.5  # of a pixel: from there on a surface is there
LEVEL = 0.9
AVERAGE = 0.995
FEWEST = 6  # scans of a group


def tensors_of(made: Judged) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Evidence (C, H, W), brightness, depth and whether a surface is there (H, W)."""
    there = (made.coverage >= COVERED).astype(np.float32)
    return tuple(torch.from_numpy(x) for x in (made.evidence, made.intensity.clip(0, 3), made.depth, there))  # type: ignore[return-value]


def train(folder: Path, steps: int, seed: int = 1, batch: int = 8) -> IntervalHead:
    """The head after so many steps on the training scans in `folder`, weights averaged."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    by_size: dict[int, list[tuple[Tensor, ...]]] = {}
    for made in all_judged(TRAINING, folder):
        by_size.setdefault(made.coverage.shape[0], []).append(tensors_of(made))
    sizes = sorted(by_size)
    shares = np.array([len(by_size[size]) for size in sizes], dtype=np.float64)
    head = IntervalHead()
    mean = copy.deepcopy(head)
    optimiser = torch.optim.AdamW(head.parameters(), lr=2e-3, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 2e-3, total_steps=steps)
    total = 0.0
    for step in range(steps):
        size = int(rng.choice(sizes, p=shares / shares.sum()))
        count = max(1, batch * 32 * 32 // size**2)
        chosen = [by_size[size][k] for k in rng.integers(len(by_size[size]), size=count)]
        fields = [torch.stack(each) for each in zip(*chosen, strict=True)]
        flips = [dim for dim in (-1, -2) if rng.random() < 0.5]
        turned = bool(rng.random() < 0.5)
        evidence, *truth = [mirrored(x, flips, turned).contiguous() for x in fields]
        optimiser.zero_grad()
        loss = head.loss(evidence, *truth)
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(head.parameters(), 1.0)
        optimiser.step()
        schedule.step()
        with torch.no_grad():
            for kept, now in zip(mean.parameters(), head.parameters(), strict=True):
                kept.lerp_(now, 1 - min(AVERAGE, (step + 1) / (step + 10)))
        total += float(loss.detach())
        if step % 250 == 249:
            print(json.dumps({"step": step + 1, "loss": round(total / 250, 4)}), flush=True)
            total = 0.0
    return mean.eval()


def calibrate(head: IntervalHead, folder: Path) -> Calibration:
    """What the head's intervals must be widened by, in local scales, so that nine surface pixels of ten lie in them, by
    number of points and noise level (by points alone where scans are few); every scan counts alike. And the logits of
    `seen` by Platt's line."""
    groups: list[int] = []
    scores: dict[str, list[npt.NDArray[np.float32]]] = {"albedo": [], "depth": []}
    logits, truths = [], []
    for made in all_judged(CALIBRATION, folder):
        evidence, intensity, depth, there = tensors_of(made)
        with torch.inference_mode():
            raw = head(evidence[None])
        logits.append(raw.seen.flatten().numpy())
        truths.append(there.flatten().numpy())
        on = there > 0
        if on.any():
            groups.append(int(group_of(evidence[None])[0]))
            for name, score in zip(scores, _scores(raw, intensity, depth), strict=True):
                scores[name].append(score[on].numpy())
    wider = {name: tuple(_of_group(group, groups, held) for group in range(GROUPS)) for name, held in scores.items()}
    slope, offset = _platt(np.concatenate(logits), np.concatenate(truths))
    return Calibration(wider["albedo"], wider["depth"], slope, offset)


def _of_group(group: int, groups: list[int], scores: list[npt.NDArray[np.float32]]) -> float:
    """The score that `LEVEL` of the pixels of a group's scans stay below; of all scans of as many points where there
    are fewer than `FEWEST`, then of all."""
    alike = (lambda g: g == group, lambda g: g // NOISES == group // NOISES, lambda g: True)
    chosen: list[npt.NDArray[np.float32]] = []
    for same in alike:
        chosen = [score for score, g in zip(scores, groups, strict=True) if same(g)]
        if len(chosen) >= FEWEST:
            break
    values = np.concatenate(chosen)
    weights = np.concatenate([np.full(len(score), 1 / len(score)) for score in chosen])
    order = np.argsort(values)
    rank = np.cumsum(weights[order]) / weights.sum()
    return float(values[order][np.searchsorted(rank, LEVEL)])


def _scores(raw: RawIntervals, intensity: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """How far the truth lies outside, in local scales; below 0 inside."""
    albedo = torch.maximum(raw.albedo_low - intensity, intensity - raw.albedo_high) / raw.albedo_scale
    depths = torch.maximum(raw.depth_low - depth, depth - raw.depth_high) / raw.depth_scale
    return albedo[0], depths[0]


def _platt(logits: npt.NDArray[np.float32], truths: npt.NDArray[np.float32]) -> tuple[float, float]:
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


def judge(head: IntervalHead, calibration: Calibration, folder: Path, part: str) -> dict[str, Any]:
    """Coverage of both intervals on surfaces, and the calibration error of `seen`, by group and kind of subset."""
    found: dict[str, list[tuple[float, float, float, int]]] = {}
    bins = np.zeros((10, 3))
    for made in all_judged(part, folder):
        evidence, intensity, depth, there = tensors_of(made)
        with torch.inference_mode():
            made_of = adjusted(head(evidence[None]), calibration, group_of(evidence[None]))
        on = there > 0
        seen = made_of.seen[0].numpy()
        place = np.minimum((seen * 10).astype(int), 9)
        for k in range(10):
            bins[k] += [(place == k).sum(), seen[place == k].sum(), there.numpy()[place == k].sum()]
        if not on.any():
            found.setdefault("empty", []).append((float((seen > 0.5).mean()), 0.0, 0.0, seen.size))
            continue
        albedo = ((intensity >= made_of.albedo_low[0]) & (intensity <= made_of.albedo_high[0]))[on].float().mean()
        depths = ((depth >= made_of.depth_low[0]) & (depth <= made_of.depth_high[0]))[on].float().mean()
        width = (made_of.depth_high - made_of.depth_low)[0][on].median()
        for name in (f"group {int(group_of(evidence[None])[0])}", made.about["points"], "all"):
            found.setdefault(name, []).append((float(albedo), float(depths), float(width), int(on.sum())))
    result: dict[str, Any] = {}
    for name, rows in sorted(found.items()):
        means = np.array([row[:3] for row in rows]).mean(axis=0)
        result[name] = [round(float(x), 4) for x in means] + [len(rows)]
    known = bins[:, 0] > 0
    off = np.abs(bins[known, 1] - bins[known, 2]).sum() / bins[:, 0].sum()
    return result | {"ece of seen": round(float(off), 4)}


def save_draft(head: IntervalHead, folder: Path) -> None:
    """A head that is trained and not yet calibrated, beside the scans that it was trained on."""
    save(folder / DRAFT, head.state_dict(), {"method": "intervals of nano, not calibrated"})


def head_to_calibrate(folder: Path) -> IntervalHead:
    """The draft in `folder`; without one the head that ships, for NANO's new weights. Raises WeightsError."""
    path = folder / DRAFT
    if not path.exists():
        return head_in(OWN_FOLDER / CALIBRATED).network
    head = IntervalHead()
    put_weights(head, read_weights(path).tensors, str(path))
    return head.eval()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("verb", choices=["collect", "train", "calibrate", "judge"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--part", default=CALIBRATION, choices=[TRAINING, CALIBRATION, TEST])
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--steps", type=int, default=3000)
    said = parser.parse_args()
    torch.set_num_threads(int(os.environ.get("OMP_NUM_THREADS", "1")))
    if said.verb == "collect":
        for index in range(said.scans):
            judged(said.part, index, said.folder)
        return
    if said.verb == "train":
        save_draft(train(said.folder, said.steps), said.folder)
        return
    head = head_to_calibrate(said.folder)
    calibration = calibrate(head, said.folder)
    print(json.dumps(judge(head, calibration, said.folder, said.part), indent=1))
    if said.verb == "calibrate":
        about = {
            "method": "intervals of nano", "calibration": calibration.as_json(),
            "of": hashlib.sha256(find_weights("nano").read_bytes()).hexdigest(),
        }  # fmt: skip
        save(OWN_FOLDER / CALIBRATED, {k: x.half() for k, x in head.state_dict().items()}, about)


if __name__ == "__main__":
    main()
