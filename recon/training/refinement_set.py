"""NANO's pictures of simulated scans, what the light says of them, and the truth: what its refinement learns from.

Sample i is the same whoever asks. Scans of three grids, whole and at a part of the points, with quick and slow
responses, some of retroreflective surfaces; in every other ten surfaces hide each other from the wall, which the light
that the picture is held against knows nothing of.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from nlos.recon.file_mode import readable_as_its_folder
from nlos.recon.layers.counts import exposed
from nlos.recon.layers.refinement import DEPTH, Correction, Refined, Refinement, as_it_was
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.told import told
from nlos.recon.training.training_sample import TrainingSample, collate

TRAINING, TEST = "training", "test"
SEEDS = {TRAINING: 9100, TEST: 9200}
KINDS = ("letters", "cycles", "tubes", "vessels", "bodies", "furniture", "charts", "wires", "animals", "boards")
QUICK = DetectorSettings(sparse=0.0)
SLOW = DetectorSettings(sparse=0.0, slow=0.65, told=0.65)
SPARSE = DetectorSettings(sparse=1.0, sparsest_step=8)
VARIANTS: tuple[tuple[int, DetectorSettings, bool], ...] = (
    (64, QUICK, False), (64, SLOW, False), (64, QUICK, False), (64, SPARSE, False), (64, QUICK, False),
    (32, QUICK, False), (64, QUICK, True), (64, SLOW, False), (64, QUICK, False), (64, SPARSE, False),
    (128, QUICK, False),
)  # fmt: skip
"""Points a side, detector, retroreflective: in turn."""


@dataclass(frozen=True)
class Held:
    """What a picture's light says, and the truth; depths in wall widths."""

    found: Tensor  # (C, H, W)
    depth: Tensor  # (H, W) of the picture
    intensity: Tensor  # (H, W)
    truth: Tensor  # (H, W), 0 where there is nothing


class Watched(Refinement):
    """Keeps what it is shown of one scan, and leaves the picture as it is."""

    found: Tensor | None = None

    def __call__(
        self, counts: Tensor, exposure: Tensor | None, response: Tensor | None, albedo: Tensor, depth: Tensor
    ) -> Refined:
        known = None if response is None else response[0]
        self.found = self.left_over(
            counts[0, 0], exposed(counts, exposure).relative[0], albedo[0].clamp(0, 1), depth[0], known
        )
        return as_it_was(albedo, depth)


def scan(part: str, index: int) -> tuple[TrainingSample, DatasetSettings]:
    """A simulated scan and the settings that it was made by."""
    points, detector, retroreflective = VARIANTS[index % len(VARIANTS)]
    data = DatasetSettings(
        seed=SEEDS[part] + index % len(VARIANTS), rows=points, cols=points, degradations=1, scenes=10**6,
        held_out=part == TEST, kinds=KINDS if part == TRAINING else (), detector=detector,
        retroreflective=retroreflective, shadows=index // len(VARIANTS) % 2 == 1,
    )  # fmt: skip
    return sample(data, index // len(VARIANTS)), data


def hold(part: str, index: int, folder: Path) -> None:
    """Make sample `index` of a part (`SEEDS`) and put it into `folder`, unless it is there or shows nothing at all."""
    path = folder / part / f"{index:06d}.safetensors"
    if path.exists():
        return
    made, data = scan(part, index)
    network = _network(data.rows, data.retroreflective)
    batch = collate([made])
    with torch.inference_mode():
        network(batch["counts"], batch["exposure"], *told(network, batch))
    assert isinstance(network.refinement, Watched)
    found = network.refinement.found
    if found is not None and made.intensity.max() > 0:
        keep(path, found, torch.from_numpy(made.intensity), torch.from_numpy(made.depth_m) / data.wall_width_m)


def keep(path: Path, found: Tensor, intensity: Tensor, truth: Tensor) -> None:
    """Write one sample, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    held = {"found": found.half(), "depth": found[DEPTH] + 0.5, "intensity": intensity.half(), "truth": truth}
    save_file({name: x.contiguous() for name, x in held.items()}, partial)
    readable_as_its_folder(partial)
    partial.replace(path)


def all_held(part: str, folder: Path) -> Iterator[Held]:
    """Those of a part that are in `folder`, in their order."""
    for path in sorted((folder / part).glob("*.safetensors")):
        yield Held(**{name: x.float() for name, x in load_file(path).items()})


@lru_cache(maxsize=4)
def _network(rows: int, retroreflective: bool) -> Nano:
    data = DatasetSettings(rows=rows, cols=rows)
    settings = Settings(weights="nano", falloff=2 if retroreflective else 4)
    made = build(settings, data.wall, data.time)
    assert isinstance(made, Nano)
    made.refinement = Watched(Correction(), data.wall, data.time, settings.falloff)
    return made
