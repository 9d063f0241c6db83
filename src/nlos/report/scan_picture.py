"""A scan before reconstruction, as a figure: where light was counted on the wall, and when."""

import numpy as np
from matplotlib.figure import Figure

from nlos.acquisition.transient import Transient
from nlos.recon.own_style import own_style


@own_style()
def scan_figure(transient: Transient) -> Figure:
    """Counts of every point over the wall, and all histograms added up over time in nanoseconds."""
    wall, time = transient.wall, transient.time
    figure = Figure(figsize=(8.4, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.35))
    extent = (-wall.width_m / 2, wall.width_m / 2, -wall.height_m / 2, wall.height_m / 2)
    counted = np.where(transient.exposure_s > 0, transient.counts.sum(0, dtype=np.float64), np.nan)
    drawn = left.imshow(counted, cmap="viridis", extent=extent, interpolation="nearest")
    figure.colorbar(drawn, ax=left, label="counts per point", shrink=0.85)
    left.set(xlabel="x / m", ylabel="y / m", title="counts over the wall")
    right.plot(time.centres_s() * 1e9, transient.counts.sum((1, 2), dtype=np.float64), color="black", linewidth=0.9)
    right.set(xlabel="time / ns", ylabel="counts per bin, all points", title="histogram of the whole scan")
    right.set_yscale("symlog", linthresh=1)
    right.set_xlim(time.start_s * 1e9, (time.start_s + time.bins * time.bin_width_s) * 1e9)
    return figure
