"""Dark print on bright boards, in fonts that nobody learned from: how much of its contrast pictures keep.

`python -m studies.boards docs/boards.md` draws docs/results/boards.png beside the page. Twelve boards of two
characters each, at twelve places, slants and falloffs; 64 x 64 points of a wall of 2 m, 20 counts in a point's
brightest bin on average, 60 ps wide at most. Contrast is what print is darker than the board, over the board: of pixels
that are nine tenths print or board, two pixels from the board's edge, in the picture over the same of the truth.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.ndimage import binary_erosion

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.metrics import image_scores
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.detector import DetectorSettings, measure
from nlos.recon.training.lettering import lettering
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import OVERSAMPLING, FrontView, Scene, front_view, surfels
from nlos.recon.training.shapes import blank_canvas, panel

Picture = npt.NDArray[np.float32]

WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(256, 64e-12)
FONTS = ("cmr10", "DejaVuSerif-BoldItalic", "STIXGeneralBolIta", "DejaVuSansMono-BoldOblique", "cmti10", "DejaVuSerif")
CHARACTERS = "ABCDEFGHJKLMNPRSTUVWXYZ2345679"
SLOPES = ((0.0, 0.0), (0.27, 0.0), (0.0, -0.27), (-0.36, 0.18))
"""Depth per length across and up: 0, 15 and 22 degrees."""
INK = 0.1
"""Of the board's albedo."""
BOARDS = 12
LOOKS = 4
"""Sets of surfels that light is the mean of, so that their grain does not count."""
READ = (
    "Somebody who was shown NANO's twelve pictures in another order, and knew nothing else but that there are two "
    "characters, read all 24 right, unsure of none."
)
"""Once, of the weights and the refinement that shipped on 2026-11-28."""
SNRS = (10.0, 30.0, 100.0, 300.0, 1000.0)
LIGHT = DetectorSettings(
    peak_counts_least=20, peak_counts_most=20, noiseless=0, uniform=0, sparse=0, uneven_dwell=0,
    jitter_fwhm_most_ps=60, dark_per_peak_most=0.01, afterpulsing_most=0, pile_up=0, calibration_residue=0,
)  # fmt: skip


@dataclass(frozen=True)
class Board:
    """One board, its scan and its truth."""

    text: str
    falloff: int
    scan: Transient
    truth: FrontView
    print: npt.NDArray[np.bool_]  # (H, W), pixels of ink
    paper: npt.NDArray[np.bool_]  # (H, W), pixels of nothing but board


def board(index: int) -> Board:
    """Board `index`: the same whoever asks."""
    rng = np.random.default_rng((41, index))
    raster = WallGrid(WALL.width_m, WALL.height_m, OVERSAMPLING * WALL.rows, OVERSAMPLING * WALL.cols)
    canvas = blank_canvas(raster.rows, raster.cols)
    text = "".join(rng.choice(list(CHARACTERS), 2, replace=False))
    wide, high = rng.uniform(0.75, 0.9), rng.uniform(0.55, 0.85)
    x0, y0 = rng.uniform(-1, 1) * (1 - wide), rng.uniform(-1, 1) * (1 - high)
    half = min(0.75 * high, 0.5 * wide)
    ink = np.zeros((raster.rows, raster.cols), np.float32)
    for k, character in enumerate(text):
        at = (x0 + (k - 0.5) * 0.95 * wide, y0)
        ink = np.maximum(ink, lettering(canvas, character, FONTS[index % len(FONTS)], at, half, 0.0))
    sheet = (np.abs(canvas.x[None] - x0) < wide) & (np.abs(canvas.y[:, None] - y0) < high)
    paint = (0.8 * (1 - (1 - INK) * ink)).astype(np.float32)
    panel(canvas, sheet.astype(np.float32), rng.uniform(0.7, 1.0), SLOPES[index % len(SLOPES)], paint)
    unit = np.float32(WALL.width_m / 2)
    depth_m = np.where(canvas.coverage > 0, canvas.depth * unit, np.inf).astype(np.float32)
    scene = Scene("board", raster, depth_m, canvas.normal, canvas.albedo * (canvas.coverage > 0), canvas.coverage)
    falloff = 2 if index // 2 % 2 else 4
    looks = [render(surfels(scene, rng), WALL, TIME, retroreflective=falloff == 2).numpy() for _ in range(LOOKS)]
    made = measure(np.mean(looks, axis=0), TIME, LIGHT, rng)
    share = _blocks(ink)
    inside = binary_erosion(_blocks(sheet) == 1, iterations=2)
    scan = Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), WALL, TIME)
    return Board(text, falloff, scan, front_view(scene, WALL), inside & (share >= 0.9), inside & (share <= 0.1))


def _blocks(field: npt.NDArray[Any]) -> Picture:
    shape = (WALL.rows, OVERSAMPLING, WALL.cols, OVERSAMPLING)
    return np.asarray(field.reshape(shape).mean(axis=(1, 3)), dtype=np.float32)


def contrast(picture: npt.NDArray[np.floating], seen: Board) -> float:
    """What print is darker than the board around it, over the board."""
    paper = float(picture[seen.paper].mean())
    return (paper - float(picture[seen.print].mean())) / max(paper, 1e-12)


def pictures(seen: Board) -> dict[str, Picture]:
    """By each method: told the falloff, but for `nano, not told`."""
    told = {"falloff": seen.falloff}
    made = {"nano": reconstruct(seen.scan, "nano", told).albedo}
    made["nano, not told"] = reconstruct(seen.scan, "nano").albedo
    tries = [reconstruct(seen.scan, "lct", told | {"snr": snr}).albedo for snr in SNRS]
    made["lct"] = max(tries, key=lambda each: image_scores(each, seen.truth.intensity)["psnr"])
    made["phasor"] = reconstruct(seen.scan, "phasor", told).albedo
    return made


def main(page: Path) -> None:
    drawing = Figure(figsize=(12.6, 11), layout="constrained")
    FigureCanvasAgg(drawing)
    grid = drawing.subplots(BOARDS // 2, 10, squeeze=False)
    lines, kept = [], []
    for index in range(BOARDS):
        seen = board(index)
        made = pictures(seen)
        of_truth = contrast(seen.truth.intensity, seen)
        shares = {name: contrast(picture, seen) / of_truth for name, picture in made.items()}
        kept.append(shares)
        if index == 0:
            names = list(made)
        slant = np.degrees(np.arctan(np.hypot(*SLOPES[index % len(SLOPES)])))
        lines.append(
            f"| {index} | {FONTS[index % len(FONTS)]} | {slant:.0f} | {seen.falloff} | "
            + " | ".join(f"{shares[name]:.2f}" for name in names)
            + f" | {image_scores(made['nano'], seen.truth.intensity)['psnr']:.1f} |"
        )
        print(lines[-1], flush=True)
        row = grid[index // 2][5 * (index % 2) :]
        for axes, (name, shown) in zip(row, {"truth": seen.truth.intensity, **made}.items(), strict=False):
            axes.imshow(shown / max(float(np.quantile(shown, 0.999)), 1e-12), cmap="gray", vmin=0, vmax=1)
            axes.set_title(f"{index}" if name == "truth" else name, fontsize=7)
            axes.set(xticks=[], yticks=[])
    means = [float(np.mean([each[name] for each in kept])) for name in names]
    least = [min(each[name] for each in kept) for name in names]
    drawing.savefig(page.parent / "results" / "boards.png", dpi=90, metadata={"Software": "nlos"})
    head = "| board | font | slant, degrees | falloff | " + " | ".join(names) + " | nano, dB |"
    assert __doc__ is not None
    page.write_text(
        "# Print on boards\n\nMade by `python -m studies.boards docs/boards.md`. "
        + __doc__.split("\n\n", 1)[1].split("the page. ", 1)[1].replace("\n", " ").strip()
        + "\n\nShares of the truth's contrast; every method is told the falloff but for `nano, not told`, and LCT has "
        "its best of five snr.\n\n" + head + "\n" + "| --- " * (5 + len(names)) + "|\n" + "\n".join(lines)
        + "\n| mean | | | | " + " | ".join(f"{mean:.2f}" for mean in means)
        + " | |\n| least | | | | " + " | ".join(f"{each:.2f}" for each in least)
        + f" | |\n\n{READ}\n\n![boards](results/boards.png)\n",
        encoding="utf-8",
    )  # fmt: skip


if __name__ == "__main__":
    main(Path(sys.argv[1]))
