"""MATLAB v5: every array of a scan under its own name."""

from pathlib import Path

from scipy.io import savemat

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.scan_arrays import ScanArrays

_MAX_BYTES = (1 << 31) - 1


def write_matlab(scan: ScanArrays, path: Path) -> list[str]:
    """Writes the arrays that `write_npz` writes, and `wall_size_m`. Returns what the format cannot hold.

    Raises `InvalidData` above 2 GiB, which the format cannot hold.
    """
    if scan.histograms.nbytes > _MAX_BYTES:
        raise InvalidData(
            f"{path}: {scan.histograms.nbytes / 2**30:.1f} GiB of histograms; MATLAB v5 holds 2 GiB. Export npz."
        )
    values = {
        "histograms": scan.histograms,
        "exposure_s": scan.exposure_s,
        "x_m": scan.x_m,
        "y_m": scan.y_m,
        "bin_width_s": scan.time.bin_width_s,
        "offset_s": scan.time.start_s,
        "samples_left_aside": scan.left_aside,
        "wall_size_m": [scan.wall.width_m, scan.wall.height_m],
    }
    savemat(str(path), values, appendmat=False, do_compression=True)
    return ["the event log, the settings and the devices stay in the recording"]
