"""What the light of another program's file or arrays says against what the file, or their owner, says."""

import logging

import numpy as np

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, Transient
from nlos.calibration.raw_points import from_transient
from nlos.calibration.wall_size import found_side

log = logging.getLogger(__name__)
LAST_BINS = 16
WALL_OFF = 0.1
"""Of a wall's width: direct light of a scanner that moves the beam's origin says a little more or less."""


def doubt(name: str, transient: Transient, *, wall_known: bool, direct_light: bool) -> None:
    """All that follows, of what is on a grid with or without `direct_light`; logged as warnings about `name`."""
    tell_of_last_bin(name, transient)
    if wall_known:
        doubt_scale(name, transient)
    if wall_known and direct_light:
        doubt_wall(name, transient)


def tell_of_last_bin(name: str, transient: Transient) -> None:
    """Some instruments put all photons that come too late into the last bin: they would be seen at the far end."""
    by_bin = np.asarray(transient.counts).sum(axis=(1, 2), dtype=np.float64)
    most = float(by_bin[-1 - LAST_BINS : -1].max()) if len(by_bin) > LAST_BINS else np.inf
    if by_bin[-1] > 5 * most + 10 * np.sqrt(most + 1):
        log.warning(
            "%s: the last bin holds %.4g counts, the %d before it at most %.4g each: what came too late? It would be "
            "seen as a surface at the far end. Store the histograms without it.", name, by_bin[-1], LAST_BINS, most,
        )  # fmt: skip


def doubt_scale(name: str, transient: Transient) -> None:
    """Asks about units where points lie farther apart than the record is deep: centimetres for metres."""
    wall, time = transient.wall, transient.time
    apart_m = max(wall.width_m / wall.cols, wall.height_m / wall.rows)
    deep_m = (time.start_s + time.bins * time.bin_width_s) * SPEED_OF_LIGHT_M_PER_S / 2
    if apart_m > deep_m and wall.rows * wall.cols > 1:
        log.warning(
            "%s: points %.4g m apart on a wall of %.4g x %.4g m, and a record that reaches %.4g m deep: is the wall in "
            "metres, and the bin width in seconds?", name, apart_m, wall.width_m, wall.height_m, deep_m,
        )  # fmt: skip


def doubt_wall(name: str, transient: Transient) -> None:
    """Says so where the direct light of a raw scan denies the size that its wall is said to have."""
    width_m = transient.wall.width_m
    found = found_side(from_transient(transient), width_m)
    if found is not None and abs(found[0] / width_m - 1) > max(WALL_OFF, 5 * found[1] / width_m):
        log.warning(
            "%s: the wall is said to be %.4g m wide; by the times of its direct light it is %.3f +- %.3f m. One of "
            "them is wrong, or the bin width: --wall-size-m, --bin-width-ps (wall, bin_width in Python).",
            name, width_m, *found,
        )  # fmt: skip
