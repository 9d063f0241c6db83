"""Direct light that the owner of a rectified scan cut off."""

import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy.typing as npt

from nlos.calibration.direct_tail import bins_of_tail
from nlos.said_once import Tell

if TYPE_CHECKING:
    from nlos.acquisition.transient import Transient


def cut_direct(transient: "Transient", bins: int) -> "Transient":
    """The same transient with its first `bins` set to zero."""
    return replace(transient, counts=without_first(transient.counts, bins))


def without_first(counts: npt.NDArray[Any], bins: int) -> npt.NDArray[Any]:
    """A copy of counts (T, ...) with the first `bins` set to zero."""
    cut = counts.copy()
    cut[:bins] = 0
    return cut


def tell_of_tail(counts: npt.NDArray[Any], cut_bins: int, bin_width_s: float, tell: Tell) -> None:
    """Warns where the tail of direct light is left in `counts` (T, ...), whose first `cut_bins` were cut."""
    tail = bins_of_tail(counts.reshape(len(counts), -1).sum(axis=1, dtype=float), cut_bins, bin_width_s)
    if tail is not None:
        tell(
            logging.WARNING,
            "direct light was cut off too early: light fades from the first bin that was kept on, then rises again. A "
            "picture may take the rest for a near surface. Store direct_cut_bins = %d, or set these bins to 0; but not "
            "where something hidden stands that near.",
            tail,
        )
