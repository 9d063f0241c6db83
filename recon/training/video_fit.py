"""Fits the network for films to NANO's pictures of simulated films, and says what it gains on others."""

import json
import math
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.recon.layers.film_network import Carried, FilmNetwork, Shown
from nlos.recon.layers.symmetries import mirrored
from nlos.recon.training.averaged_fit import AveragedFit, falling
from nlos.recon.training.refinement_fit import LEAST_ERROR, ROBUST, errors
from nlos.recon.training.video_set import BACK, COMPARED, TRAINING, HeldFilm, all_held
from nlos.recon.weights.files import save

AVERAGE = 0.99
LENGTHS = ((0.5, 4, 4), (1.0, 6, 4))
"""Until this share of the time, windows of so many frames, of so many films at once."""
RATE, RATE_AGAIN, LAST_RATE, DECAY, WARM_UP = 7e-4, 3e-4, 1e-5, 1e-3, 60
"""At 2e-3 every unit before the last layer dies within minutes, and constants are all that learns."""
BY_MAXIMUM, DEPTH, EMPTY = 0.25, 0.5, 0.3  # weights beside the error at the best scale
LOOK = 50
"""Steps between drafts, and looks at what films have come."""
DRAFT = "video.safetensors"
DROPPED = 0.08
"""Of the frames: as a machine that is too slow drops them."""


def loss_of(network: FilmNetwork, films: HeldFilm, numbers: Sequence[int]) -> Tensor:
    """Of a batch of films (B, F, ...), shown these frames one after the other."""
    before: Carried | None = None
    total = torch.zeros(())
    for place, number in enumerate(numbers):
        gap = number - numbers[place - 1] if place else 1
        with torch.autocast("cpu", torch.bfloat16):
            albedo, depth, before = network(
                _shown(films, number), before, films.way[:, number, gap - 1], torch.full((len(films.way),), float(gap))
            )
        total = total + _error(albedo, depth, films.intensity[:, number], films.truth[:, number])
    return total / len(numbers)


def _error(albedo: Tensor, depth: Tensor, intensity: Tensor, truth: Tensor) -> Tensor:
    there = intensity.amax(dim=(1, 2)) > 0
    loss = EMPTY * (albedo[~there].square().mean(dim=(1, 2)) + 1e-4).log().sum()
    if there.any():
        best, over = errors(albedo[there], intensity[there])
        loss = loss + ((best + LEAST_ERROR).log() + BY_MAXIMUM * (over + LEAST_ERROR).log()).sum()
        off = ((depth + 0.5 - truth) * depth.shape[-1])[truth > 0]
        if len(off):
            loss = loss + DEPTH * len(albedo) * F.huber_loss(off, torch.zeros_like(off), delta=4 * ROBUST)
    return loss / len(albedo)


def fit(folder: Path, minutes: float, begun: FilmNetwork | None = None, seed: int = 0) -> FilmNetwork:
    """The network after so many minutes on the training films in `folder`, and those that come while it learns, from
    its start or from one that was fitted before; weights averaged. A draft is left there now and then."""
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    network = FilmNetwork() if begun is None else begun.train().requires_grad_(True)
    first_rate = RATE if begun is None else RATE_AGAIN
    fitted = AveragedFit(network, first_rate, DECAY, AVERAGE)
    start, total, over = time.monotonic(), 0.0, 0.0
    films: list[HeldFilm] = []
    while over < 1:
        if fitted.steps % LOOK == 0:
            films += list(all_held(TRAINING, folder, len(films)))
        over = (time.monotonic() - start) / (60 * minutes)
        length, batch = next(each[1:] for each in LENGTHS if over <= each[0] or each is LENGTHS[-1])
        chosen = [films[k] for k in rng.integers(len(films), size=batch)]
        loss = loss_of(network, _batch(chosen, rng.integers(8, size=batch)), _numbers(rng, len(chosen[0].told), length))
        fitted.step(loss, falling(first_rate, LAST_RATE, over) * min(1.0, (fitted.steps + 1) / WARM_UP))
        total += float(loss.detach())
        if fitted.steps % LOOK == 0:
            told = {"step": fitted.steps, "loss": round(total / LOOK, 4), "over": round(over, 3), "films": len(films)}
            print(json.dumps(told), flush=True)
            save(folder / DRAFT, fitted.mean.state_dict(), {"method": "network for films of nano", **told})
            total = 0.0
    return fitted.mean.eval()


def _numbers(rng: np.random.Generator, frames: int, length: int) -> list[int]:
    """So many successive frames, but for dropped ones."""
    length = min(length, frames)
    numbers = [int(rng.integers(frames - length + 1))]
    while len(numbers) < length:
        gap = 1
        while gap < BACK and rng.random() < DROPPED:
            gap += 1
        if numbers[-1] + gap >= frames:
            break
        numbers.append(numbers[-1] + gap)
    return numbers


@torch.inference_mode()
def judge(network: FilmNetwork, films: Sequence[HeldFilm]) -> dict[str, Any]:
    """PSNR at the best scale of NANO as it ships, frame by frame, of the pictures the network is shown, and of its own;
    and the same by the maximum, and the median depth error in pixels' pitches, of the latter two."""
    rows: list[list[float]] = []
    for film in films:
        held = HeldFilm(**{name: x[None].float() for name, x in vars(film).items()})
        before: Carried | None = None
        for number in range(len(film.told)):
            shown = _shown(held, number)
            albedo, depth, before = network(shown, before, held.way[:, number, 0], torch.ones(1))
            truth = held.intensity[:, number]
            if number not in COMPARED or not truth.any():
                continue
            row = [float(film.frame_by_frame[COMPARED.index(number)])]
            for picture, deep in ((shown.albedo, shown.depth), (albedo.clamp(max=1), depth)):
                off = ((deep + 0.5 - held.truth[:, number]) * depth.shape[-1])[held.truth[:, number] > 0].abs()
                row += [-10 * math.log10(float(error) + 1e-12) for error in errors(picture, truth)]
                row += [float(off.median()) if len(off) else math.nan]
            rows.append(row)
    mean = np.ma.masked_invalid(rows).mean(axis=0).filled(np.nan).round(3).tolist()
    return {
        "frame_by_frame": mean[0], "psnr": mean[1:5:3], "psnr_by_maximum": mean[2:6:3], "depth_off": mean[3::3],
        "pictures": len(rows),
    }  # fmt: skip


def _shown(films: HeldFilm, number: int) -> Shown:
    return Shown(films.albedo[:, number], films.depth[:, number], films.own[:, number], films.told[:, number])


def _batch(films: list[HeldFilm], images: np.ndarray) -> HeldFilm:
    """As one, each mirrored in its own way."""
    turned = [_mirrored(film, int(image)) for film, image in zip(films, images, strict=True)]
    return HeldFilm(**{name: torch.stack([getattr(each, name) for each in turned]).float() for name in vars(films[0])})


def _mirrored(film: HeldFilm, image: int) -> HeldFilm:
    """Bit 0: left and right, bit 1: up and down, bit 2: then rows for columns."""
    axes = [axis for axis, bit in ((-1, 1), (-2, 2)) if image & bit]
    x, y, z = film.way.unbind(dim=-1)
    x, y = -x if image & 1 else x, -y if image & 2 else y
    if image & 4:
        x, y = -y, -x
    names = ("albedo", "depth", "own", "intensity", "truth")
    fields = {name: mirrored(getattr(film, name), axes, bool(image & 4)).contiguous() for name in names}
    return replace(film, **fields, way=torch.stack((x, y, z), dim=-1))
