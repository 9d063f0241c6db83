"""PTU: a scan as a T3 image, one frame, one channel, written by `ptufile` (C. Gohlke)."""

from importlib.metadata import version
from pathlib import Path

import numpy as np
import ptufile

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.scan_arrays import ScanArrays

_MAX_BINS = 1 << 15  # 15 bits of delay in a generic T3 record
_SYNC_PERIOD_S = 100e-9


def write_ptu(scan: ScanArrays, path: Path) -> list[str]:
    """Writes every photon as a T3 record. Returns what the format cannot hold.

    Raises `InvalidData` for free positions, and for more bins than a record can tell apart.
    """
    if not scan.on_grid:
        raise InvalidData(f"{path}: a PTU image needs a grid; export free positions to npz")
    rows, cols, bins = scan.histograms.shape
    if bins > _MAX_BINS:
        raise InvalidData(f"{path}: {bins} bins; a T3 record tells {_MAX_BINS} apart. Rebin, or export npz.")
    counts = scan.histograms
    narrow = counts.astype(np.uint16) if counts.max(initial=0) < 1 << 16 else counts
    notes = [
        f"the wall's size has no place in PTU: read it with --wall-size-m {scan.wall.width_m:g}x{scan.wall.height_m:g}",
        "photons are spread evenly over each dwell: arrival order is not stored",
    ]
    if scan.rectified:
        notes.append("that time 0 is the wall has no place in PTU: read it with --rectified")
    if scan.time.start_s:
        notes.append(f"delays count from the first bin, {scan.time.start_s * 1e9:g} ns after the laser pulse")
    period_s = max(_SYNC_PERIOD_S, bins * scan.time.bin_width_s)
    dwells = np.unique(scan.exposure_s.round(9))
    photons = int(counts.sum(axis=2, dtype=np.int64).max(initial=0))
    pixel_time: float | None = float(dwells[0])
    if len(dwells) > 1 or dwells[0] < 2 * photons * period_s:
        pixel_time = None
        notes.append("exposures differ between points, or hold more photons than laser pulses: they are not exported")
    ptufile.imwrite(
        path,
        narrow.reshape(1, rows, cols, 1, bins),
        period_s,
        scan.time.bin_width_s,
        pixel_time,
        record_type=ptufile.PtuRecordType.GenericT3,
        tags={  # the first two are optional in the vendor's dictionary, but phconvert reads no file without them
            "HW_Type": "MultiHarp",  # whose records these are: the vendor's library takes names that it knows
            "MeasDesc_AcquisitionTime": max(1, round(float(scan.exposure_s.sum()) * 1e3)),  # ms
            "CreatorSW_Name": "nlos",
            "CreatorSW_Version": version("nlos"),
        },
    )
    return notes
