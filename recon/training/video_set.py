"""NANO's pictures of simulated films, what the memory tells beside them, and the truth: what the network for films
learns from. Film i is the same whoever asks."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from nlos.recon.file_mode import readable_as_its_folder
from nlos.recon.live import LiveReconstruction
from nlos.recon.metrics import image_scores
from nlos.recon.over_time.given import depth_everywhere
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.over_time.moments import added
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.films import TIME, WALL, TrainingFilm

TRAINING, TEST = "training", "test"
SEEDS = {TRAINING: 9300, TEST: 9400}
FRAMES = 12
BACK = 4
"""Frames since which ways are kept."""
COMPARED = (5, 8, 11)
"""Frames of a test film that are also seen by NANO as it ships, frame by frame."""


@dataclass(frozen=True)
class HeldFilm:
    """Of every frame; lengths in wall widths, depths less a half, 0 where a truth has nothing."""

    albedo: Tensor  # (F, H, W)
    depth: Tensor  # (F, H, W)
    own: Tensor  # (F, OWN, h, w)
    told: Tensor  # (F, TOLD)
    way: Tensor  # (F, BACK, 3) since 1, 2 ... frames before
    intensity: Tensor  # (F, H, W) of the truth
    truth: Tensor  # (F, H, W)
    frame_by_frame: Tensor  # (len(COMPARED),) PSNR of NANO as it ships, NaN where that was not asked


def hold(part: str, index: int, folder: Path) -> None:
    """Make film `index` of a part (`SEEDS`) and put it into `folder`, unless it is there."""
    path = folder / part / f"{index:06d}.safetensors"
    if path.exists():
        return
    film = TrainingFilm(SEEDS[part], index, FRAMES, held_out=part == TEST)
    memory, live = LightMemory(WALL, TIME), LiveReconstruction("nano", {"refine": False}, finish=False)
    rows: list[dict[str, np.ndarray]] = []
    moments: list[float] = []
    scores: list[float] = []
    for number in range(FRAMES):
        frame = film.frame(number)
        memory.watch(frame)
        light = memory.on_half_grid()
        given = light.given
        assert given is not None
        truth = film.truth(frame.mean_s)
        albedo, depth_m = np.zeros((WALL.rows, WALL.cols), np.float32), np.ones((WALL.rows, WALL.cols), np.float32)
        seen: np.ndarray | None = None
        if light.light.counts.any():
            made = live.made_of_film(light)
            picture, seen = light.enlarged(made), None if made.volume is None else made.volume.albedo
            albedo, depth_m = picture.albedo, depth_everywhere(picture.albedo, picture.depth_m)
        ways = [given.way_m(moments[-back]) if back <= len(moments) else np.zeros(3) for back in range(1, BACK + 1)]
        moments.append(frame.mean_s)
        rows.append(
            {
                "albedo": albedo.astype(np.float16),
                "depth": (depth_m / WALL.width_m - 0.5).astype(np.float16),
                "own": given.own(depth_m[::2, ::2], WALL.width_m, seen).astype(np.float16),
                "told": given.told(),
                "way": np.stack(ways).astype(np.float32) / WALL.width_m,
                "intensity": truth.intensity.astype(np.float16),
                "truth": (truth.depth_m / WALL.width_m).astype(np.float16),
            }
        )
        if part == TEST and number in COMPARED:
            if not (truth.intensity.any() and frame.counts.any()):
                scores.append(np.nan)
                continue
            alone = reconstruct(added([frame], [1.0]), "nano", {"symmetries": False}, explain=False)
            scores.append(image_scores(alone.albedo, truth.intensity)["psnr"])
    held = {name: torch.from_numpy(np.stack([row[name] for row in rows])) for name in rows[0]}
    held["frame_by_frame"] = torch.tensor(scores or [np.nan] * len(COMPARED))
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    save_file({name: x.contiguous() for name, x in held.items()}, partial)
    readable_as_its_folder(partial)
    partial.replace(path)


def all_held(part: str, folder: Path, after: int = 0) -> Iterator[HeldFilm]:
    """Those of a part that are in `folder`, oldest first, but for the first `after`."""
    for path in sorted((folder / part).glob("*.safetensors"), key=lambda each: (each.stat().st_mtime, each))[after:]:
        yield HeldFilm(**load_file(path))
