"""How far a whole picture may be off, predicted from its intervals: the figure that a scan can be ended by."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

LEAST = 1e-4
Image = npt.NDArray[np.floating]


@dataclass(frozen=True)
class ErrorLine:
    """log(error) = offset + slope log(what the intervals say); nine of ten pictures are at most `above` over it."""

    slope: float
    offset: float
    above: float

    def at(self, said: float) -> float:
        """The relative error that nine of ten pictures stay below whose intervals say `said`."""
        return min(1.0, math.exp(self.offset + self.slope * math.log(max(said, LEAST)) + self.above))


def said_by(albedo: Image, low: Image, high: Image) -> float:
    """The relative L2 error of a front view at its best scale, were every pixel off by half its interval; (H, W) each.

    At its best scale an error is perpendicular to the picture, so that the truth's power is the sum of both.
    """
    wrong = float(np.sum((high - low).astype(np.float64) ** 2)) / 4
    power = float(np.sum(albedo.astype(np.float64) ** 2))
    return math.sqrt(wrong / (power + wrong)) if power + wrong > 0 else 1.0


def relative_error(albedo: Image, truth: Image) -> float:
    """|s albedo - truth| / |truth| at the best s; both (H, W)."""
    power, norm = float(np.vdot(albedo, albedo)), float(np.linalg.norm(truth))
    if not (power > 0 and norm > 0):
        return 1.0
    return float(np.linalg.norm(albedo * (float(np.vdot(albedo, truth)) / power) - truth)) / norm


def line_through(said: list[float], true: list[float], share: float = 0.9) -> ErrorLine:
    """The line through logarithms of what intervals said and of true errors, and what `share` of them stay below."""
    x, y = (np.log(np.maximum(np.asarray(each), LEAST)) for each in (said, true))
    slope, offset = (float(value) for value in np.polyfit(x, y, 1))
    return ErrorLine(slope, offset, float(np.quantile(y - offset - slope * x, share)))
