"""Whether a scan is like those that weights were trained on: what of it lies outside their range.

Networks here take lengths in wall widths, so a wall of another size is no matter: bins and response are compared by it.
Weights that ship are judged far beyond the grid that they were trained on (docs/results.md), and are not looked at.
"""

from typing import Any

import numpy as np

from nlos.acquisition.transient import Transient
from nlos.recon.weights.files import OWN_FOLDER, STUDIES, WeightsError, find_weights, read_about

NEAR = 1.25
"""A bin or a response that differs by this factor is still what was trained on."""
PHOTONS_NEAR = 2.0
"""So many times fewer or more photons, too."""


def outside_range(name: object, transient: Transient, falloff: float | None = None) -> str:
    """What of `transient` the weights `name` have never seen the like of, in a sentence; empty where nothing is, or
    where they do not say. `falloff`: 2 where surfaces are retroreflective."""
    if not isinstance(name, str):
        return ""
    try:
        path = find_weights(name)
        about = read_about(path)
    except WeightsError:
        return ""  # said where they are used
    trained = about.get("settings", {})
    data = trained.get("data") if isinstance(trained, dict) else None
    if path.parent in (OWN_FOLDER, STUDIES) or not isinstance(data, dict):
        return ""
    try:
        found = [*_grid(transient, data, bool(trained.get("pooled_share"))), *_light(transient, data, falloff)]
    except (KeyError, TypeError, ValueError):
        return ""  # written by hand, or by a version that said less
    if not found:
        return ""
    return (
        f"{path}: this scan is not like those that the weights were trained on: {'; '.join(found)}. `nlos evaluate` "
        "can tell how good they are there."
    )


def _grid(transient: Transient, data: dict[str, Any], halves: bool) -> list[str]:
    wall, time, found = transient.wall, transient.time, []
    grids = [(data["rows"], data["cols"])] + ([(data["rows"] // 2, data["cols"] // 2)] if halves else [])
    if (wall.rows, wall.cols) not in grids:
        seen = " and ".join(f"{rows} x {cols}" for rows, cols in grids)
        found.append(f"{wall.rows} x {wall.cols} points, trained on {seen}")
    own_ps = data["bin_width_ps"] * wall.width_m / data["wall_width_m"]
    here_ps = time.bin_width_s * 1e12
    if not 1 / NEAR <= here_ps / own_ps <= NEAR:
        found.append(
            f"bins of {here_ps:g} ps on {wall.width_m:g} m, trained on {data['bin_width_ps']:g} ps on "
            f"{data['wall_width_m']:g} m"
        )
    return found


def _light(transient: Transient, data: dict[str, Any], falloff: float | None) -> list[str]:
    found = []
    detector = data.get("detector", {})
    response, scale = transient.response, transient.wall.width_m / data["wall_width_m"]
    widest_ps = detector.get("slow_fwhm_most_ps") if detector.get("slow") else detector.get("jitter_fwhm_most_ps")
    if response is not None and widest_ps and not data.get("impulse_responses"):
        fwhm_ps = response.fwhm_s * 1e12
        if fwhm_ps > NEAR * scale * widest_ps:
            found.append(
                f"a response of {fwhm_ps:.0f} ps on {transient.wall.width_m:g} m, trained on up to {widest_ps:g} ps on "
                f"{data['wall_width_m']:g} m"
            )
    measured = transient.counts[:, transient.exposure_s > 0]
    if measured.size and "peak_counts_least" in detector and (measured == np.rint(measured)).all():
        peak = float(measured.max(axis=0).mean())
        least, most = detector["peak_counts_least"], detector["peak_counts_most"]
        if peak < least / PHOTONS_NEAR or (peak > most * PHOTONS_NEAR and not detector.get("noiseless")):
            found.append(f"{peak:.2g} counts at the peak, trained on {least:g} to {most:g}")
    if falloff is not None and (falloff == 2) != bool(data.get("retroreflective")):
        kinds = ("retroreflective", "diffuse") if falloff == 2 else ("diffuse", "retroreflective")
        found.append(f"{kinds[0]} surfaces, trained on {kinds[1]} ones")
    return found
