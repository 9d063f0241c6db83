"""The order of the samples and what becomes of a batch: functions of (seed, step) alone, so a run can stop anywhere."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from nlos.recon.layers.symmetries import mirrored
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.training_sample import collate

USED = (
    "counts", "exposure", "noise_map", "intensity", "albedo", "depth_m", "coverage", "noise_level", "background",
    "response",
)  # fmt: skip


def order(count: int, epoch: int, seed: int) -> npt.NDArray[np.int64]:
    """The samples 0 .. count - 1 in the order of this epoch."""
    return np.random.default_rng((seed, epoch, 11)).permutation(count)


def indices_at(count: int, seed: int, step: int, batch: int, part: slice = slice(None)) -> list[int]:
    """The samples, of `count`, that batch number `step` holds, or the `part` of them that one process works on."""
    found = []
    for position in range(step * batch, (step + 1) * batch)[part]:
        epoch, place = divmod(position, count)
        found.append(int(order(count, epoch, seed)[place]))
    return found


def batch_at(
    data: DatasetSettings, cache: Path | None, seed: int, step: int, batch: int, part: slice = slice(None)
) -> dict[str, torch.Tensor]:
    """Batch number `step`, or the `part` of its samples that one of several processes works on."""
    whole = collate([sample(data, index, cache) for index in indices_at(len(data), seed, step, batch, part)])
    return {name: whole[name] for name in USED}


def pooled(batch: Mapping[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The scan that a grid of half as many rows and columns makes: 2 x 2 points added; noise_map is not kept."""

    def mean(x: torch.Tensor) -> torch.Tensor:
        rows, cols = x.shape[-2:]
        return x.reshape(*x.shape[:-2], rows // 2, 2, cols // 2, 2).mean(dim=(-1, -3))

    result = {name: batch[name] for name in ("noise_level", "background", "response") if name in batch}
    result |= {name: mean(batch[name]) for name in ("intensity", "albedo", "coverage", "exposure")}
    result["counts"] = 4 * mean(batch["counts"])
    result["background"] = 4 * batch["background"]
    weight = batch["coverage"] * (batch["depth_m"] > 0)
    depth = mean(batch["depth_m"] * weight) / mean(weight).clamp(min=1e-6)
    result["depth_m"] = torch.where(result["coverage"] >= 0.5, depth, 0.0)
    return result


def whole_scan(batch: Mapping[str, torch.Tensor]) -> bool:
    """Whether every point was measured: only then do pooled points sit where a coarser scan has them."""
    return bool((batch["exposure"] > 0).all())


def mirrored_batch(batch: Mapping[str, torch.Tensor], rng: np.random.Generator) -> dict[str, torch.Tensor]:
    """One of the eight symmetries of a square wall, or of the four of another, for the whole batch."""
    flips = [dim for dim in (-1, -2) if rng.random() < 0.5]
    square = batch["intensity"].shape[-1] == batch["intensity"].shape[-2]
    transpose = bool(rng.random() < 0.5) and square
    return {name: mirrored(x, flips, transpose).contiguous() if x.ndim >= 3 else x for name, x in batch.items()}


def with_uniform_noise(
    batch: Mapping[str, torch.Tensor], least: float, most: float, rng: np.random.Generator
) -> dict[str, torch.Tensor]:
    """Uniform noise U(0, a) added to every bin that was measured, a from U(`least`, `most`) for each scan.

    The scan's brightest rate is 255 then, as in the 8-bit films of LFE's data set, to which NANO's paper adds it.

    The noise of the scan before says nothing any more: noise_level and noise_map are not kept.
    """
    result = {name: x for name, x in batch.items() if name not in ("noise_level", "noise_map")}
    counts, exposure = batch["counts"], batch["exposure"][:, None, None]
    brightest = (counts / exposure.clamp(min=1e-6) * (exposure > 0)).amax(dim=(1, 2, 3, 4))
    level = torch.from_numpy(rng.uniform(least, most, len(counts))).to(counts) * brightest / 255
    generator = torch.Generator().manual_seed(int(rng.integers(2**62)))
    noise = torch.rand(counts.shape, generator=generator).to(counts)
    result["counts"] = counts + level[:, None, None, None, None] * exposure * noise
    result["background"] = batch["background"] + level / 2
    return result
