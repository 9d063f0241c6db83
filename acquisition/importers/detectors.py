"""What is said where photons of several detectors make one histogram."""

from collections.abc import Sequence
from typing import Any

import numpy.typing as npt

_NAMED = 8


def added_up(
    histograms: npt.NDArray[Any], names: Sequence[int], bin_width_s: float, of: str = "photons of {} detectors"
) -> str | None:
    """Of detectors called `names`, with these photons by delay (D, T), those that have any, and how far apart their
    peaks lie: cables of different length smear the depth of what is added. None where there is but one."""
    seen = [(name, row) for name, row in zip(names, histograms, strict=True) if row.any()]
    if len(seen) < 2:
        return None
    peaks = [int(row.argmax()) for _, row in seen]
    apart = (max(peaks) - min(peaks)) * bin_width_s * 1e12
    said = f"{of.format(len(seen))} are added up"
    if len(seen) <= _NAMED:
        said += f" ({', '.join(f'{name}: {row.sum():,.0f}' for name, row in seen)})"
    return said + (f"; their peaks lie up to {apart:,.0f} ps apart" if max(peaks) - min(peaks) > 1 else "")
