"""What a report says of a scan's calibration: residuals with their errors, in picoseconds and millimetres."""

from html import escape
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.acquisition.digits import plus_minus
from nlos.calibration.correct import CorrectedPoints
from nlos.chain import calibrate_scan
from nlos.recon.own_style import own_style
from nlos.report.html import number, picture, table
from nlos.response import say_response

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.loaded import LoadedScan

_FOUND = {
    "points_without_direct_peak": "Points without a direct peak",
    "points_off_the_wall_fit": "Points off the fit of the wall",
    "offset_rms_ps": "Time offsets about that fit, RMS (ps)",
    "offset_rms_mm": "The same as a distance (mm)",
    "scanner_position_m": "Scanner, from the wall's centre, along the wall's own axes: x, y, z (mm)",
    "electronic_delay_ns": "Delay of cables and electronics for that place (ns)",
    "response_fwhm_ps": "Impulse response, FWHM (ps)",
    "direct_masked_ns": "Direct light masked for (ns)",
    "direct_tail_ps": "Its tail decays in (ps)",
    "background_per_bin": "Background (counts per bin)",
}
"""What a calibration reports -> how the page calls it."""


def calibrated(scan: "LoadedScan", constants: "BenchConstants | None") -> tuple["Transient", str, str]:
    """What `reconstruct` would work on, a sentence on how well it was calibrated, and the section about it."""
    title = "<h2>Calibration</h2>"
    found: list[CorrectedPoints] = []
    transient = calibrate_scan(scan, constants=constants, hear=found.append)
    say_response(transient)
    if scan.rectified:
        return transient, "", f"{title}<p>The source of this recording was rectified already.</p>"
    by = "the scan's own direct light"
    if constants is not None:
        by += f", and constants of the bench measured {constants.measured_utc}"
    if scan.points is not None:
        return transient, "", f"{title}<p>By {escape(by)}.</p>"
    return transient, _sentence(found[0]), f"{title}<p>By {escape(by)}.</p>{_residuals(found[0], transient)}"


def _sentence(corrected: CorrectedPoints) -> str:
    found = corrected.report()
    rms_ps, rms_mm, fwhm_ps = (found.get(key) for key in ("offset_rms_ps", "offset_rms_mm", "response_fwhm_ps"))
    if not (isinstance(rms_ps, float) and isinstance(rms_mm, float)):
        return "No plane wall explains the arrival times; every point was aligned by its own direct light."
    width = f", with a response {fwhm_ps:.0f} ps wide" if isinstance(fwhm_ps, float) else ""
    return f"Arrival times fit a plane wall to {rms_ps:.1f} ps RMS ({rms_mm:.2f} mm){width}."


@own_style()
def _residuals(corrected: CorrectedPoints, transient: "Transient") -> str:
    from matplotlib.figure import Figure

    found = corrected.report()
    rows = _figures(corrected)
    offsets = corrected.offsets
    if offsets is None:
        return table(rows)
    wall, width_ps = transient.wall, transient.time.bin_width_s * 1e12
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    left, right = figure.subplots(1, 2)
    shape = (wall.rows, wall.cols)
    _map(figure, left, offsets.offset_bins.reshape(shape) * width_ps, "Time offset (ps)", wall.width_m, wall.height_m)
    if offsets.wall is not None:
        residual_ps = offsets.residual_bins.reshape(shape) * width_ps
        rms_mm = found["offset_rms_mm"]
        assert isinstance(rms_mm, float)
        title = f"What the wall's fit leaves (ps): {rms_mm:.2f} mm RMS"
        _map(figure, right, residual_ps, title, wall.width_m, wall.height_m)
    return table(rows) + picture(figure, "time offset of every point, and what the wall fit leaves")


def _figures(corrected: CorrectedPoints) -> dict[str, str]:
    """Name and value with its error, to the digits that it has."""
    found, offsets = corrected.report(), corrected.offsets
    rows = {label: number(found[key]) for key, label in _FOUND.items() if found.get(key) is not None}
    wall = None if offsets is None else offsets.wall
    if wall is not None:
        error = np.sqrt(wall.covariance.diagonal())
        (x, y, z), (dx, dy, dz) = wall.scanner_position_m, error[:3]
        rows[_FOUND["scanner_position_m"]] = ", ".join(
            _with_error(1e3 * at_m, 1e3 * error_m) for at_m, error_m in ((x, dx), (y, dy), (z, dz))
        )
        rows[_FOUND["electronic_delay_ns"]] = _with_error(wall.delay_s * 1e9, float(error[3]) * 1e9)
    return rows


def _with_error(value: float, error: float) -> str:
    return plus_minus(value, error).replace("+-", "±")


def _map(
    figure: "Figure", axes: object, values: npt.NDArray[np.float64], title: str, width_m: float, height_m: float
) -> None:
    extent = (-width_m / 2, width_m / 2, -height_m / 2, height_m / 2)
    picture = axes.imshow(values, extent=extent)  # type: ignore[attr-defined]
    axes.set(title=title, xlabel="x (m)", ylabel="y (m)")  # type: ignore[attr-defined]
    figure.colorbar(picture, ax=axes)  # type: ignore[arg-type]
