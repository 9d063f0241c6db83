"""Which runs hold no laser light: even counts, or uneven bins that were meant to be dark and show no wall."""

from collections.abc import Sequence

import numpy as np

from nlos.calibration.background import is_flat
from nlos.calibration.by_blocks import chosen
from nlos.calibration.errors import InvalidData, NoDirectPeak
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.time_offset import measure_time_offsets
from nlos.calibration.wall_timing import FEWEST_POINTS


def dark_and_light(
    runs: Sequence[RawPoints], meant_dark: Sequence[bool], sources: Sequence[str]
) -> tuple[list[RawPoints], list[RawPoints]]:
    """The dark runs and the scans. `meant_dark` and `sources`, what each is called, are in the order of the runs, or
    empty.

    Bins of a dark run need not be even: they differ in width, and the laser's trigger couples into some. Raises
    `InvalidData` for one of several runs that is not even, was not meant to be dark and shows no wall either.
    """
    flat = [is_flat(chosen(run.counts, run.exposure_s > 0)) for run in runs]
    dark, light = [], []
    for number, run in enumerate(runs):
        meant = bool(meant_dark) and meant_dark[number]
        asked = meant or flat.count(False) > 1
        if flat[number] or (asked and not _shows_a_wall(run)):
            if not (flat[number] or meant):
                name = sources[number] if sources else f"run {number + 1} of {len(runs)}"
                raise InvalidData(
                    f"{name}: its counts are not even in time, but its light does not come from a wall, at other times "
                    "from other points. If it was taken dark on purpose (bins that differ, or what couples in), say "
                    "--dark; else leave it out."
                )
            dark.append(run)
        else:
            light.append(run)
    return dark, light


def _shows_a_wall(run: RawPoints) -> bool:
    """Whether direct light comes at other times from other points; too few points are believed."""
    if np.count_nonzero(run.exposure_s) < FEWEST_POINTS:
        return True
    try:
        found = measure_time_offsets(run.counts, run.x_m, run.y_m, run.time, exposed=run.exposure_s > 0)
    except NoDirectPeak:
        return False
    if found.wall is None:
        return bool(np.ptp(found.measured_bins[found.found]) > 1)
    return bool(np.ptp(found.predicted_bins) > 4 * max(found.rms_bins, 0.1))
