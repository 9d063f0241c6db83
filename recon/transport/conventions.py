"""Two ways to put the continuous model on a grid: the physically exact one, and that of the published programs.

`physical`: samples sit at bin and pixel centres, c = 299792458 m/s. `authors`: what O'Toole et al. (Nature 2018) and
Lindell et al. (ACM TOG 2019) compute, half-sample offsets and c = 3e8 m/s included; for comparison with their volumes.
"""

from typing import Literal

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis

Conventions = Literal["physical", "authors"]


def speed_m_per_s(conventions: Conventions) -> float:
    """The speed of light in use."""
    return SPEED_OF_LIGHT_M_PER_S if conventions == "physical" else 3e8


def range_m(time: TimeAxis, conventions: Conventions) -> float:
    """Distance from the wall at the end of the time axis: light there and back in that time."""
    return speed_m_per_s(conventions) * (time.start_s + time.bins * time.bin_width_s) / 2


def depths_m(time: TimeAxis, conventions: Conventions) -> npt.NDArray[np.float64]:
    """Depth of each voxel plane, (T,): half the light path at the bin's centre (authors: at its beginning)."""
    if conventions == "physical":
        return time.centres_s() * (SPEED_OF_LIGHT_M_PER_S / 2)
    return np.arange(time.bins, dtype=np.float64) * (time.bin_width_s * speed_m_per_s(conventions) / 2)


def check_supported(time: TimeAxis, conventions: Conventions) -> None:
    """Raises ValueError where the published conventions do not say what to do."""
    if conventions == "authors" and time.start_s != 0:
        raise ValueError(
            f"the authors' conventions know only time axes that start at 0, this one starts at {time.start_s:g} s. "
            "Pad the histograms to 0, or use conventions=physical."
        )
    if not time.start_s + time.bins * time.bin_width_s > 0:
        raise ValueError(f"the time axis ends before 0 (start {time.start_s:g} s); nothing hidden can be in it")
