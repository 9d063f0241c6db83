"""What a scan says of itself beside its counts, by the names that the importers of plain arrays read."""

from typing import Any

import numpy as np

from nlos.acquisition.exporters.scan_arrays import ScanArrays


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
