"""What NANO makes of simulated scans, kept with the truth: what its intervals are learned from and calibrated on.

Sample i is the same whoever asks. Scans of both grids, whole and at a part of the points, with quick and slow
responses, some of retroreflective surfaces, half with surfaces that hide each other, and a few that hold nothing but
noise. The evidence is what NANO itself shows its head: of refined pictures where it refines them.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from safetensors import safe_open
from safetensors.numpy import save_file

from nlos.recon.intervals import UNCALIBRATED, CalibratedHead
from nlos.recon.layers.interval_head import IntervalHead, RawIntervals
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.predicted_error import ErrorLine
from nlos.recon.subsets import measured_points
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.told import told
from nlos.recon.training.training_sample import TrainingSample, collate

TRAINING, CALIBRATION, SLOW_CALIBRATION, TEST = "training", "calibration", "slow_calibration", "test"
SEEDS = {TRAINING: 7100, CALIBRATION: 7200, TEST: 7300, SLOW_CALIBRATION: 7400}
QUICK = DetectorSettings(sparse=0.0, peak_counts_most=60.0)
SLOW = DetectorSettings(sparse=0.0, peak_counts_most=60.0, jitter_fwhm_most_ps=420.0)
TOLD = DetectorSettings(sparse=0.0, peak_counts_most=60.0, slow=0.75, told=1.0, told_wrong=0.3)
VARIANTS: tuple[tuple[int, DetectorSettings, bool], ...] = (
    (32, QUICK, False), (64, QUICK, False), (32, SLOW, False), (64, TOLD, False),
    (32, QUICK, False), (64, QUICK, False), (32, TOLD, False), (64, SLOW, False),
    (32, QUICK, True), (64, QUICK, False), (32, QUICK, False), (64, TOLD, False),
    (40, QUICK, False), (48, TOLD, False), (32, QUICK, False),
)  # fmt: skip
"""Points a side, detector, retroreflective: in turn."""
SLOW_VARIANTS = ((64, TOLD, False), (32, TOLD, False), (64, TOLD, False))
"""The same of `SLOW_CALIBRATION`: more of what is told a response."""
SUBSETS = (2, 4, 8)  # of the points, one in so many in each direction
SPARSE, EMPTY = 0.5, 0.03
FEWEST_POINTS = 8  # a side, of what is left


class Watching(IntervalHead):
    """Keeps the evidence that it is shown."""

    found: torch.Tensor | None = None

    def forward(self, evidence: torch.Tensor) -> RawIntervals:
        self.found = evidence
        return super().forward(evidence)


@dataclass(frozen=True)
class Judged:
    """What NANO made of one scan, and the truth; (H, W) each."""

    evidence: npt.NDArray[np.float32]  # (C, H, W)
    intensity: npt.NDArray[np.float32]  # in units of the picture at its best scale; 0 where there is nothing
    depth: npt.NDArray[np.float32]  # wall widths, 0 = none
    coverage: npt.NDArray[np.float32]
    about: dict[str, Any]


def judged(part: str, index: int, folder: Path, weights: str = "nano") -> Judged:
    """Sample `index` of a part (`SEEDS`) from `folder`, made and put there where it is not yet."""
    path = folder / part / f"{index:06d}.safetensors"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        arrays, about = _make(part, index, weights)
        save_file(arrays, partial, metadata={"about": json.dumps(about)})
        partial.replace(path)
    with safe_open(path, framework="numpy") as file:
        held = {
            name: file.get_tensor(name).astype(np.float32) for name in ("evidence", "intensity", "depth", "coverage")
        }
        return Judged(**held, about=json.loads(file.metadata()["about"]))


def all_judged(part: str, folder: Path) -> Iterator[Judged]:
    """Those of a part that are in `folder`, in their order."""
    for path in sorted((folder / part).glob("*.safetensors")):
        yield judged(part, int(path.stem), folder)


def scan(part: str, index: int) -> tuple[TrainingSample, DatasetSettings, str]:
    """A simulated scan, the settings it was made by, and which points were kept or that it is empty."""
    variants = SLOW_VARIANTS if part == SLOW_CALIBRATION else VARIANTS
    points, detector, retroreflective = variants[index % len(variants)]
    data = DatasetSettings(
        seed=SEEDS[part] + index % len(variants), rows=points, cols=points, degradations=1, scenes=10**6,
        held_out=part != TRAINING, detector=detector, retroreflective=retroreflective,
        shadows=index // len(variants) % 2 == 1,
    )  # fmt: skip
    rng = np.random.default_rng((SEEDS[part], index))
    made = sample(data, index // len(variants))
    word = "whole"
    if rng.random() < SPARSE:
        step = int(rng.choice([step for step in SUBSETS if points // step >= min(points, FEWEST_POINTS)]))
        many, way = points // step, rng.random()
        if way < 0.5:
            kept, word = measured_points(f"{many}x{many}", points, points), f"grid/{step}"
        elif way < 0.75:
            kept, word = measured_points(f"blue:{many**2}", points, points), f"blue/{step}"
        else:
            kept = np.zeros((points, points), bool)
            kept.ravel()[rng.choice(points**2, many**2, replace=False)] = True
            word = f"scattered/{step}"
        exposure = made.exposure * kept
        made = replace(made, counts=made.counts * kept, exposure=exposure / exposure[kept].mean())
    if rng.random() < EMPTY:
        word = "empty"
        level = np.exp(rng.uniform(np.log(0.02), np.log(5))) * np.linspace(1 + rng.uniform(-0.2, 0.2), 1, data.bins)
        counts = rng.poisson(level[:, None, None] * made.exposure)
        nothing = np.zeros_like(made.intensity)
        made = replace(made, counts=counts.astype(np.uint16), intensity=nothing, depth_m=nothing, coverage=nothing)
    return made, data, word


def seen_by(network: Nano, made: TrainingSample) -> tuple[torch.Tensor, torch.Tensor]:
    """The picture (H, W), and the evidence (C, H, W), of one scan."""
    batch, watching = collate([made]), Watching()
    network.head_of_intervals = CalibratedHead(watching, UNCALIBRATED, ErrorLine(1.0, 0.0, 0.0))
    with torch.inference_mode():
        picture = network(batch["counts"], batch["exposure"], *told(network, batch)).albedo[0]
    assert watching.found is not None
    return picture, watching.found[0]


@lru_cache(maxsize=4)
def _network(rows: int, retroreflective: bool, weights: str) -> Nano:
    data = DatasetSettings(rows=rows, cols=rows)
    made = build(Settings(weights=weights, falloff=2 if retroreflective else 4), data.wall, data.time)
    assert isinstance(made, Nano)
    return made


def _make(part: str, index: int, weights: str) -> tuple[dict[str, npt.NDArray[np.float16]], dict[str, Any]]:
    made, data, word = scan(part, index)
    picture, found = seen_by(_network(data.rows, data.retroreflective, weights), made)
    albedo = picture.numpy().astype(np.float64)
    power = float(np.vdot(made.intensity, made.intensity))
    scale = float(np.vdot(albedo, made.intensity)) / max(float(np.vdot(albedo, albedo)), 1e-12)
    truth = made.intensity / scale if power > 0 and scale > 1e-9 else made.intensity / max(made.intensity.max(), 1e-9)
    arrays = {
        "evidence": found.numpy(), "intensity": np.minimum(truth, 1e3),
        "depth": made.depth_m / data.wall_width_m, "coverage": made.coverage,
    }  # fmt: skip
    about = {
        "kind": made.kind,
        "condition": made.condition,
        "points": word,
        "rows": data.rows,
        "noise": made.noise_level,
    }
    return {name: np.ascontiguousarray(x, dtype=np.float16) for name, x in arrays.items()}, about
