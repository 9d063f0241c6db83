"""How much every time bin has faded with distance."""

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.recon.transport.conventions import Conventions, check_supported, depths_m, range_m


def relative_distance(time: TimeAxis, conventions: Conventions = "physical") -> npt.NDArray[np.float64]:
    """Distance of every bin over the farthest, (T,), 0 to 1."""
    check_supported(time, conventions)
    if conventions == "authors":
        return np.linspace(0.0, 1.0, time.bins)
    return np.asarray(np.maximum(depths_m(time, conventions), 0.0) / range_m(time, conventions))


def falloff_weights(time: TimeAxis, exponent: float, conventions: Conventions = "physical") -> npt.NDArray[np.float64]:
    """What undoes the fading, (T,): (distance / the farthest)^exponent. Source: O'Toole et al. 2018, eq. 1."""
    return np.asarray(relative_distance(time, conventions) ** exponent)
