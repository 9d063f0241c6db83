"""The picture that the README opens with: measured scenes by LCT and NANO, all points and a sixteenth of them.

`python -m studies.opening_picture ../shared/data docs/nano.png`
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

import nlos

SCENES = {"otoole_s_u": "S and U", "otoole_resolution_40cm": "chart", "statue_full": "statue"}
SIDE = 16


def pictures(path: Path) -> list[nlos.Picture]:
    """LCT and NANO from all points of a scan, then both from 16 x 16 of them."""
    scan = nlos.load(path)
    rows, cols = scan.exposure_s.shape
    measured = np.zeros((rows, cols))
    at = [((np.arange(SIDE) + 0.5) * count / SIDE).astype(int) for count in (rows, cols)]
    measured[np.ix_(*at)] = 1
    counts = np.maximum(np.moveaxis(scan.calibrated().counts, 0, 2), 0) * measured[..., None]
    few = [
        nlos.reconstruct(
            counts, method, wall=scan.wall_m, bin_width=scan.bin_width_s, exposure=measured, axes="YXT",
            falloff=scan.falloff or 4,
        )
        for method in ("lct", "nano")
    ]  # fmt: skip
    return [nlos.reconstruct(scan, "lct"), nlos.reconstruct(scan, "nano"), *few]


def half_m(centres_m: NDArray[np.float64]) -> float:
    """From the middle to the edge of evenly spaced pixels."""
    return float(np.ptp(centres_m)) / 2 * len(centres_m) / max(len(centres_m) - 1, 1)


def draw(data: Path, target: Path) -> None:
    """Writes the figure."""
    figure = Figure(figsize=(9.2, 7.3), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    figure.get_layout_engine().set(rect=(0, 0.015, 1, 0.98))  # type: ignore[union-attr, call-arg]
    panels = figure.subplots(len(SCENES), 4)
    titles = ("LCT, all points", "NANO, all points", "LCT, 16 x 16 points", "NANO, 16 x 16 points")
    for line, (name, label) in zip(panels, SCENES.items(), strict=True):
        for panel, picture in zip(line, pictures(data / "real" / f"{name}.h5"), strict=True):
            top = float(np.quantile(picture.albedo, 0.999)) or 1.0
            x, y = (half_m(each) for each in (picture.x_m, picture.y_m))
            panel.imshow(picture.albedo / top, cmap="gray", vmin=0, vmax=1, extent=(-x, x, -y, y))
            panel.set_xticks([-x, 0, x], [f"{-x:.2g}", "0", f"{x:.2g}"], fontsize=8)
            panel.set_yticks([-y, 0, y], [f"{-y:.2g}", "0", f"{y:.2g}"] if panel is line[0] else [], fontsize=8)
        line[0].set_ylabel(f"{label}\ny (m)")
    for panel in panels[-1]:
        panel.set_xlabel("x (m)", fontsize=8)
    for panel, title in zip(panels[0], titles, strict=True):
        panel.set_title(title, fontsize=10)
    figure.savefig(target, dpi=80)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
