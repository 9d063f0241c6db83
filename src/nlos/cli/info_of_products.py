"""`nlos info` of what this program makes beside recordings: a bench's constants and reconstructions."""

from pathlib import Path
from typing import Any

import numpy as np

from nlos.acquisition.digits import plus_minus
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.isolated import check_isolated
from nlos.calibration.constants import load
from nlos.recon.results import read_reconstruction


def of_product(path: Path) -> dict[str, Any] | None:
    """What an HDF5 file of our own holds; None where it is neither constants nor a reconstruction.

    A child reads it first, as every file: a damaged one stops nobody.
    """
    for reader, describe in (
        ("nlos.calibration.constants:load", _of_constants),
        ("nlos.recon.results:read_reconstruction", _of_result),
    ):
        try:
            check_isolated(path, reader)
        except InvalidData:
            continue
        return describe(path)
    return None


def _of_constants(path: Path) -> dict[str, Any]:
    held = load(path)
    summary = held.summary()
    found: dict[str, Any] = {
        "format": "constants",
        "bench": summary["bench"] or "not stored",
        "measured": summary["measured_utc"],
        "devices": summary["devices"],
        "sources": summary["sources"],
        "bin width": f"{held.bin_width_s * 1e12:g} ps",
    }
    if held.arrivals is not None:
        rms_ps = held.arrivals.rms_s * 1e12
        found["arrivals"] = f"{len(held.arrivals.x_m)} points, {rms_ps:.1f} ps RMS about the wall's fit"
    if held.response is not None:
        found["response"] = f"{held.response.fwhm_s() * 1e12:.0f} ps FWHM"
    for name, quantity in summary.items():
        if isinstance(quantity, dict) and "value" in quantity:
            found[name] = plus_minus(quantity["value"], quantity["error"])
    if held.warnings:
        found["warnings"] = list(held.warnings)
    found["not measured"] = [name for name, value in summary.items() if value is None]
    return found


def _of_result(path: Path) -> dict[str, Any]:
    held = read_reconstruction(path)
    rows, cols = held.albedo.shape
    depths, middle = "nothing seen", held.middle_depths_m()
    if middle is not None:
        share = np.isfinite(held.depth_m).mean()
        depths = f"{middle[0]:.3f} to {middle[1]:.3f} m over {share:.0%} of the pixels"
    volume = held.volume
    return {
        "format": "reconstruction",
        "scan": held.scan or "not stored",
        **({} if held.frame is None else {"frame": held.frame}),
        "method": held.method,
        "settings": held.settings,
        "seconds": held.seconds,
        "points": held.points or "not stored",
        "photons": held.photons or "not stored",
        "picture": f"{rows} x {cols} on {held.wall.width_m:g} x {held.wall.height_m:g} m",
        "depths": depths,
        "volume": "none" if volume is None else f"{len(volume.depths_m)} planes to {volume.depths_m[-1]:.3f} m",
        "weights": held.weights_sha256 or "none",
        "skipped samples": held.left_aside,
        "explained": "not computed" if held.explained is None else str(held.explained),
    }
