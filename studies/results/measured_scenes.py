"""Measured scenes: what each method sees of the full scan, of fewer points and of fewer photons."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.plain import read_plain
from nlos.acquisition.transient import Transient
from nlos.recon.methods import find
from nlos.recon.metrics import correlation
from nlos.recon.reconstruct import reconstruct
from nlos.recon.subsets import measured_points
from studies.results.kept import Kept, kept, of_files, of_method

SCENES = (
    "statue_full",
    "otoole_s_u",
    "otoole_resolution_40cm",
    "otoole_dots_65cm",
    "otoole_mannequin_directcut",
    "ahn_2019",
    "ahn_toy",
)
METHODS = ("lct", "fk", "phasor", "lfe", "nlost", "nano")
SCANS = ("full scan", "1/4 of the points", "1/16 of the points", "1/20 of the photons")
Picture = npt.NDArray[np.float32]


def scan_of(path: Path, scan: str) -> tuple[Transient, int]:
    """The measured counts behind the direct light, as many as `scan` says; and the falloff of their surfaces."""
    read = read_plain(path)
    counts = read.transient.counts.copy()
    counts[: read.direct_cut_bins] = 0
    exposure_s = read.transient.exposure_s
    if scan.endswith("points"):
        step = 2 if scan.startswith("1/4") else 4
        rows, cols = (-(-n // step) for n in exposure_s.shape)
        measured = measured_points(f"{rows}x{cols}", *exposure_s.shape)
        counts, exposure_s = counts * measured, exposure_s * measured
    elif scan.endswith("photons"):
        counts = np.random.default_rng(1).binomial(counts.astype(np.int64), 0.05).astype(np.float32)
    return replace(read.transient, counts=counts, exposure_s=exposure_s), read.falloff or 4


def pictures_of(path: Path, method: str) -> Kept:
    """Front views by scan, each over its 99.9th percentile; figures: correlation with the method's own full scan."""

    def measure(_: Path) -> tuple[dict[str, float], dict[str, Picture]]:
        seen: dict[str, Picture] = {}
        for scan in SCANS:
            transient, falloff = scan_of(path, scan)
            settings: dict[str, object] = (
                {"falloff": falloff} if "falloff" in find(method).Settings.model_fields else {}
            )
            albedo = reconstruct(transient, method, settings).albedo
            seen[scan] = np.clip(albedo / (float(np.quantile(albedo, 0.999)) or 1.0), 0, 1)
        return {scan: correlation(seen[scan], seen[SCANS[0]]) for scan in SCANS}, seen

    return kept(f"{path.stem}-{method}", of_method(method) | {"data": of_files([path])}, measure)


def draw(found: dict[str, Kept], path: Path) -> None:
    """One scene: a row a scan, a column a method."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(1.25 * len(found), 1.25 * len(SCANS) + 0.25), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0, hspace=0)  # type: ignore[union-attr, call-arg]
    grid = figure.subplots(len(SCANS), len(found), squeeze=False)
    for line, scan in zip(grid, SCANS, strict=True):
        line[0].set_ylabel(scan, fontsize=6)
        for axes, pictures in zip(line, found.values(), strict=True):
            axes.imshow(pictures.arrays[scan], cmap="gray", vmin=0, vmax=1, interpolation="nearest")
            axes.set(xticks=[], yticks=[])
    for axes, method in zip(grid[0], found, strict=True):
        axes.set_title(method, fontsize=8)
    FigureCanvasAgg(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, metadata={"Software": "nlos"})


def measured_scenes(data: Path, methods: Sequence[str], pictures: Path) -> str:
    """Draws every scene into `pictures`; returns the Markdown that shows them."""
    lines = [
        "Front views, each over its own 99.9th percentile. "
        "Light of retroreflective scenes is told to every method that can use it. Fewer points are a regular subset of "
        "the scan's own; fewer photons are its own, thinned. Numbers: correlation with the method's own full scan. "
        "That says how little a picture changes, not how right it is: a method that always blurs has a high one. "
        "NANO's is not always the highest.\n"
    ]
    for name in SCENES:
        path = data / f"{name}.h5"
        found = {method: pictures_of(path, method) for method in methods}
        draw(found, pictures / f"{name}.png")
        lines.append(f"\n**{name}**\n\n![{name}]({pictures.name}/{name}.png)\n")
        lines.append("| " + " | ".join(["", *found]) + " |\n" + "|---" * (1 + len(found)) + "|")
        for scan in SCANS[1:]:
            lines.append(
                "| " + " | ".join([scan, *(f"{pictures.figures[scan]:.2f}" for pictures in found.values())]) + " |"
            )
    return "\n".join(lines) + "\n"
