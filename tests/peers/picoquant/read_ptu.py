"""Run by the foreign environment: what snAPI or phconvert find in a PTU file, as arrays in an NPZ.

read_ptu.py snapi|phconvert FILE.ptu FOUND.npz
"""

import os
import sys

import numpy as np

_OVERFLOW = 0x7F
_OPEN: list[object] = []
"""What must outlive the file that is written: taking the vendor's library down sometimes crashes."""


def by_snapi(path: str) -> dict[str, np.ndarray]:
    """The vendor's library: photons and markers unfolded, and the records as they are. Channel 0 is the sync."""
    from snAPI.Main import snAPI

    _OPEN.append(library := snAPI())
    assert library.getFileDevice(path)
    records = int(library.measDescription["NumRecs"])
    assert library.raw.measure(acqTime=0, size=records + 16, waitFinished=True, savePTU=False)
    raw = np.array(library.raw.getData(), dtype=np.uint32)
    assert library.unfold.measure(acqTime=0, size=records + 16, waitFinished=True, savePTU=False)
    times, channels = (np.array(each) for each in library.unfold.getData())
    pulses = library.unfold.nSync_T3(times).astype(np.int64)
    delays = library.unfold.dTime_T3(times).astype(np.int64)
    kept = channels != (0x80 | _OVERFLOW)
    pulses, delays, channels = pulses[kept], delays[kept], channels[kept].astype(np.int64)
    marker = (channels & 0x80) != 0
    return {
        "raw": raw,
        "pulse": pulses,
        "delay": np.where(marker, 0, delays),
        "marker": np.where(marker, channels & 0x7F, 0),
        "channel": np.where(marker, 0, channels - 1),
    }


def by_phconvert(path: str) -> dict[str, np.ndarray]:
    """Markers are detectors from 65 on."""
    from phconvert.pqreader import load_ptu

    pulse, detector, delay, meta, marker_ids = load_ptu(path)
    marker = np.isin(detector, marker_ids)
    return {
        "pulse": pulse.astype(np.int64),
        "delay": np.where(marker, 0, delay).astype(np.int64),
        "marker": np.where(marker, detector & 0x3F, 0).astype(np.int64),
        "channel": np.where(marker, 0, detector).astype(np.int64),
        "acquisition_s": np.array(meta["acquisition_duration"]),
        "bin_width_s": np.array(meta["nanotimes_unit"]),
        "pulse_s": np.array(meta["timestamps_unit"]),
    }


if __name__ == "__main__":
    reader, source, target = sys.argv[1:]
    np.savez(target, **(by_snapi(source) if reader == "snapi" else by_phconvert(source)))
    sys.stdout.flush()
    os._exit(0)
