"""Pictures of plans: the mirror's path over the wall, coloured by time, beside the dwell of every point."""

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from nlos.recon.own_style import own_style
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan


@own_style()
def path_picture(plan: "ScanPlan", path: Path, *, new: bool = False) -> None:
    """Writes a PNG: where the beam goes and when, and how long it stays; a `new` one as `whole_file` does."""
    figure = Figure(figsize=(11, 4.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    x_m, y_m = plan.positions.x_m, plan.positions.y_m
    begun_s = np.concatenate([[0.0], np.cumsum(plan.dwell_s)[:-1]])
    size = max(1.0, min(30.0, 6000.0 / len(plan)))
    left.plot(x_m, y_m, color="0.8", linewidth=0.5, zorder=0)
    shown = left.scatter(x_m, y_m, c=begun_s, s=size, cmap="viridis")
    figure.colorbar(shown, ax=left, label="gate time when the point begins (s)")
    left.set_title("path")
    shown = right.scatter(x_m, y_m, c=plan.dwell_s * 1e3, s=size, cmap="magma")
    figure.colorbar(shown, ax=right, label="dwell (ms)")
    right.set_title("dwell")
    for axes in (left, right):
        axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal",
                 xlim=(-plan.wall.width_m / 2, plan.wall.width_m / 2),
                 ylim=(-plan.wall.height_m / 2, plan.wall.height_m / 2))  # fmt: skip
    drawn = io.BytesIO()  # of a full disk matplotlib's own writer of pdf tells as of an error in itself
    figure.savefig(drawn, dpi=120, format=path.suffix[1:] or "png")
    with whole_file(path, new=new) as partial:
        partial.write_bytes(drawn.getbuffer())
