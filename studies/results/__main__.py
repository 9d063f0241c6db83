"""Makes docs/results.md: `python -m studies.results [DATA] [DOCS]`, or `make results`.

DATA is the folder with `synthetic` and `real`. What was measured before with the same weights, code and data is not
measured again (runs/results).
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from nlos.recon.results import software
from nlos.recon.training.scene_files import write_all
from studies import convergence, noise_figure
from studies.results import studies
from studies.results.kept import BASE, EQUAL, TREATED_ALIKE, WEIGHTS_OF
from studies.results.measured_scenes import METHODS as PICTURED
from studies.results.measured_scenes import measured_scenes
from studies.results.noiseless import noiseless
from studies.results.opening import opening
from studies.results.quality import (
    CONDITIONS,
    FEWER_AND_SLOWER,
    LEARNED,
    PHYSICS,
    THRESHOLDED,
    Quality,
    draw_gallery,
    gallery_caption,
    measure_quality,
    thresholded,
    trained,
)
from studies.results.tables import (
    FIGURES,
    at_a_glance,
    by_condition,
    by_scene,
    comparison,
    margins,
    samples_seen,
    settings,
    table,
    training,
    unique,
)
from studies.results.targets import against, of_quality, remarks, section

HELD_OUT = Path("runs/held_out")
GLANCE = """Seven rendered scenes by a renderer that is not this project's, with their truth: NANO and the light-cone
transform at the best of five snr for each condition, both told the response where there is one (`~300ps`).
"""
HEAD = """Made by `make results`. PSNR and SSIM on the full picture, truth divided by its maximum, prediction by its
best least-squares scale unless said otherwise; means over scenes. Methods with an inverse filter run at the best of
five snr for every condition, so that nobody wins by a rival's bad setting. `counts_pN` has N counts in a point's
brightest bin on average; `@16x16` and `@blue:256` are a sixteenth of the points. No network was trained on any of these
scenes; every learned method saw simulated training scenes alone, as many as the table below says. But letters,
bicycles, busts and steps are among the kinds of those, too, and designs, losses and which weights ship were chosen
while looking at the rendered scenes: the kinds held out from training, further down, are the stricter test. Seconds
are of the machine that made this page, busy or not."""
HELD_OUT_AT = ("transient", "counts_p5", "counts_p1", "counts_p5@16x16")


def quality_section(quality: Quality) -> str:
    """All tables of one set of scenes."""
    cut = thresholded(quality)
    conditions = unique(row["condition"] for row in quality.rows)
    parts = [margins(quality.rows)]
    parts += [by_condition(quality.rows + (cut if figure == "ssim" else []), figure) for figure in FIGURES]
    parts += ["By kind of scene:\n", *(by_scene(quality.rows, condition) for condition in conditions)]
    return "\n".join(parts)


def own_weights(rival: str, methods: Sequence[str]) -> str:
    """The weights of NANO that are compared with this rival, at equal samples seen."""
    return EQUAL[rival] if EQUAL[rival] in methods else "nano"


def equal_samples(quality: Quality, rivals: Sequence[str]) -> str:
    """NANO against rivals that have seen equally many samples, with how many those are."""
    if not rivals:
        return "Nothing to compare with is trained yet.\n"
    own = own_weights(rivals[0], unique(row["method"] for row in quality.rows))
    figures = ("psnr", "ssim", "depth_rmse_m", "depth_mad_m", "depth_missing")
    differences, worse = comparison(quality.rows, own, rivals, figures)
    seen = {method: samples_seen(method) for method in (own, *rivals)}
    text = f"Samples seen: {', '.join(f'{method} {count:,}' for method, count in seen.items() if count is not None)}.\n"
    if own == "nano":
        text += "The margins are between the weights as they ship, whatever they have seen.\n"
    said = (
        f"Not better: {worse}."
        if worse
        else "NANO is better in every cell; docs/rivals.md says what is told from errors."
    )
    return f"{text}\n{differences}\n{said}\n"


def convergence_section(docs: Path, remark: str) -> str:
    """Measured anew where the weights of the rows are, which `make studies` makes; elsewhere as the page has it, so
    that no row is lost."""
    title, rows = "## Convergence of algorithm 1\n", convergence.trained()
    before = docs / "results.md"
    _, found, rest = before.read_text(encoding="utf-8").partition(title) if before.exists() else ("", "", "")
    if found and not rows:
        return (found + rest.partition("\n## ")[0]).rstrip("\n")
    others = [Path(convergence.__file__), *(path for path, _ in rows.values())]
    steps = studies.drawn("convergence", convergence.measure, docs / "results", others)
    text = (
        title,
        "![convergence](results/convergence.png)\n",
        convergence.LEGEND,
        studies.convergence_text(steps),
        remark,
    )
    return "\n".join(text)


def page(data: Path, docs: Path) -> str:
    """Measures what is missing, draws, and returns the page."""
    pictures = docs / "results"
    pictures.mkdir(parents=True, exist_ok=True)
    written = remarks(pictures / "remarks.md")
    methods = [*PHYSICS, *trained(LEARNED)]
    absent = [method for method in LEARNED if method not in (*methods, *BASE)]
    rivals = [method for method in EQUAL if method in methods]
    quality = measure_quality(data / "synthetic", methods, CONDITIONS)
    further = measure_quality(data / "synthetic", ["lct", "nano"], FEWER_AND_SLOWER)
    write_all(HELD_OUT)
    held_out = measure_quality(HELD_OUT, [method for method in methods if method not in BASE], HELD_OUT_AT)
    for name, condition in (("full", "counts_p5"), ("sparse", "counts_p5@16x16")):
        shown = [method for method in ("lct", "fk", "phasor", "lfe", "nlost", "unet", "nano") if method in methods]
        draw_gallery(quality, shown, [condition], pictures / f"{name}.png")
    levels = studies.drawn("noise_level", noise_figure.measure, pictures)
    grids = {method: studies.grids(method) for method in trained(("nano", "unet"))}
    fast = studies.speed()
    targets = of_quality(quality.rows + further.rows, thresholded(quality))
    for rival, own in TREATED_ALIKE.items():
        if rival in methods and own in methods:
            targets += against(quality.rows, own, rival)
    targets += studies.targets(levels, grids["nano"], fast)
    say = written.get
    return "\n".join(
        [
            "# Results\n",
            opening(data / "real", pictures),
            GLANCE,
            at_a_glance(quality.rows + further.rows),
            f"{HEAD} Software: {software()}.\n",
            f"Not trained yet: {', '.join(absent)}.\n" if absent else "",
            "## Targets\n",
            section(targets, written),
            "## Rendered scenes (`synthetic`)\n",
            quality_section(quality),
            f"`{THRESHOLDED}`: the light-cone transform less 15 % of its maximum, which cuts its noise floor off.\n",
            f"{gallery_caption(quality.scenes)}\n\n![counts_p5](results/full.png)\n",
            "counts_p5 at 16 x 16 points, drawn alike:\n\n![counts_p5@16x16](results/sparse.png)\n",
            "Settings:\n\n" + settings(quality.rows),
            "## Kinds that no method was trained on\n",
            "Simulated with shadows, one scene a kind that is held out from training.\n",
            quality_section(held_out),
            "## What training cost\n",
            training([each for each in LEARNED if (each not in BASE or each in methods) and each not in WEIGHTS_OF]),
            say("training", ""),
            "\n## NANO against LFE and NLOST, equal samples seen\n",
            equal_samples(quality, [rival for rival in rivals if rival != "unet"]),
            say("equal", ""),
            "\n## The plain U-Net, and what it teaches\n",
            equal_samples(quality, [rival for rival in rivals if rival == "unet"]),
            say("unet", ""),
            "\n## Trained without noise\n",
            noiseless(data / "synthetic", quality),
            "## Noise level estimation\n",
            f"R² = {levels.figures['r_squared']:.4f} of photon noise, by the estimate of any kind, on "
            f"{noise_figure.SCANS} scans of held-out kinds inside the training range.\n",
            table(
                ["noise", "R²", "bias, decades", "scatter"],
                [
                    [kind, f"{fit['r_squared']:.3f}", f"{fit['bias']:+.3f}", f"{fit['scatter']:.3f}"]
                    for kind, ways in levels.figures["kinds"].items()
                    for fit in (ways[noise_figure.SHOWN],)
                ],
            ),
            "\n![noise level](results/noise_level.png)\n",
            "Both axes: log10 of the standard deviation of a bin's counts over the signal's mean peak.\n",
            table(
                ["peak counts, beyond the training range", "true level, log10", "estimated"],
                [[peak, f"{a:.2f}", f"{b:.2f}"] for peak, (a, b) in levels.figures["beyond"].items()],
            ),
            "## One set of weights on every grid\n",
            f"{studies.SCENES_A_GRID} scenes of held-out kinds, as many photons on the same wall, window and scene; on "
            "the same points the same ones, drawn in the finest bins and added up. The operator itself sees 32 points "
            "along the wall whatever the scan's grid; the 2D network at the end sees the scan's own.\n",
            studies.grid_table(grids),
            convergence_section(docs, say("convergence", "")),
            "\n## Speed and size\n",
            table(
                ["figure", "value", "target", "met"],
                [[f["figure"], f"{f['value']:g} {f['unit']}", f["target"], "yes" if f["met"] else "no"] for f in fast],
            ),
            say("machine", ""),
            "\n## Measured scenes\n",
            measured_scenes(data / "real", [m for m in PICTURED if m in methods], pictures),
        ]
    )


def main(data: Path, docs: Path) -> None:
    if not (data / "synthetic").is_dir():
        raise SystemExit(f"{data / 'synthetic'} is not there. Give the folder that holds `synthetic` and `real`.")
    made = page(data, docs)
    (docs / "results.md").write_text(made, encoding="utf-8")


if __name__ == "__main__":
    given = [Path(argument) for argument in sys.argv[1:3]]
    main(*given, *(Path("../shared/data"), Path("docs"))[len(given) :])
