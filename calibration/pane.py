"""A pane before the wall: glass or a film that light passes there and back. Where it scatters as much as the wall, its
pulse is taken for direct light; the wall's comes later, as sharp, and as plane."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.arrival_rounds import PLANE_S, TimeOffsets
from nlos.calibration.told import warn

Floats = npt.NDArray[np.float64]
_TWICE = 2.0
"""How much worse a plane behind the corner has to explain the two pulses than a pane does."""


def is_pane(first: TimeOffsets, second: TimeOffsets, x_m: Floats, y_m: Floats) -> bool:
    """Whether two pulses of each point are a pane's and those of the wall behind it, and not a wall's and those of
    something plane behind the corner. Light meets a pane on its way: the places where it does, as far from the scanner
    as the first pulses say, lie on one plane. Of a hidden plane, later pulses lag by its distance from the wall's
    point, which is linear over the wall. Of a scanner far away the two are alike: then it is taken for a wall, and a
    warning says so."""
    wall = second.wall
    if wall is None:
        return False
    both = first.found & second.found & wall.accepted
    x, y, width_s = x_m[both], y_m[both], first.bin_width_s
    bin_m = width_s * SPEED_OF_LIGHT_M_PER_S / 2
    lag = (second.measured_bins - first.measured_bins)[both]
    scanner = wall.scanner_position_m
    ray = np.stack([x - scanner[0], y - scanner[1], np.full(len(x), -scanner[2])])  # (3, N)
    long = np.linalg.norm(ray, axis=0)
    place = scanner[:, None] + ray * (1 - lag * bin_m / long)
    off_pane = _off_plane(place[0], place[1], place[2]) * long / scanner[2] / bin_m
    off_hidden = _off_plane(x, y, lag)
    typical = float(np.median(np.hypot(first.error_bins, second.error_bins)[both]))
    if off_pane.std() > max(0.5, PLANE_S / width_s, 2 * typical):
        return False
    before_m, later_ns = float(np.mean(place[2])), float(np.mean(lag)) * width_s * 1e9
    if off_hidden.std() < _TWICE * off_pane.std():
        warn(
            "two pulses come from nearly every point, the later %.2f ns behind the first and as sharp. If there "
            "is glass %.2f m before the wall, time zero is the glass's: move it, or aim past it.", later_ns, before_m,
        )  # fmt: skip
        return False
    warn(
        "something flat %.2f m before the wall (glass?) scatters about as much light as the wall: of two pulses from "
        "every point, %.2f ns apart, the later is taken for the wall's. Move it, or aim past it.", before_m, later_ns,
    )  # fmt: skip
    return True


def _off_plane(x: Floats, y: Floats, z: Floats) -> Floats:
    """What is left of `z` (N,) after a plane over x and y."""
    columns = np.stack([np.ones_like(x), x, y], axis=1)
    return np.asarray(z - columns @ np.linalg.lstsq(columns, z, rcond=None)[0])
