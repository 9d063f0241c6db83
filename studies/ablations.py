"""The ablation tables: every row trained on the same samples with every seed, judged on scenes of kinds never seen.

`python -m studies.ablations [SAMPLES]` resumes where it was stopped: trains what is not trained, writes
docs/ablations.md after each training. Two processes may share the work, one core each.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from studies.judged import FIGURES, Judged, judge, judged
from studies.paired import Difference, Figures, difference
from studies.row import RATE, RIVALS_RATE, Row
from studies.rows import (
    FORM,
    JUDGED,
    PRINTED_AT,
    SAMPLES,
    SEEDS,
    SMALL,
    TABLES,
    folder_of,
    in_order,
    judged_on,
    kept_of,
    settings_of,
)

PAGE = Path("docs/ablations.md")
UNITS = {"psnr": ("PSNR dB", 1.0, ".2f"), "ssim": ("SSIM", 1.0, ".3f"), "depth_rmse_m": ("depth RMSE mm", 1e3, ".1f"),
         "depth_mad_m": ("depth MAD mm", 1e3, ".1f")}  # fmt: skip
CLAIM = "claimed"
NOMINAL = {where: f"nominally {where}" for where in PRINTED_AT}
NOTES = (
    "Ranges of noise are nominal: so many counts in a point's brightest bin as make 15 to 30 dB (71 to 2,240) and 15 "
    "to 20 dB (71 to 224) of the seven rendered scenes at 64 x 64 points (`studies/snr.py`). The scans judged, of 32 "
    "x 32 points and other scenes, have 15.8 to 30.4 and 13.9 to 22.6 dB; of the second 14 of 48 lie outside the "
    "range.",
    f"Rivals are trained at a rate of {RIVALS_RATE:g}, NANO and the printed network at {RATE:g}, all with one sample "
    f"a step; NANO of four times the samples at {RIVALS_RATE:g} with two a step. LFE's rate has a table below. The "
    "noise estimation of NANO and of the printed network is what ships: it was trained before (1,900 steps) and is "
    "frozen; rivals have none, and its steps are not among the samples. Rivals see the gaps of a sparse scan empty, "
    "NANO filled and empty, and the printed network filled, unless a table says otherwise; at equal samples rivals "
    "have fewer parameters but for NLOST (LFE 0.24 million, the U-Net 0.91, NLOST 1.21, NANO 1.12). "
    "Without the noise estimation (no NLE) the operator alone is told a middling noise level; falloff and snr of the "
    "inverse that it starts from still follow the estimate. Such rows say less than what the estimate is worth, and "
    "are not the paper's; the rows `H fixed ..., no NLE` among the readings, and all of the table with H fixed at -1.4 "
    "but its last, are told no noise level at all. Rows that are mirrored are judged by a training of the same "
    "settings, of the printed network and NANO another one than that which was judged seen once.",
    "As it ships is NANO's parts, its scan seen once and its picture unrefined, in all rows; what mirror images are "
    "worth is in [the paper, claim by claim](paper.md), by the same weights. Equal seconds are those of one CPU core: "
    "LFE learns from 2,630 scenes, NLOST from 1,460 and the U-Net from 1,900. The light-cone transform runs at the "
    "snr that it finds in the data, where other pages have the best of five.",
    "The printed network learns by the paper's loss (brightness and total variation) under the paper's noise, which "
    "is added to what its detector counts; rivals and NANO learn by NANO's loss, with depth, and without that noise. "
    "Where they stand in one table, its columns of depth compare losses as well. All of the paper's parts are, in "
    "NANO, both liftings and an SFE whose M has rank 16, where eq. 13 has a dense one.",
    "Of each training the weights are kept that are best in PSNR at one of eight checks on four scenes, of the kinds "
    "that rows are judged on and under all conditions, also where a network learns from cycles (`rows.WATCHED`): a "
    "row may be of fewer samples than it saw, and its kinds have chosen among eight. The printed network is checked "
    "without its added noise.",
    "A row's own figure is the mean over all of its seeds and scenes; a difference is over those that both rows "
    "have. Depths are compared where a method says one: NANO from 0.003 of its brightest point on, the others from "
    "0.02, so of more or fewer pixels. A picture that says none leaves its scene out: NANO's and the printed "
    "network's of one scene of the cycles under all conditions, which stay dark in all seeds. What the errors leave "
    "out: all seeds learn from the same scenes with the same noise, by one frozen noise estimation and one draw of "
    "SFE's M.",
    "Machines and times: trainings ran on one core of an AMD EPYC (two virtual cores), 4 to 10 minutes each and up "
    "to 30 with six passes; but the third seeds of the first eight readings, of NANO without a part (but "
    "for the last row of what ships) and of LFE and the U-Net at equal seconds, at equal parameters and on cycles, "
    "and all rows of four times the samples, ran on an NVIDIA H100, sixteen at a time: 33 to 131 s each, and 120 to "
    "271 s with four times the samples. So some third seeds are compared across machines, which differ as seeds do: "
    "the third seed of table V's last row, trained on both, had 18.84 dB on the H100 and 18.99 on the EPYC at 15 to "
    "30 dB, 17.10 and 17.14 in all conditions; the latter stands. Networks learn in bfloat16 where the machine "
    "multiplies in it; second seeds of the U-Net at equal seconds and at equal parameters, and of what is trained on "
    "cycles, learned in float32, on a third machine.",
)
"""What a reader of the tables has to know about the rows."""
Known = Mapping[Path, Judged]


def run(samples: int = SAMPLES, seeds: Sequence[int] = SEEDS, page: Path = PAGE) -> None:
    """Train and judge what is not there yet, one row after the other; rows that another process has are passed over."""
    for row, seed in in_order(samples, tuple(seeds)):
        folder, kept = folder_of(row, samples, seed), kept_of(row, samples, seed)
        if judged(kept) is not None:
            continue
        settings = settings_of(row, samples, seed)
        sets = judged_on(row, JUDGED)
        judging = partial(judge, settings, folder if row.trained else None, kept, sets, row.mirrored)
        name = f"{row.method}: {row.name}, seed {seed}"
        if not train_and_judge(name, settings if row.trained else None, folder, judging):
            return
        page.write_text(written(known(samples, seeds), samples, seeds), encoding="utf-8")


def train_and_judge(name: str, settings: TrainSettings | None, folder: Path, judging: Callable[[], object]) -> bool:
    """Trains in `folder`, unless `settings` is None, then judges; passed over where another process has it. False where
    the training was told to end: what is half trained is not judged, and resumes next time."""
    with Claim(folder) as mine:
        if not mine:
            return True
        print(f"{name}: {folder}", file=sys.stderr, flush=True)
        if settings is not None and not train(settings, folder, lambda line: None)["finished"]:
            return False
        judging()
    return True


class Claim:
    """A row is worked on by one process: a file with its number, void once that process is gone."""

    def __init__(self, folder: Path) -> None:
        self._file = folder / CLAIM

    def __enter__(self) -> bool:
        self._file.parent.mkdir(parents=True, exist_ok=True)
        try:
            holder = int(self._file.read_text())
        except (FileNotFoundError, ValueError):
            holder = 0
        if holder and Path(f"/proc/{holder}").exists() and holder != os.getpid():
            return False
        self._file.write_text(str(os.getpid()))
        return True

    def __exit__(self, *_: object) -> None:
        if self._file.exists() and self._file.read_text() == str(os.getpid()):
            self._file.unlink()


def known(samples: int, seeds: Sequence[int]) -> Known:
    """The figures of everything that is trained and judged."""
    files = [kept_of(row, samples, seed) for row, seed in in_order(samples, tuple(seeds))]
    return {file: figures for file in files if (figures := judged(file)) is not None}


def figures_of(found: Known, samples: int, seeds: Sequence[int], where: str, row: Row, figure: str) -> Figures | None:
    """(seeds, scenes) of the seeds that are judged, the first ones; None where none is."""
    rows = []
    for seed in seeds:
        one = found.get(kept_of(row, samples, seed))
        if one is None or where not in one:
            break
        rows.append(one[where][figure])
    return np.asarray(rows, dtype=np.float64) if rows else None


def written(found: Known, samples: int, seeds: Sequence[int]) -> str:
    """docs/ablations.md: every row's figures and its difference to the last row of its table, with errors."""
    judgements = [(row, seed) for row, seed in in_order(samples, tuple(seeds)) if row.trained]
    trainings = {folder_of(row, samples, seed) for row, seed in judgements}
    done = len({folder_of(*one) for row, seed in judgements if kept_of(*(one := (row, samples, seed))) in found})
    different = len(trainings) // len(seeds)
    lines = [
        "# What each part is worth",
        "",
        f"Every row is trained on the same {samples:,} scenes, one a step, where its table does not say otherwise "
        f"({SMALL['rows']} x {SMALL['cols']} points, {SMALL['bins']} bins of {SMALL['bin_width_ps']:g} ps), with up to "
        f"{len(seeds)} seeds (each table says how many), and judged on "
        f"{len(next(iter(JUDGED.values())))} scenes of kinds that none was trained on (the last two tables on other "
        "scenes of its kind), for each range of noise. Differences are to the last row of the table, paired over "
        "scenes and seeds, ± one standard error of both; a "
        "difference is told from nothing, and marked *, where it has more than one seed and lies above so many of its "
        "errors as Student's distribution has at 95 % for so few seeds (2 to 12). Of those that are nothing one in "
        "twenty is told all the same, of two seeds up to one in nine, and there are hundreds here. The paper's "
        "differences are its own, from longer training on another set: compare sign and order.",
        "",
        *(line for note in NOTES for line in (note, "")),
        f"{done} of {len(trainings)} trainings are done: {different} rows with {len(seeds)} seeds each, the light-cone "
        "transform, which is not trained, left aside. Made by `make studies`, which resumes from what is finished. "
        "Networks of form " + FORM + ".",
    ]
    for title, rows in TABLES.items():
        lines += ["", f"## {title}"]
        for where in JUDGED:
            table = _table(rows, partial(figures_of, found, samples, seeds, where), where)
            if table:
                lines += ["", f"Scans of {NOMINAL.get(where, where)}:", "", *table]
        if len(lines) and lines[-1] == f"## {title}":
            lines += ["", "Not trained yet."]
    return "\n".join(lines) + "\n"


def _table(rows: Sequence[Row], get: Callable[[Row, str], Figures | None], where: str) -> list[str]:
    """Markdown lines; none where no row is trained."""
    if all(get(row, "psnr") is None for row in rows):
        return []
    heads = [f"{UNITS[figure][0]} | difference" for figure in FIGURES]
    lines = [f"| row | seeds | {' | '.join(heads)} | paper, PSNR |", "|" + "---|" * (2 + 2 * len(FIGURES) + 1)]
    last = rows[-1]
    for row in rows:
        paper = "-"
        own_print, last_print = printed_at(row, where), printed_at(last, where)
        if "psnr" in own_print and "psnr" in last_print:
            paper = f"{own_print['psnr'] - last_print['psnr']:+.2f}"
        own = get(row, "psnr")
        if own is None:
            lines.append(f"| {row.name} | 0 |{' | |' * len(FIGURES)} {paper} |")
            continue
        cells = []
        for figure in FIGURES:
            values, other = get(row, figure), get(last, figure)
            _, scale, form = UNITS[figure]
            assert values is not None
            cells.append(f"{scale * float(np.nanmean(values)):{form}}")
            same = row is last or other is None
            cells.append("-" if same or other is None else _cell(difference(values, other), scale, form))
        seeds = len(own) if row.trained else "-"
        lines.append(f"| {row.name} | {seeds} | {' | '.join(cells)} | {paper} |")
    return lines


def printed_at(row: Row, where: str) -> dict[str, float]:
    """The paper's figures for a row in this range of noise; none where it has none."""
    return getattr(row, PRINTED_AT[where]) if where in PRINTED_AT else {}


def _cell(found: Difference, scale: float, form: str) -> str:
    text = f"{scale * found.mean:+{form}} ± {scale * found.error:{form}}"
    return text + " *" if found.told else text


if __name__ == "__main__":
    run(int(sys.argv[1]) if len(sys.argv) > 1 else SAMPLES)
