"""What is said where a file has photons of several detectors: all make one histogram, or those of one alone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy.typing as npt

from nlos.acquisition.errors import InvalidData

_NAMED = 8


def one_alone(photons: Mapping[int, int], wanted: int, place: str) -> str:
    """What is to be said where of the detectors, with so many `photons` each, one is `wanted`. Raises `InvalidData`,
    naming `place`, where that has none."""
    there = {name: count for name, count in photons.items() if count}
    if wanted not in there:
        raise InvalidData(
            f"{place}: --detector {wanted}: has no photons of it; there are {_listed(there) or 'none at all'}. Name "
            "one of these, or leave --detector out: all are added up then."
        )
    others = {name: count for name, count in there.items() if name != wanted}
    said = f"photons of detector {wanted} alone, as given"
    return f"{said}; not imported: {_listed(others)}" if others else said


def _listed(photons: Mapping[int, int]) -> str:
    named = [f"{count:,} of detector {name}" for name, count in list(photons.items())[:_NAMED]]
    return ", ".join(named) + (f", and {len(photons) - _NAMED} more" if len(photons) > _NAMED else "")


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
    if max(peaks) - min(peaks) > 1:
        said += f"; their peaks lie up to {apart:,.0f} ps apart"
    return f"{said}; --detector N takes one alone"
