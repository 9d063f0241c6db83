"""What pictures in passing are made of: the samples so far, calibrated as `reconstruct` would."""

import logging
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nlos.calibration.told import told_to
from nlos.live.time_zero import TimeZero
from nlos.response import ResponseWanted, with_response
from nlos.said_once import Tell

if TYPE_CHECKING:
    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.correct import CorrectedPoints
    from nlos.loaded import LoadedScan
    from nlos.recon.over_time.half_grid import HalfGrid

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Calibrated:
    """So many samples, `whole` once the scan has been read to its end."""

    samples: int
    whole: bool
    transient: "Transient"
    falloff: int | None
    zero: TimeZero
    of_film: "HalfGrid | None" = None
    """The same, where it is a frame of a film."""
    frame: tuple[int, float] = (-1, 0.0)
    """Which one, and the mean moment of its exposure."""


def calibrated(
    scan: "LoadedScan",
    samples: int,
    whole: bool,
    constants: "BenchConstants | None",
    response: ResponseWanted,
    tell: Tell,
) -> Calibrated:
    """`tell` is told how well, in words; of the whole scan it is said in any case. Raises what calibrating raises."""
    from nlos.chain import calibrate_scan

    found: list[CorrectedPoints] = []
    told = log.log if whole else tell
    with told_to(told):
        transient = with_response(calibrate_scan(scan, constants=constants, hear=found.append, tell=told), response)
    zero = TimeZero.of(scan, found[0] if found else None, constants)
    return Calibrated(samples, whole, transient, scan.falloff, zero)
