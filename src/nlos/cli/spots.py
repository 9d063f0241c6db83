"""`nlos calibrate --spots FILE` without a scan: where the scanner stands, for the bench file."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.planning.preflight import drawn_aim
from nlos.beam_seen import keep_beam_seen
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import Spots
from nlos.calibration.spots_fit import PlacedScanner, place_from_spots
from nlos.calibration_input import read_spots
from nlos.cli.bench_files import check_bench_output, write_bench_file
from nlos.cli.benches import load_bench
from nlos.cli.terminal import terminal
from nlos.first_light.bench_lines import with_keys
from nlos.recon.png import refuse_to_replace_another, write_png
from nlos.report.spots_picture import draw_spots
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.calibration.geometry_fit import GeometryFit

NAMES = {
    "scanner_x_m": ("the scanner's x", 1.0, "m", "scanner_x_m"),
    "scanner_y_m": ("the scanner's y", 1.0, "m", "scanner_y_m"),
    "wall_distance_m": ("the wall's distance", 1.0, "m", "wall_distance_m"),
    "wall_pitch_rad": ("the wall's pitch", math.degrees(1.0), "deg", "wall_pitch_deg"),
    "wall_yaw_rad": ("the wall's yaw", math.degrees(1.0), "deg", "wall_yaw_deg"),
    "x_offset_rad": ("x offset", math.degrees(1.0), "deg", ""),
    "y_offset_rad": ("y offset", math.degrees(1.0), "deg", ""),
    "x_gain": ("x gain", 1.0, "", ""),
    "y_gain": ("y gain", 1.0, "", ""),
}
"""Parameter -> what it is called, in which unit it is printed, and its key in a bench file's geometry."""


def place_scanner(spots: Path, ruler_m: float, bench: str | None, output: Path | None, overwrite: bool) -> None:
    """Fits, says what was found and what these spots cannot tell, draws it, and writes the bench file to `output`."""
    check_bench_output(output, overwrite, "spots without a RUN write")
    picture = spots.with_suffix(".png")
    refuse_to_replace_another(picture, overwrite)
    table, measured = load_bench(bench), read_spots(spots, ruler_m)
    found = place_from_spots(measured, ScannerGeometry(**vars(drawn_aim(table.settings.geometry))))
    _tell(found, measured)
    kept = found.fit.spots_accepted
    used = Spots(measured.x_rad[kept], measured.y_rad[kept], measured.x_m[kept], measured.y_m[kept])
    keep_beam_seen(table.settings, "calibrate --spots", used)
    with whole_file(picture) as partial:
        write_png(draw_spots(found.fit, measured, allowed=table.settings.geometry.allowed), partial, 110)
    terminal.result(f"{picture}: wall, spots, residuals", picture=str(picture))
    keys = {
        key: f"{round(getattr(found.fit.geometry, name) * scale, 4) + 0.0:.4f}"
        for name, (_, scale, _, key) in NAMES.items()
        if key and name in found.fit.errors
    }
    terminal.result("the bench file's lines, in geometry:\n" + "\n".join(f"  {key}: {v}" for key, v in keys.items()))
    write_bench_file(with_keys(table.text, "geometry", keys), table, output, overwrite)


def fitted_lines(fit: "GeometryFit") -> list[tuple[str, dict[str, object]]]:
    """Every fitted parameter with its error, in the units that people read."""
    lines: list[tuple[str, dict[str, object]]] = []
    for name, (called, scale, unit, _) in NAMES.items():
        if name in fit.errors:
            value, error = getattr(fit.geometry, name) * scale, fit.errors[name] * scale
            lines.append((f"{called:<20} {value:+.4f} +- {error:.4f} {unit}".rstrip(), {}))
    return lines


def undetermined_line(name: str, value: float, error: float, told: str = "these spots") -> str:
    """What the spots leave open, or what else was to tell it."""
    called, scale, unit, _ = NAMES[name]
    said = "" if not math.isfinite(error) else f" ({value * scale:+.2f} +- {error * scale:.2f} {unit})"
    return f"{called}: {told} do not determine it{said}"


def spots_line(fit: "GeometryFit", spots: Spots) -> str:
    """How well the spots fit, beside how well they were read."""
    used, rms_mm, ruler_mm = int(fit.spots_accepted.sum()), fit.spots_rms_m * 1e3, spots.error_m * 1e3
    words = f"{used} spots, {rms_mm:.2f} mm RMS off the fit"
    if rms_mm > 1.5 * ruler_mm:
        return f"{words}, more than a ruler good to {ruler_mm:g} mm explains: the errors are as much larger"
    return f"{words}; errors for a ruler good to {ruler_mm:g} mm (--ruler-mm)"


def aside_lines(fit: "GeometryFit", spots: Spots) -> list[str]:
    """One for each spot that the others contradict."""
    lines = []
    for row in np.flatnonzero(~fit.spots_accepted):
        off_mm = fit.spot_residual_m[row] * 1e3
        lines.append(
            f"{spots.name(int(row))}: excluded, {off_mm[0]:+.0f} mm in x and {off_mm[1]:+.0f} mm in y from where the "
            "other spots put it; correct it, or mark it again"
        )
    return lines


def _tell(found: "PlacedScanner", spots: Spots) -> None:
    for line, values in fitted_lines(found.fit):
        terminal.result(line, **values)
    said = aside_lines(found.fit, spots)
    said += [
        f"{undetermined_line(name, value, error)}; kept as the bench file has it"
        for name, (value, error) in found.undetermined.items()
    ]
    for warning in said:
        terminal.log(f"warning: {warning}")
    terminal.result(
        f"{spots_line(found.fit, spots)}; all of this is told by the spots alone, for mirrors that turn by as much as "
        "they are told: gains, offsets and delay need direct light as well, a RUN given with the spots",
        spots_rms_mm=found.fit.spots_rms_m * 1e3, geometry=vars(found.fit.geometry),
        geometry_errors=dict(found.fit.errors), undetermined=sorted(found.undetermined), warnings=said,
    )  # fmt: skip
