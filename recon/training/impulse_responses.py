"""Measured impulse responses, made ready for a time axis."""

from functools import lru_cache
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

FLOOR = 0.01
TAPS = 65
"""Bins in which a response is told."""


@lru_cache(maxsize=16)
def read_impulse_response(path: Path, bin_width_s: float) -> npt.NDArray[np.float64]:
    """The response in `path`, its peak in the middle (K,), K odd, summing to 1, in bins of `bin_width_s`.

    HDF5 with `counts` (T,), or `histogram`, or `sum`, and the attribute `bin_width_s` or times `time_s` (T,). The
    background (median) is taken off; what stays below a hundredth of the peak at either end is cut. Raises ValueError
    for a file without a pulse.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    with h5py.File(path) as file:
        name = next((name for name in ("histogram", "counts", "sum") if name in file), None)
        if name is None or not ("bin_width_s" in file.attrs or "time_s" in file):
            raise ValueError(f"{path} holds no `counts` with an attribute `bin_width_s` or times `time_s`")
        counts = np.asarray(file[name][...], dtype=np.float64)
        own_s = (
            float(file.attrs["bin_width_s"]) if "bin_width_s" in file.attrs else float(np.diff(file["time_s"][:2])[0])
        )
    pulse = np.maximum(counts - np.median(counts), 0)
    if counts.ndim != 1 or not pulse.any():
        raise ValueError(f"{path} holds no pulse: its histogram is flat or not one-dimensional")
    bright = np.flatnonzero(pulse >= FLOOR * pulse.max())
    pulse = pulse[bright[0] : bright[-1] + 1]
    edges = (np.arange(pulse.size + 1) - pulse.argmax() - 0.5) * own_s / bin_width_s
    reach = int(np.ceil(max(-edges[0], edges[-1]) - 0.5))
    coarse = np.arange(-reach, reach + 2) - 0.5
    whole = np.interp(coarse, edges, np.concatenate(([0], np.cumsum(pulse))))
    return np.asarray(np.diff(whole) / pulse.sum(), dtype=np.float64)


def fitted(response: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
    """A response (K,) as TAPS shares that add up to 1: zeros beside a shorter one, a longer one cut."""
    spare = (TAPS - response.size) // 2
    taps = np.pad(response, spare) if spare >= 0 else response[-spare : response.size + spare]
    return np.asarray(taps / taps.sum(), dtype=np.float32)


UNTOLD = fitted(np.ones(1))
"""The response of a sample of which none is told."""
