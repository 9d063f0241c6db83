"""Scans as Photon-HDF5, as `phconvert` lays out a PTU image: photons and marks in one stream, the tags beside them."""

from pathlib import Path

import h5py
import numpy as np

CLOCK_S, PULSES = 1e-7, 40_000
"""The laser's period, and how many pulses a point is looked at."""


def write_photons(path: Path, counts: np.ndarray, bin_width_s: float) -> Path:
    """Every photon of `counts` (H, W, T) at a pulse of its own of its point's, a mark at either end of each line."""
    rows, cols, bins = counts.shape
    per_point = counts.reshape(-1, bins).astype(np.int64)
    point = np.repeat(np.arange(rows * cols), per_point.sum(axis=1))
    delays = np.concatenate([np.repeat(np.arange(bins), each) for each in per_point])
    first = np.cumsum(per_point.sum(axis=1)) - per_point.sum(axis=1)
    times = point * PULSES + (np.arange(len(point)) - first[point]) % PULSES
    lines = np.arange(rows) * cols * PULSES
    stream = [(times, delays, 0), (lines, lines * 0, 65), (lines + cols * PULSES, lines * 0, 66)]
    timestamps, nanotimes = (np.concatenate([each[n] for each in stream]) for n in range(2))
    detectors = np.concatenate([np.full(len(each[0]), each[2], np.uint8) for each in stream])
    order = np.lexsort((-detectors.astype(int), timestamps))
    tags = {"Measurement_SubMode": 3, "ImgHdr_Dimensions": 3, "ImgHdr_PixX": cols, "ImgHdr_PixY": rows,
            "ImgHdr_LineStart": 1, "ImgHdr_LineStop": 2}  # fmt: skip
    with h5py.File(path, "w") as file:
        file.attrs.update({"format_name": np.bytes_("Photon-HDF5"), "format_version": np.bytes_("0.5")})
        file["acquisition_duration"] = rows * cols * PULSES * CLOCK_S
        group = file.create_group("photon_data")
        group["timestamps"], group["nanotimes"] = timestamps[order], nanotimes[order].astype(np.uint16)
        group["detectors"] = detectors[order]
        group["timestamps_specs/timestamps_unit"], group["nanotimes_specs/tcspc_unit"] = CLOCK_S, bin_width_s
        group["nanotimes_specs/tcspc_num_bins"] = bins
        group["measurement_specs/detectors_specs/non_photon_id1"] = np.array([65, 66], np.uint8)
        for name, value in tags.items():
            file[f"user/picoquant/tags/{name}/value"] = value
    return path
