"""docs/results.md from what `nlos evaluate` measured: quality by condition and scene, and what training cost.

`python -m recon.training.results_page RESULTS.json... > docs/results.md`; one section a file.
"""

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

from recon.training.checkpoint import OWN_FOLDER, read_weights

Row = dict[str, Any]
RIVAL = "lct"
TITLES = {
    "psnr": "PSNR at the best scale, dB",
    "psnr_max": "PSNR of pictures over their maximum, dB",
    "ssim": "SSIM",
    "depth_mad_m": "mean absolute depth error, m",
    "depth_rmse_m": "root mean square depth error, m",
}
DIGITS = {"psnr": 2, "psnr_max": 2, "ssim": 3, "depth_mad_m": 4, "depth_rmse_m": 4}


def unique(values: Iterable[str]) -> list[str]:
    """Each once, in the order of appearance."""
    return list(dict.fromkeys(values))


def mean(rows: Iterable[Row], figure: str) -> float | None:
    """Over the rows that have the figure; None where none has."""
    values = [row[figure] for row in rows if row.get(figure) is not None and row[figure] == row[figure]]
    return fmean(values) if values else None


def shown(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def table(head: Sequence[str], body: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *body]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines) + "\n"


def by_condition(rows: Sequence[Row], figure: str) -> str:
    """Means over scenes, one line a method, one column a condition."""
    methods, conditions = unique(r["method"] for r in rows), unique(r["condition"] for r in rows)
    body = [
        [m, *(shown(mean(pick(rows, method=m, condition=c), figure), DIGITS[figure]) for c in conditions)]
        for m in methods
    ]
    return table([TITLES[figure], *conditions], body)


def margins(rows: Sequence[Row]) -> str:
    """PSNR over the light-cone transform's at its best snr, one line a method."""
    conditions = unique(r["condition"] for r in rows)
    body = []
    for method in unique(r["method"] for r in rows):
        line = [method]
        for condition in conditions:
            own, rival = (mean(pick(rows, method=m, condition=condition), "psnr") for m in (method, RIVAL))
            line.append("-" if own is None or rival is None else f"{own - rival:+.2f}")
        body.append(line)
    return table([f"margin over {RIVAL}, dB", *conditions], body)


def by_scene(rows: Sequence[Row], condition: str) -> str:
    """PSNR of one condition, one line a scene, one column a method."""
    methods, chosen = unique(r["method"] for r in rows), pick(rows, condition=condition)
    body = [
        [scene, *(shown(mean(pick(chosen, method=m, scene=scene), "psnr"), 2) for m in methods)]
        for scene in unique(r["scene"] for r in chosen)
    ]
    return table([f"PSNR, {condition}", *methods], body)


def training(methods: Iterable[str], folder: Path = OWN_FOLDER) -> str:
    """What the shipped weights of these methods cost: parameters, samples seen, hours, validation."""
    body = []
    for method in methods:
        path = folder / f"{method}.safetensors"
        if not path.exists():
            continue
        weights = read_weights(path)
        about = weights.about
        count = sum(tensor.numel() for tensor in weights.tensors.values())
        found = about.get("validation", {}).get("psnr")
        where = f"{about['device']}, threads: {about['threads']}"
        samples = about["samples"] + about.get("samples_before", 0)
        hours = about["hours"] + about.get("hours_before", 0.0)
        body.append([method, f"{count:,}", f"{samples:,}", f"{hours:.2f}", where, shown(found, 2)])
    if not body:
        return "No weights are shipped with these methods.\n"
    return table(["training", "parameters", "samples seen", "hours", "on", "validation PSNR, dB"], body)


def pick(rows: Iterable[Row], **wanted: str) -> list[Row]:
    return [row for row in rows if all(row[key] == value for key, value in wanted.items())]


def section(title: str, rows: Sequence[Row]) -> str:
    """All tables of one file of results."""
    parts = [f"## {title}\n", margins(rows), *(by_condition(rows, figure) for figure in TITLES)]
    parts += [by_scene(rows, condition) for condition in unique(r["condition"] for r in rows)]
    return "\n".join(parts)


def page(files: Sequence[Path]) -> str:
    """The whole page."""
    results = {path: json.loads(path.read_text()) for path in files}
    methods = unique(row["method"] for rows in results.values() for row in rows)
    head = (
        "# Results\n\nMade by `make results`. Means over scenes. Physics methods run at the best of five snr for every "
        "condition. No network was trained on any of these scenes; every learned method saw the simulated training "
        "scenes alone, as often as the last table says.\n"
    )
    sections = [section(path.parent.name, rows) for path, rows in results.items()]
    return "\n".join([head, *sections, "## What training cost\n", training(methods)])


if __name__ == "__main__":
    print(page([Path(name) for name in sys.argv[1:]]), end="")
