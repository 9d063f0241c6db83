"""The wall with spots, scan area and scanner: where spots were measured, where the fit has them, how far apart."""

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.recon.own_style import own_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nlos.calibration.geometry_fit import GeometryFit, Spots
    from nlos.drivers.bench_settings import AllowedArea

Floats = npt.NDArray[np.float64]
_ARROW_PART = 0.15
"""Of the wall's width: what the longest residual is drawn as."""


@own_style()
def draw_spots(
    fit: "GeometryFit",
    spots: "Spots",
    scanned: tuple[Floats, Floats] | None = None,
    allowed: "AllowedArea | None" = None,
) -> "Figure":
    """`scanned`: the points (x_m, y_m) of a scan; `allowed`: where the bench file lets the beam go."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5.5), layout="constrained")
    wall, residuals = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_wall(wall, fit, spots, scanned, allowed)
    used = fit.spots_accepted
    off_mm = fit.spot_residual_m[used] * 1e3
    residuals.axhline(0, color="0.8", zorder=0)
    residuals.axvline(0, color="0.8", zorder=0)
    residuals.scatter(off_mm[:, 0], off_mm[:, 1], s=18, color="tab:red")
    reach = max(float(np.abs(off_mm).max(initial=0)) * 1.2, 0.5)
    aside = f"; {(~used).sum()} excluded" if not used.all() else ""
    residuals.set(
        xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="x, measured less fitted (mm)",
        ylabel="y (mm)", title=f"{len(off_mm)} spots, {fit.spots_rms_m * 1e3:.2f} mm RMS off the fit{aside}",
    )  # fmt: skip
    return figure


def _draw_wall(
    panel: Any, fit: "GeometryFit", spots: "Spots", scanned: tuple[Floats, Floats] | None, allowed: "AllowedArea | None"
) -> None:
    geometry, off_m = fit.geometry, fit.spot_residual_m
    x_m, y_m = spots.x_m - off_m[:, 0], spots.y_m - off_m[:, 1]
    used = fit.spots_accepted
    width_m = max(float(np.ptp(spots.x_m[used])), float(np.ptp(spots.y_m[used])), 0.1)
    longest_m = float(np.hypot(*off_m[used].T).max(initial=0)) or 1e-6
    times = _ARROW_PART * width_m / longest_m
    if scanned is not None:
        left, right, bottom, top = scanned[0].min(), scanned[0].max(), scanned[1].min(), scanned[1].max()
        box = ([left, right, right, left, left], [bottom, bottom, top, top, bottom])
        panel.fill(*box, color="tab:blue", alpha=0.10)
        panel.plot(*box, color="tab:blue", lw=1, label="scan area")
    if allowed is not None:
        left, right, bottom, top = allowed.left_m, allowed.right_m, allowed.bottom_m, allowed.top_m
        panel.plot([left, right, right, left, left], [bottom, bottom, top, top, bottom], "--", color="tab:green",
                   lw=1, label="allowed")  # fmt: skip
    panel.plot([0], [0], "+", color="0.4", ms=12, label="wall's centre")
    panel.plot([geometry.scanner_x_m], [geometry.scanner_y_m], "D", color="k", ms=6,
               label=f"scanner, {geometry.wall_distance_m:.3f} m before the wall")  # fmt: skip
    panel.plot(x_m, y_m, "o", mfc="none", color="tab:blue", label="fitted")
    panel.plot(spots.x_m[used], spots.y_m[used], "x", color="tab:red", label="measured")
    if not used.all():
        panel.plot(x_m[~used], y_m[~used], "s", mfc="none", ms=11, color="tab:red", label="excluded")
    panel.quiver(x_m[used], y_m[used], *(off_m[used] * times).T, angles="xy", scale_units="xy", scale=1,
                 color="tab:red", width=0.004)  # fmt: skip
    panel.set(
        aspect="equal", xlabel="x (m)", ylabel="y (m)", title=f"the wall; residuals drawn {times:.0f} times as long"
    )
    panel.margins(0.12)
    panel.legend(loc="upper left", bbox_to_anchor=(0, -0.12), ncols=3, fontsize=8, frameon=False)
