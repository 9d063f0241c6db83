"""Trains every row of the paper's ablation, loss and iteration tables at one small budget and writes what they reach.

`python -m studies.ablations [SAMPLES]` writes docs/ablations.md after every row. Rows that are there already
(runs/ablations) are not trained again, and one that was stopped goes on from where it is. Equal samples, data, order
and seed in every row.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from nlos.recon.training.dataset import DatasetSettings
from nlos.recon.training.losses import LossSettings
from nlos.recon.training.train import LOG, train
from nlos.recon.training.train_settings import TrainSettings

SAMPLES = 240
FOLDER = Path("runs/ablations")
FORM = "profiles"
"""What NANO last gained (decision 102): rows that were trained before it are trained anew."""
PAGE = Path("docs/ablations.md")
SMALL = {"rows": 32, "cols": 32, "bins": 128, "bin_width_ps": 128.0}
DATA = DatasetSettings(seed=1, scenes=120, degradations=2, **SMALL)  # type: ignore[arg-type]
VALIDATION = DatasetSettings(seed=2, scenes=48, degradations=1, held_out=True, **SMALL)  # type: ignore[arg-type]
ALBEDO = LossSettings(picture=10.0, depth=0.0)
DEPTH = LossSettings(picture=10.0, depth=0.3)
TOTAL_VARIATION = 30.0  # then a tenth of the loss: a volume that adds up to the picture along depth has small gradients
BOTH = LossSettings(picture=10.0, depth=0.3, total_variation=TOTAL_VARIATION)
SMOOTH = LossSettings(picture=10.0, depth=0.0, total_variation=TOTAL_VARIATION)
Figures = Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """One row of one table: its name there, what is switched, and the paper's PSNR (dB) and depth MAD for it."""

    name: str
    paper_psnr: float
    paper_mad: float | None
    switches: dict[str, Any] = field(default_factory=dict)
    loss: LossSettings = DEPTH


NONE = float("nan")
WHOLE = {"lifting": "both", "sfe": True}
BARE = {"lifting": "none", "projection": False, "nle": False}
TABLES = {
    "Parts (paper: table III, SNR 15 to 30 dB)": (
        Row("I: no lifting, no projection, no NLE", 25.34, 0.031, WHOLE | BARE),
        Row("II: MLP lifting, no NLE", 24.68, 0.053, WHOLE | {"lifting": "mlp", "nle": False}),
        Row("III: global and local lifting, no NLE", 26.21, 0.030, WHOLE | {"nle": False}),
        Row("IV: no SFE", 26.48, 0.025, WHOLE | {"sfe": False}),
        Row("V: whole", 28.09, 0.021, WHOLE),
    ),
    "Lifting (paper: table IV)": (
        Row("I: global alone", 25.66, 0.028, WHOLE | {"lifting": "global"}),
        Row("II: local alone", 25.93, 0.029, WHOLE | {"lifting": "local"}),
        Row("III: both", 28.09, 0.021, WHOLE),
    ),
    "Loss (paper: table V)": (
        Row("I: albedo", 28.03, 0.036, WHOLE, ALBEDO),
        Row("II: albedo and depth", 26.92, 0.022, WHOLE, DEPTH),
        Row("III: albedo, depth and TV", 27.58, 0.025, WHOLE, BOTH),
        Row("IV: albedo and TV", 28.09, 0.021, WHOLE, SMOOTH),
    ),
    "Outer iterations (paper: table VII)": tuple(
        Row(f"S = {s}", psnr, None, WHOLE | ({"outer_iterations": s} if s > 1 else {}))
        for s, psnr in zip(range(6, 0, -1), (28.36, 28.22, 28.21, 28.21, 28.26, 27.98), strict=True)
    ),
    "One switch at a time (this project)": (
        Row("no lifting", NONE, None, WHOLE | {"lifting": "none"}),
        Row("MLP lifting", NONE, None, WHOLE | {"lifting": "mlp"}),
        Row("no projection: the bare maximum", NONE, None, WHOLE | {"projection": False}),
        Row("no NLE: one middling noise level", NONE, None, WHOLE | {"nle": False}),
        Row("no lifting and no SFE", NONE, None, {"lifting": "none", "sfe": False}),
        Row("whole", NONE, None, WHOLE),
    ),
    "Reading of the operator (this project)": (
        Row("literal", NONE, None, WHOLE | {"reading": "literal", "channels": [16, 24, 32]}),
        Row(
            "literal, as printed: PReLU, stride 2, no whitening",
            NONE,
            None,
            WHOLE
            | {
                "reading": "literal",
                "channels": [16, 24, 32],
                "activation": "prelu",
                "restriction": "stride",
                "whiten": False,
            },
        ),
        Row("physical", NONE, None, WHOLE),
    ),
}  # fmt: skip


def settings_of(row: Row, samples: int) -> TrainSettings:
    """The training of one row: only what the row names differs from the others."""
    return TrainSettings(
        method="nano",
        method_settings={"noise_weights": "nano", "symmetries": False} | row.switches,
        data=DATA,
        validation=VALIDATION,
        loss=row.loss,
        samples=samples,
        learning_rate=1.5e-3,
        warm_up_steps=20,
    )


def folder_of(row: Row, samples: int) -> Path:
    """Rows that are the same in two tables are trained once."""
    words = [f"{key}-{value}" for key, value in sorted(row.switches.items())]
    words += [f"{key}-{value:g}" for key, value in row.loss.model_dump(exclude_defaults=True).items()]
    name = "_".join(words).replace(" ", "").replace("[", "").replace("]", "").replace(",", "-")
    return FOLDER / f"{samples}-{FORM}" / name


def finished(folder: Path) -> Figures | None:
    """What the finished run in `folder` reached; None where there is none."""
    lines = (folder / LOG).read_text(encoding="utf-8").splitlines() if (folder / LOG).exists() else []
    summaries = [json.loads(line) for line in lines if '"finished": true' in line]
    return dict(summaries[-1]["validation"]) if summaries else None


def page(known: Mapping[Path, Figures], samples: int) -> str:
    """docs/ablations.md: own figures beside the paper's, each as the difference to the last row of its table.

    `known` holds the figures of the rows that are trained, by their folders.
    """
    lines = [
        "# What each part of NANO is worth",
        "",
        f"Every row was trained on the same {samples} samples in the same order ({DATA.rows} x {DATA.cols} points, "
        f"{DATA.bins} bins of {DATA.bin_width_ps:g} ps, batch 2, one seed) and judged on {VALIDATION.scenes} scenes of "
        "kinds that none was trained on, at every noise level and sampling of the detector model. PSNR at the best "
        "least-squares scale. Differences are against the row named in brackets; the paper's are its own, from longer "
        "training on another set, so only sign and order can be compared. One seed: below about 0.3 dB nothing is "
        "meant. A row takes about a minute of one core, several passes and the literal reading up to four. Lifting and "
        "the last pass come in from zero, so a budget this small shows little of them. Made by `make ablations`, which "
        "goes on from what is finished; `python -m studies.ablations SAMPLES` asks for a larger budget.",
    ]
    found = [figures for figures in known.values() if "lct_psnr" in figures]
    if found:
        lines += ["", f"Light-cone transform on the same scenes, each at its best snr: {found[0]['lct_psnr']:.2f} dB."]
    wanted = {folder_of(row, samples) for row in in_order()}
    if missing := wanted - known.keys():
        lines += ["", f"{len(missing)} of {len(wanted)} rows are not trained yet."]
    for title, rows in TABLES.items():
        head = f"| row | PSNR dB | against [{rows[-1].name}] | paper | depth MAD mm | paper mm |"
        lines += ["", f"## {title}", "", head, "|---|---|---|---|---|---|"]
        last = known.get(folder_of(rows[-1], samples))
        for row in rows:
            paper = "-" if row.paper_psnr != row.paper_psnr else f"{row.paper_psnr - rows[-1].paper_psnr:+.2f}"
            mad = "-" if row.paper_mad is None else f"{1e3 * row.paper_mad:.0f}"
            got = known.get(folder_of(row, samples))
            if got is None:
                lines.append(f"| {row.name} | not trained yet | | {paper} | | {mad} |")
                continue
            own = "-" if last is None else f"{got['psnr'] - last['psnr']:+.2f}"
            lines.append(
                f"| {row.name} | {got['psnr']:.2f} | {own} | {paper} | {1e3 * got['depth_mad_m']:.1f} | {mad} |"
            )
    return "\n".join(lines) + "\n"


def in_order() -> list[Row]:
    """The row that all are compared with first, the dearest last."""

    def cost(row: Row) -> tuple[int, bool]:
        passes = row.switches.get("outer_iterations", 1)
        return max(passes, 3 if row.switches.get("reading") == "literal" else 1), row.switches != WHOLE

    return sorted((row for rows in TABLES.values() for row in rows), key=cost)


def main(samples: int = SAMPLES) -> None:
    """Train what is not there yet, and write the page after each row."""
    known = {folder: figures for row in in_order() if (figures := finished(folder := folder_of(row, samples)))}
    PAGE.write_text(page(known, samples), encoding="utf-8")
    for row in in_order():
        folder = folder_of(row, samples)
        if folder in known:
            continue
        print(f"{row.name}: {folder.name}", file=sys.stderr, flush=True)
        train(settings_of(row, samples), folder, lambda line: None)
        reached = finished(folder)
        assert reached is not None
        known[folder] = reached
        PAGE.write_text(page(known, samples), encoding="utf-8")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:2]))
