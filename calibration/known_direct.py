"""What a whole scan, or its file, says of direct light, for its single frames, whose photons are too few to tell."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from nlos.calibration.second_pulse import SecondPulse


@dataclass(frozen=True, eq=False)
class KnownDirect:
    """When it comes, and what comes with it."""

    offset_bins: npt.NDArray[np.float64]
    """When it comes, in bins after the start of the record: (N,), or (H, W) of a grid."""
    pulses: tuple[SecondPulse, ...] = ()
    """Those that come again behind it, and are taken out."""
    light: npt.NDArray[np.float64] | None = None
    """(N,); what exposures are multiplied by, as `CorrectedPoints.light`."""
    ambient: tuple[int, int] | None = None
    """First bin and end of where ambient light is measured, if not before it, as `Background.stretch`."""
    close_end_bin: int = 0
    """Where a second pulse ends that is masked with it, in bins behind it; 0 without one."""

    def at(self, points: npt.NDArray[np.int64]) -> "KnownDirect":
        """Of some of the N points."""
        light = None if self.light is None else self.light[points]
        return replace(self, offset_bins=self.offset_bins[points], light=light)
