"""What is asked about a rectified scan whose light looks like that of a raw one."""

import logging

from nlos.calibration.correct import CorrectedPoints
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.seems_raw import aligned_later_s, mean_arrival_s
from nlos.loaded import LoadedScan
from nlos.said_once import Tell


def tell_if_not_rectified(scan: LoadedScan, raw: RawPoints, done: CorrectedPoints, tell: Tell) -> None:
    """Says so where a rectified scan still holds direct light at time 0; asks where a pulse comes at one later time at
    all points, or, of a scan that is only assumed to be rectified, as if straight from a plane wall."""
    if done.direct.end_bin:
        tell(
            logging.WARNING,
            "direct light is still in it, though it counts as rectified: the first %.2f ns are skipped. With --raw "
            "(in Python rectified=False) it is aligned by that light, and its response is measured.",
            done.direct.end_bin * done.time.bin_width_s * 1e9,
        )
    elif (later_s := aligned_later_s(raw)) is not None:
        tell(
            logging.WARNING,
            "is time 0 the wall? Each point's light is mainly one sharp pulse, %.2f ns later at all of them, as direct "
            "light that was aligned to there; nothing hidden comes back at one time. If it is: --raw (in Python "
            "rectified=False), which aligns by it, or store offset_s = %.3g.",
            later_s * 1e9,
            raw.time.start_s - later_s,
        )
    elif scan.rectified_assumed and (arrival_s := mean_arrival_s(raw)) is not None:
        tell(
            logging.WARNING,
            "is time 0 the wall? Each point's light is mainly one sharp pulse, %.2f ns later on average, and arrives "
            "as if straight from a plane wall. If it does, the scan is raw: --raw (in Python rectified=False). If time "
            "0 is the wall: --rectified.",
            arrival_s * 1e9,
        )
