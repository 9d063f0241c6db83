"""NANO and rivals on scenes that chose nothing here: other people's models, rendered by other people's code.

`python -m studies.fresh_scenes DIR docs/fresh-scenes.md` takes DIR/*.npz of `rendered_by_mitransient.py`, draws counts
as those of the shared renderings are drawn, keeps the scenes in DIR/fresh, and draws docs/results/fresh.png beside the
page. Resumes from what is measured already, in runs/results.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from studies.machine import machine
from studies.paired import difference, of_scenes
from studies.results.quality import CONDITIONS, draw_gallery, measure_quality
from studies.results.tables import at_a_glance, by_scene, margins, table

COUNTS = (20, 5, 1)
BACKGROUND = 0.02
"""Of the mean peak, in every bin."""
SEED = 9000
METHODS = ("lct", "fk", "phasor", "lfe_4000", "nlost_4000", "unet_4000", "nano")
SHOWN = ("lct", "phasor", "nano")
TWO_BOUNCES = "room_two_bounces"


def kept_as_scene(rendered: Path, folder: Path) -> Path:
    """The file that `nlos evaluate` reads, with counts drawn; one that is there already stays."""
    target = folder / f"{rendered.stem}.h5"
    if target.exists():
        return target
    folder.mkdir(parents=True, exist_ok=True)
    partial = target.with_suffix(".partial")
    with np.load(rendered) as arrays, h5py.File(partial, "w") as file:
        light = arrays["transient"].astype(np.float64)
        file.attrs.update(bin_width_s=32e-12, wall_size_m=[2.0, 2.0], rectified=True, renderer="mitransient 1.3.1")
        for name in arrays.files:
            file.create_dataset(name, data=arrays[name], compression="gzip")
        for place, peak in enumerate(COUNTS):
            expected = light * (peak / light.max(axis=2).mean()) + BACKGROUND * peak
            drawn = np.random.default_rng(SEED + place).poisson(expected)
            file.create_dataset(f"counts_p{peak}", data=drawn.astype(np.uint16), compression="gzip")
    partial.replace(target)
    return target


def page(folder: Path, picture: Path) -> str:
    quality = measure_quality(folder, METHODS, CONDITIONS)
    draw_gallery(quality, SHOWN, ["counts_p20"], picture)
    names = [scene.name for scene in quality.scenes]
    return (
        "# Fresh scenes\n\n"
        f"{len(names)} scenes that nothing here was trained, chosen or tuned on: models that others made, rendered by\n"
        "mitransient 1.3.1 with shadows, and a truth by Mitsuba 3; 64 x 64 points, 512 bins of 32 ps, a wall of 2 m.\n"
        "Weights and code were those before them; no scene was turned or taken out after a picture was made of it.\n"
        "[Peers](peers.md) says what it takes to make them again.\n\n"
        "The seven scenes of the [results](results.md) helped to choose designs: margins there are higher, of print\n"
        "and thin things above all. Two here are no plain scenes: `glossy` has a sheen that no method knows of, and\n"
        f"`{TWO_BOUNCES}` is `room` with light that went between the doll and the plate behind it as well, 40\n"
        "points of it with a bin that the renderer drew five to 27 times too bright.\n\n"
        f"![Front views and depths of 20 counts](results/{picture.name})\n\n"
        f"{at_a_glance(quality.rows)}\n"
        f"{margins(quality.rows)}\n"
        "NANO less the light-cone transform at its best snr, and the error over scenes:\n\n"
        f"{paired(quality.rows, names)}\n"
        f"{by_scene(quality.rows, 'counts_p20')}\n"
        f"{by_scene(quality.rows, 'counts_p5@16x16')}\n"
        "How often intervals held, `nano`, mean over scenes:\n\n"
        f"{intervals(quality.rows)}\n"
        f"Measured on {machine()}.\n"
    )


def paired(rows: Sequence[dict[str, Any]], scenes: Sequence[str]) -> str:
    """PSNR, SSIM and depth MAD of `nano` less those of `lct`, one line a figure."""

    def line(figure: str, condition: str, factor: float) -> str:
        own, rival = (factor * of_scenes(rows, scenes, method, condition, figure) for method in ("nano", "lct"))
        return str(difference(own, rival))

    figures = (("PSNR, dB", "psnr", 1.0), ("SSIM", "ssim", 1.0), ("depth MAD, mm", "depth_mad_m", 1e3))
    return table(["", *CONDITIONS], [[head, *(line(key, c, k) for c in CONDITIONS)] for head, key, k in figures])


def intervals(rows: Sequence[dict[str, Any]]) -> str:
    """Shares of nine tenths' intervals that hold the truth, of brightness and depth."""

    def share(figure: str, condition: str) -> str:
        held = [r[figure] for r in rows if (r["method"], r["condition"]) == ("nano", condition)]
        return f"{np.mean(held):.2f}"

    figures = (("brightness", "albedo_coverage"), ("depth", "depth_coverage"))
    return table(["", *CONDITIONS], [[head, *(share(key, c) for c in CONDITIONS)] for head, key in figures])


def main(folder: Path, target: Path) -> None:
    for rendered in sorted(folder.glob("*.npz")):
        kept_as_scene(rendered, folder / "fresh")
    target.write_text(page(folder / "fresh", target.parent / "results/fresh.png"), encoding="utf-8")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
