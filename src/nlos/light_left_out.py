"""Light that comes after the end of the shortest record behind the wall: what made it is not in the picture."""

import logging

import numpy as np

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.correct import CorrectedPoints
from nlos.said_once import Tell

WORTH_SAYING = 0.05
"""Of all light behind the wall."""


def tell_of_light_left_out(done: CorrectedPoints, tell: Tell) -> None:
    """Says how deep a scan reaches that was aligned, where points that recorded longer saw light from behind that."""
    share = done.beyond / (done.beyond + max(float(done.counts.sum(dtype=np.float64)), 0.0)) if done.beyond else 0.0
    if share > WORTH_SAYING:
        reach_m = done.time.bins * done.time.bin_width_s * SPEED_OF_LIGHT_M_PER_S / 2
        tell(
            logging.INFO,
            "behind %.2f m nothing is looked at: there ends the record of the point that light reaches last. %.0f %% "
            "of the light came later, at other points; to see what made it, lengthen the histogram or start it later",
            reach_m, 100 * share,
        )  # fmt: skip
