"""Trains every row of the paper's ablation, loss and iteration tables at one small budget and writes what they reach.

`python -m recon.training.ablations [SAMPLES]` writes docs/ablations.md. Rows that are there already (runs/ablations)
go on from where they are, so it can be stopped at any time. Equal samples, data, order and seed in every row.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from recon.training.dataset import DatasetSettings
from recon.training.losses import LossSettings
from recon.training.train import train
from recon.training.train_settings import TrainSettings

SAMPLES = 1200
FOLDER = Path("runs/ablations")
PAGE = Path("docs/ablations.md")
SMALL = {"rows": 32, "cols": 32, "bins": 128, "bin_width_ps": 128.0}
DATA = DatasetSettings(seed=1, scenes=400, degradations=2, **SMALL)  # type: ignore[arg-type]
VALIDATION = DatasetSettings(seed=2, scenes=48, degradations=1, held_out=True, **SMALL)  # type: ignore[arg-type]
ALBEDO = LossSettings(picture=10.0, depth=0.0)
DEPTH = LossSettings(picture=10.0, depth=0.3)
BOTH = LossSettings(picture=10.0, depth=0.3, total_variation=0.3)
SMOOTH = LossSettings(picture=10.0, depth=0.0, total_variation=0.3)


@dataclass(frozen=True)
class Row:
    """One row of one table: its name there, what is switched, and the paper's PSNR (dB) and depth MAD for it."""

    name: str
    paper_psnr: float
    paper_mad: float | None
    switches: dict[str, Any] = field(default_factory=dict)
    loss: LossSettings = DEPTH


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
        Row(f"S = {s}", psnr, None, WHOLE | {"outer_iterations": s})
        for s, psnr in zip(range(1, 7), (27.98, 28.26, 28.21, 28.21, 28.22, 28.36), strict=True)
    ),
    "Reading of the operator (this project)": (
        Row("literal", float("nan"), None, WHOLE | {"reading": "literal", "channels": [16, 24, 32]}),
        Row(
            "literal, as printed: PReLU, stride 2, no whitening",
            float("nan"),
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
        Row("physical", float("nan"), None, WHOLE),
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
        warm_up_steps=50,
    )


def folder_of(row: Row, samples: int) -> Path:
    """Rows that are the same in two tables are trained once."""
    words = [f"{key}-{value}" for key, value in sorted(row.switches.items())]
    words += [f"{key}-{value:g}" for key, value in row.loss.model_dump().items()]
    return FOLDER / str(samples) / "_".join(words).replace(" ", "").replace("[", "").replace("]", "").replace(",", "-")


def page(results: dict[str, list[dict[str, float]]], samples: int) -> str:
    """docs/ablations.md: own figures beside the paper's, each as the difference to the last row of its table."""
    lines = [
        "# What each part of NANO is worth",
        "",
        f"Every row was trained on the same {samples} samples in the same order ({DATA.rows} x {DATA.cols} points, "
        f"{DATA.bins} bins of {DATA.bin_width_ps:g} ps, batch 2, one seed) and judged on {VALIDATION.scenes} scenes of "
        "kinds that none was trained on, at every noise level and sampling of the detector model. PSNR at the best "
        "least-squares scale. Differences are against the row named in brackets; the paper's are its own, from longer "
        "training on another set, so only sign and order can be compared. One seed: below about 0.3 dB nothing is "
        "meant. Made by `make ablations`.",
    ]
    for title, rows in TABLES.items():
        if title not in results:
            continue
        found = results[title]
        last = found[-1]
        lines += ["", f"## {title}", "", f"| row | PSNR dB | against [{rows[-1].name}] | paper | depth MAD m | paper |"]
        lines += ["|---|---|---|---|---|---|"]
        for row, got in zip(rows, found, strict=True):
            paper = f"{row.paper_psnr - rows[-1].paper_psnr:+.2f}" if row.paper_psnr == row.paper_psnr else "-"
            mad = "-" if row.paper_mad is None else f"{row.paper_mad:.3f}"
            own = f"{got['psnr'] - last['psnr']:+.2f}"
            lines.append(f"| {row.name} | {got['psnr']:.2f} | {own} | {paper} | {got['depth_mad_m']:.4f} | {mad} |")
    return "\n".join(lines) + "\n"


def main(samples: int = SAMPLES) -> None:
    """Train what is not there yet, table by table, and write the page after each."""
    results: dict[str, list[dict[str, float]]] = {}
    known: dict[Path, dict[str, float]] = {}
    for title, rows in TABLES.items():
        found = []
        for row in rows:
            folder = folder_of(row, samples)
            if folder not in known:
                print(f"{title}: {row.name}", file=sys.stderr, flush=True)
                known[folder] = train(settings_of(row, samples), folder, lambda line: None)["validation"]
            found.append(known[folder])
        results[title] = found
        PAGE.write_text(page(results, samples), encoding="utf-8")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:2]))
