"""One training sample - what was counted, how, and the truth that it should lead to - and several as a batch."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch

from nlos.recon.training.impulse_responses import UNTOLD
from nlos.recon.training.shapes import Array

TRUTH = ("intensity", "albedo", "depth_m", "coverage")


@dataclass(frozen=True)
class TrainingSample:
    """Counts, how they were measured, and the truth they should lead to; all on the scan grid."""

    counts: npt.NDArray[np.uint16] | Array  # (T, H, W); measured ones may be any numbers from 0
    exposure: Array  # (H, W) relative dwell, mean 1 over measured points, 0 = not measured
    noise_map: Array  # (H, W) standard deviation a bin over exposure and mean signal peak; inf = not measured
    noise_level: float  # its root mean square over measured points
    background: float  # expected background counts per bin at exposure 1
    intensity: Array  # (H, W) albedo |cos| coverage: what the front view shows
    albedo: Array  # (H, W)
    depth_m: Array  # (H, W), 0 where less than half of the pixel is covered
    coverage: Array  # (H, W)
    normal: Array  # (3, H, W)
    kind: str
    condition: str
    response: Array = field(default_factory=UNTOLD.copy)
    """(K,) the response as it is told: shares of light a bin, the middle one on time; a lone 1: not told."""


def collate(samples: list[TrainingSample]) -> dict[str, torch.Tensor]:
    """Batch: counts (B, 1, T, H, W) float32; truth, exposure, noise_map (B, H, W); normal (B, 3, H, W), levels (B,),
    response (B, K)."""
    batch = {
        name: torch.from_numpy(np.stack([getattr(s, name) for s in samples]))
        for name in ("exposure", "noise_map", "normal", "response", *TRUTH)
    }
    batch["counts"] = torch.from_numpy(np.stack([s.counts.astype(np.float32) for s in samples])[:, None])
    for name in ("noise_level", "background"):
        batch[name] = torch.tensor([getattr(s, name) for s in samples], dtype=torch.float32)
    return batch
