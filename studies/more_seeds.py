"""More seeds for the two rows of four times the samples that three seeds left open.

Spectral updates were told in one of twelve figures, which after twelve looks is nothing; and the row of mirror images
was a training of its own, so chance was in it. Two figures were settled before the new seeds were trained, those in
which three seeds leaned most: PSNR at 15 to 30 dB and SSIM under all conditions. Here the same weights are judged
twice, seen once and seen eight times, mirrored. `python -m studies.more_seeds [SAMPLES]` resumes, two processes may
share the work, and the table of docs/paper.md is printed.
"""

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from nlos.recon.training.train_settings import TrainSettings
from studies.ablations import train_and_judge
from studies.judged import judge, judged
from studies.paired import Figures, difference
from studies.results.tables import table
from studies.row import Row, longer
from studies.rows import JUDGED, KEPT, SAMPLES, SEEDS, folder_of, kept_of, settings_of

MORE = (4, 5)
SHIPS = longer("as it ships", {})
WITHOUT = longer("no spectral updates", {"spectral_scales": 0})
ASKED = (("15 to 30 dB", "psnr", "PSNR, 15 to 30 dB", ".2f"), ("all conditions", "ssim", "SSIM, all conditions", ".3f"))
"""Set of scenes, figure, what the table calls it and how it is written."""
Kept = Callable[[int], Path]
"""Seed -> the file with its figures."""


def mirrored_of(samples: int, seed: int) -> Path:
    """Figures of `SHIPS` averaged over mirror images, by the weights that were judged without."""
    return KEPT / "mirrored" / kept_of(SHIPS, samples, seed).relative_to(KEPT)


def run(samples: int = SAMPLES, seeds: Sequence[int] = MORE) -> None:
    """Train and judge what is not there yet."""
    for seed in seeds:
        for row in (SHIPS, WITHOUT):
            folder, kept = folder_of(row, samples, seed), kept_of(row, samples, seed)
            wanted = [kept] if row is WITHOUT else [kept, mirrored_of(samples, seed)]
            if all(path.exists() for path in wanted):
                continue
            settings = settings_of(row, samples, seed)
            if not train_and_judge(
                f"{row.name}, seed {seed}", settings, folder, partial(_judge, settings, folder, wanted)
            ):
                return


def _judge(settings: TrainSettings, folder: Path, to: Sequence[Path]) -> None:
    """Seen once into the first file; into the second, where there is one, averaged over mirror images."""
    for path, mirrored in zip(to, (False, True), strict=False):
        judge(settings, folder, path, JUDGED, mirrored)


def figures_of(kept: Kept, seeds: Sequence[int], where: str, figure: str) -> Figures | None:
    """(seeds, scenes) of the seeds that are judged, the first ones; None where none is."""
    found: list[list[float]] = []
    for seed in seeds:
        one = judged(kept(seed))
        if one is None:
            break
        found.append(list(one[where][figure]))
    return np.array(found, dtype=np.float64) if found else None


def written(samples: int, more: Sequence[int] = MORE) -> str:
    """Without spectral updates, and with mirror images, less what ships: of the first seeds, the new ones, and all."""

    def of(row: Row) -> Kept:
        return lambda seed: kept_of(row, samples, seed)

    asked: tuple[tuple[str, Kept, Sequence[int]], ...] = (
        ("no spectral updates, the first seeds", of(WITHOUT), SEEDS),
        ("no spectral updates, new seeds", of(WITHOUT), more),
        ("no spectral updates, all", of(WITHOUT), (*SEEDS, *more)),
        ("averaged over eight mirror images, the same weights", lambda seed: mirrored_of(samples, seed), more),
    )
    body = []
    for name, kept, seeds in asked:
        cells, count = [], 0
        for where, figure, _, form in ASKED:
            one, other = (figures_of(each, seeds, where, figure) for each in (kept, of(SHIPS)))
            if one is None or other is None:
                break
            found = difference(one, other)
            count = found.seeds
            cells.append(f"{found.mean:+{form}} ± {found.error:{form}}" + (" *" if found.told else ""))
        if cells:
            body.append([name, str(count), *cells])
    return table(["less what ships", "seeds", *(name for _, _, name, _ in ASKED)], body)


if __name__ == "__main__":
    of = int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES
    run(of)
    print(written(of))
