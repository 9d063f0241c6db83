"""What networks lose to uniform noise that learned from clean scans, beside the same networks that learned with noise.

The paper's LFE and NLOST lose 3 and 5.7 dB to noise (its tables I and II); those of this project lose next to nothing,
but learned with noise. So every network of the rows "at equal samples" is trained once more, on the same scenes,
scanned whole and clean: all points alike, 3,000 counts in a point's brightest bin, no faults of a detector.
`python -m studies.without_noise [SAMPLES]` resumes, two processes may share the work, and the table of docs/paper.md is
printed.
"""

import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from studies.ablations import train_and_judge
from studies.judged import network_of, scores
from studies.paired import Figures, difference
from studies.results.tables import table
from studies.row import Row, rivals
from studies.rows import FOLDER, KEPT, SAMPLES, SEEDS, SMALL, folder_of, settings_of

CLEAN = DetectorSettings(
    peak_counts_least=3000.0, peak_counts_most=3000.0, noiseless=0.0, uniform=0.0, sparse=0.0, uneven_dwell=0.0,
    dark_per_peak_most=0.0, afterpulsing_most=0.0, pile_up=0.0, calibration_residue=0.0,
)  # fmt: skip
"""31 dB of signal energy over that of its photons' noise; `noiseless` scans of the detector model have grain."""
SCENES = DatasetSettings(seed=4, scenes=48, degradations=1, held_out=True, detector=CLEAN, **SMALL)
"""Of kinds that no network was trained on."""
NETWORKS = (Row("the printed network"), *rivals("samples"))
LEARNED = ("with noise", "clean")
AMPLITUDES = (3.0, 5.0, 10.0, 30.0)
"""a of U(0, a): 21, 17, 11 and 1 dB of signal energy over noise energy on `SCENES`; the paper's are 15 to 20 dB."""
WHITE = 255.0
PAPER = {"LFE": -3.01, "NLOST": -5.68, "the printed network": -0.03}
"""Its table II less its table I, at U(0, a) of an a that it does not say."""


class Trained(NamedTuple):
    """One network, what it learned from, and the seed."""

    row: Row
    learned: str
    seed: int

    def settings(self, samples: int) -> TrainSettings:
        """Of its training."""
        settings = settings_of(self.row, samples, self.seed)
        if self.learned != "clean":
            return settings
        data, watched = (x.model_copy(update={"detector": CLEAN}) for x in (settings.data, settings.validation))
        return settings.model_copy(update={"data": data, "validation": watched, "uniform_noise_most": 0.0})

    def folder(self, samples: int) -> Path:
        """Where it is trained; that of the ablations' row where it is the same."""
        own = folder_of(self.row, samples, self.seed)
        return own if self.learned != "clean" else FOLDER / "clean" / own.relative_to(FOLDER)

    def kept(self, samples: int) -> Path:
        """Its figures: amplitude -> PSNR of every scene."""
        name = folder_of(self.row, samples, self.seed).relative_to(FOLDER).with_suffix(".json")
        return KEPT / "uniform_noise" / self.learned.replace(" ", "_") / name


def all_of_them(seeds: Sequence[int] = SEEDS) -> list[Trained]:
    """All networks of the first seed before any of the second."""
    return [Trained(row, learned, seed) for seed in seeds for row in NETWORKS for learned in LEARNED]


def run(samples: int = SAMPLES, seeds: Sequence[int] = SEEDS) -> None:
    """Train and judge what is not there yet."""
    for one in all_of_them(seeds):
        if one.kept(samples).exists():
            continue
        settings, folder = one.settings(samples), one.folder(samples)
        judging = partial(judge, settings, folder, one.kept(samples))
        if not train_and_judge(f"{one.row.name}, {one.learned}, seed {one.seed}", settings, folder, judging):
            return


def judge(settings: TrainSettings, folder: Path, to: Path, scenes: DatasetSettings = SCENES) -> None:
    """PSNR of every scene without noise and with U(0, a) in every bin, its brightest bin being 255, into a file."""
    network = network_of(settings, scenes, folder).eval()
    found: dict[str, list[float]] = {}
    for amplitude in (0.0, *AMPLITUDES):
        found[f"{amplitude:g}"] = []
        for index in range(len(scenes)):
            batch = collate([sample(scenes, index, settings.cache_path)])
            unit = float(batch["counts"].max()) / WHITE
            noise = torch.rand(batch["counts"].shape, generator=torch.Generator().manual_seed(index))
            batch["counts"] = batch["counts"] + amplitude * unit * noise
            found[f"{amplitude:g}"].append(round(scores(network, batch)["psnr"], 5))
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(json.dumps(found), encoding="utf-8")


def figures_of(row: Row, learned: str, samples: int, seeds: Sequence[int] = SEEDS) -> dict[str, Figures] | None:
    """Amplitude -> (seeds, scenes), of the seeds that are judged, the first ones; None where none is."""
    files = [Trained(row, learned, seed).kept(samples) for seed in seeds]
    count = next((k for k, file in enumerate(files) if not file.exists()), len(files))
    read = [json.loads(file.read_text(encoding="utf-8")) for file in files[:count]]
    if not read:
        return None
    return {f"{a:g}": np.array([one[f"{a:g}"] for one in read]) for a in (0.0, *AMPLITUDES)}


def written(samples: int, seeds: Sequence[int] = SEEDS) -> str:
    """The table: each network as it learned, what uniform noise costs it, and how much more that is of clean scans."""
    body = []
    for row in NETWORKS:
        paper = f"{PAPER[row.name]:+.2f}" if row.name in PAPER else "-"
        losses = []
        for learned in LEARNED:
            found = figures_of(row, learned, samples, seeds)
            if found is None:
                continue
            lost = [str(difference(found[f"{a:g}"], found["0"])) for a in AMPLITUDES]
            losses.append([found[f"{a:g}"] - found["0"] for a in AMPLITUDES])
            body.append([row.name, learned, str(len(found["0"])), f"{found['0'].mean():.2f}", *lost, paper])
        if len(losses) == len(LEARNED):
            noisy, clean = losses
            count = min(len(noisy[0]), len(clean[0]))
            more = [str(difference(b[:count], a[:count])) for a, b in zip(noisy, clean, strict=True)]
            body.append([row.name, "clean less with noise", str(count), "-", *more, "-"])
    heads = [f"a = {a:g}" for a in AMPLITUDES]
    return table(["PSNR, dB", "learned", "seeds", "no noise", *heads, "paper"], body)


if __name__ == "__main__":
    of = int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES
    run(of)
    print(written(of))
