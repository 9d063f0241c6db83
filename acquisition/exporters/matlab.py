"""MATLAB v5: every array of a scan under its own name."""

from pathlib import Path

import scipy

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.scan_facts import facts_of

_MAX_BYTES = (1 << 31) - 1


def write_matlab(scan: ScanArrays, path: Path) -> list[str]:
    """Writes the arrays that `write_npz` writes. Returns what the format cannot hold.

    Raises `InvalidData` above 2 GiB, which the format cannot hold.
    """
    if scan.histograms.nbytes > _MAX_BYTES:
        raise InvalidData(
            f"{path}: {scan.histograms.nbytes / 2**30:.1f} GiB of histograms; MATLAB v5 holds 2 GiB. Export npz."
        )
    scipy.io.savemat(str(path), facts_of(scan), appendmat=False, do_compression=True)
    return ["the event log, the settings and the devices stay in the recording"]
