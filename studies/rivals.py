"""Rivals treated as well as NANO, at equal samples: differences on the rendered scenes, paired, with errors.

`python -m studies.rivals ../shared/data/synthetic docs/rivals.md`; what was measured before with the same weights, code
and data is not measured again (runs/results).
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nlos.recon.weights.files import read_weights
from studies.paired import Difference, Figures, difference, of_scenes
from studies.results.kept import weights_path
from studies.results.quality import CONDITIONS, Quality, measure_quality, trained
from studies.results.tables import FIGURES, shown, table

SHOWN = ("psnr", "ssim", "depth_rmse_m", "depth_mad_m")


@dataclass(frozen=True)
class Pair:
    """NANO and a rival that has seen as many samples, and what is not the same of the two."""

    own: str
    rival: str
    unequal: str


DATA = (
    "NANO's scans have 0.3 to 250 counts in the brightest bin, 4 in 10 are sparse, some have 32 x 32 points or 400 "
    "bins (how many is not kept), and an eighth of their scenes is far away; the rival's have 0.4 to 200 counts, 3 in "
    "10 are sparse, and 20 % of the steps are on half the grid"
)
GAPS = "NANO sees gaps filled as well as empty, the rival empty alone"
NLE = "NANO's noise estimation, frozen, had learned from 1,900 steps before, which are not among its samples"
PAIRS = (
    Pair("nano_4000", "lfe_4000", f"NANO is averaged over eight mirror images; {DATA}; {GAPS}; {NLE}"),
    Pair("nano_4000_once", "lfe_4000", f"{DATA}; {GAPS}; {NLE}; both see the scan once, unmirrored"),
    Pair("nano_4000_once", "unet_4000", f"{DATA}; {GAPS}; {NLE}"),
    Pair("nano_4000_once", "nlost_4000", f"{DATA}; {GAPS}; {NLE}"),
    Pair(
        "nano_4000", "lfe",
        f"LFE: two samples a step, 2,000 scenes, square error; 1,000 samples to twice the depth; {GAPS}; {NLE}",
    ),
    Pair("nano_4000", "nlost", f"NLOST: two samples a step, 2,000 scenes, square error; {GAPS}; {NLE}"),
    Pair(
        "nano_4000_once", "faithful",
        "faithful: the paper's loss (MSE and total variation) and its added noise, a rate of 0.001 for NANO's 0.0015, "
        "an exponential schedule for a cosine, two thirds of its steps at half the grid, no far scenes, gaps filled "
        "alone; both have the noise estimation",
    ),
    Pair(
        "nano_6500", "unet", f"U-Net: two samples a step, 2,000 scenes, square error; {GAPS}; {NLE}"
    ),
)  # fmt: skip


def samples_seen(name: str) -> int:
    """By the weights of that name, from the first of all."""
    about = read_weights(weights_path(name)).about
    return int(about["samples"] + about.get("samples_before", 0))


def by_scene(quality: Quality, method: str, condition: str, figure: str) -> Figures:
    """(1, scenes) in the order of the scenes; NaN where a scene has no such figure."""
    return of_scenes(quality.rows, (scene.name for scene in quality.scenes), method, condition, figure)


def cell(found: Difference, figure: str) -> str:
    """`+2.1 ± 0.3`, and whether it is beyond chance over scenes in NANO's favour (*), not told, or against (worse)."""
    column = FIGURES[figure]
    text = f"{column.factor * found.mean:+.{column.digits}f} ± {column.factor * found.error:.{column.digits}f}"
    if not found.beyond_chance:
        return text
    return text + (" *" if (found.mean > 0) == column.higher_is_better else " worse")


def of_pair(quality: Quality, pair: Pair) -> str:
    """One section: what is compared, and the table of differences."""
    samples = [f"{name} {samples_seen(name):,}" for name in (pair.own, pair.rival)]
    body = []
    for figure in SHOWN:
        cells = []
        for condition in CONDITIONS:
            own, other = (by_scene(quality, name, condition, figure) for name in (pair.own, pair.rival))
            cells.append(cell(difference(own, other), figure))
        body.append([FIGURES[figure].title, *cells])
    return (
        f"## {pair.own} less {pair.rival}\n\nSamples seen: {', '.join(samples)}. Not the same: {pair.unequal}.\n\n"
        + table(["", *CONDITIONS], body)
    )


def costs(names: Sequence[str]) -> str:
    """Parameters, samples and seconds of training, one line a set of weights."""
    body = []
    for name in names:
        weights = read_weights(weights_path(name))
        about = weights.about
        hours = about["hours"] + about.get("hours_before", 0.0)
        recipe = about.get("settings", {})
        batch = recipe.get("batch") if isinstance(recipe, dict) else None
        body.append([
            name, f"{sum(x.numel() for x in weights.tensors.values()):,}", f"{samples_seen(name):,}",
            shown(batch, 0), f"{3600 * hours:,.0f}",
            f"{about.get('device', '-')}, threads: {about.get('threads', '-')}",
        ])  # fmt: skip
    return table(["weights", "parameters", "samples", "a step", "seconds of training", "on"], body)


def page(data: Path) -> str:
    """docs/rivals.md."""
    chosen = [pair for pair in PAIRS if weights_path(pair.rival).exists()]
    names = list(dict.fromkeys(name for pair in chosen for name in (pair.own, pair.rival)))
    quality = measure_quality(data, trained(names), CONDITIONS)
    means = [
        [name, *(f"{np.nanmean(by_scene(quality, name, condition, 'psnr')):.2f}" for condition in CONDITIONS)]
        for name in names
    ]
    parts = [
        "# NANO and its rivals at equal samples",
        f"On the {len(quality.scenes)} rendered scenes, in every condition of the results page. Differences are "
        "NANO's less the rival's, paired over scenes, ± one standard error over scenes; one seed each, so the error "
        "of the seeds is not in it. * above as many errors as Student's distribution has at 95 % for seven scenes "
        "(2.45), in NANO's favour; worse: against it; no mark: not told. These scenes also helped to choose designs; "
        "held-out kinds are the stricter test. Seconds of training are by the clock of a shared machine, on mixed "
        "grids: compare a step's time in [complexity](complexity.md). Made by `python -m studies.rivals DATA "
        "docs/rivals.md`.",
        costs(names),
        table(["PSNR at the best scale, dB", *CONDITIONS], means),
        *(of_pair(quality, pair) for pair in chosen),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


if __name__ == "__main__":
    made = page(Path(sys.argv[1]))
    Path(sys.argv[2]).write_text(made, encoding="utf-8")
