"""What a scan says of itself beside its counts, by the names that the importers of plain arrays read."""

from typing import Any

import numpy as np

from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.importers.plain import DIFFUSE


def facts_of(scan: ScanArrays) -> dict[str, Any]:
    """Everything that is known, `histograms` and places included: whoever reads it has the scan as it was."""
    values: dict[str, Any] = {
        "histograms": scan.histograms,
        "exposure_s": scan.exposure_s,
        "x_m": scan.x_m,
        "y_m": scan.y_m,
        "bin_width_s": np.float64(scan.time.bin_width_s),
        "offset_s": np.float64(scan.time.start_s),
        "samples_left_aside": np.int64(scan.left_aside),
        "wall_size_m": np.array([scan.wall.width_m, scan.wall.height_m]),
        "rectified": np.uint8(scan.rectified),
    }
    if not scan.wall_known:
        values["wall_size_assumed"] = np.uint8(1)
    if scan.direct_cut_bins:
        values["direct_cut_bins"] = np.int64(scan.direct_cut_bins)
    if scan.falloff is not None:
        values["falloff_exponent_authors"] = np.int64(scan.falloff)
    if scan.time_offset_bins is not None:
        values["time_offset_bins"] = scan.time_offset_bins
    if scan.response is not None:
        values |= {"response": scan.response.shares, "response_bin_width_s": np.float64(scan.response.step_s)}
    return values


def unsaid(scan: ScanArrays, *held: str) -> list[str]:
    """What to say of facts that a format has no place for: of those that decide how a picture is made, all that are
    known and not `held`, by their names in `facts_of`."""
    fwhm_ps = 0.0 if scan.response is None else scan.response.fwhm_s * 1e12
    facts = {
        "direct_cut_bins": (
            scan.direct_cut_bins,
            f"that the first {scan.direct_cut_bins} bins hold direct light: it is written with the rest",
        ),
        "falloff_exponent_authors": (
            scan.falloff not in (None, DIFFUSE),
            f"the light's falloff: reconstruct it with --set falloff={scan.falloff}",
        ),
        "response": (scan.response is not None, f"the response: reconstruct it with --response {fwhm_ps:.4g}"),
        "time_offset_bins": (
            scan.time_offset_bins is not None and not scan.rectified,
            "when light arrives at each point (time_offset_bins): direct light has to tell it",
        ),
    }
    return [said for name, (known, said) in facts.items() if known and name not in held]
