"""NPZ: every array of a scan under its own name, and nothing lost."""

from pathlib import Path

import numpy as np

from nlos.acquisition.exporters.scan_arrays import ScanArrays


def write_npz(scan: ScanArrays, path: Path) -> list[str]:
    """Writes `histograms`, `exposure_s`, `x_m`, `y_m`, `bin_width_s`, `offset_s` and `samples_left_aside`.

    Returns what the format cannot hold."""
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            histograms=scan.histograms,
            exposure_s=scan.exposure_s,
            x_m=scan.x_m,
            y_m=scan.y_m,
            bin_width_s=np.float64(scan.time.bin_width_s),
            offset_s=np.float64(scan.time.start_s),
            samples_left_aside=np.int64(scan.left_aside),
        )
    return ["the event log, the settings and the devices stay in the recording"]
