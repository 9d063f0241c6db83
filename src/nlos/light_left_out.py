"""What is not in the picture: what made light that comes after the end of the shortest record behind the wall, and what
the tail of direct light hides."""

import logging

import numpy as np

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.correct import CorrectedPoints
from nlos.said_once import Tell

WORTH_SAYING = 0.05
"""Of all light behind the wall."""
HIDDEN_S, HIDDEN_SHARE = 1e-9, 0.25
"""What direct light hides is said from so long on, and of so much of the record behind it."""


def hidden_by_the_tail(done: CorrectedPoints) -> str:
    """What to say where direct light hides much of the record; empty where it does not."""
    masked_s, masked = done.direct.end_bin * done.time.bin_width_s, done.direct.end_bin / done.time.bins
    if not (masked_s > HIDDEN_S and masked > HIDDEN_SHARE):
        return ""
    return (
        f"direct light fades so slowly that it outshines all else until {masked_s * 1e9:.1f} ns after it came, "
        f"{100 * masked:.0f} % of the record behind it: nothing nearer than "
        f"{masked_s * SPEED_OF_LIGHT_M_PER_S / 2:.2f} m is looked at. A detector with a shorter tail, a gate that "
        "opens later or more light from the scene shows more"
    )


def tell_of_light_left_out(done: CorrectedPoints, tell: Tell) -> None:
    """Says how deep a scan reaches that was aligned, where points that recorded longer saw light from behind that; and
    from where on, where direct light hides much of it."""
    if hidden := hidden_by_the_tail(done):
        tell(logging.WARNING, "%s", hidden)
        return  # of the tail is what comes later, too
    share = done.beyond / (done.beyond + max(float(done.counts.sum(dtype=np.float64)), 0.0)) if done.beyond else 0.0
    if share > WORTH_SAYING:
        reach_m = done.time.bins * done.time.bin_width_s * SPEED_OF_LIGHT_M_PER_S / 2
        tell(
            logging.INFO,
            "behind %.2f m nothing is looked at: there ends the record of the point that light reaches last. %.0f %% "
            "of the light came later, at other points; to see what made it, lengthen the histogram or start it later",
            reach_m, 100 * share,
        )  # fmt: skip
