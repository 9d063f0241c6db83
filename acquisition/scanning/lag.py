"""By how much a mirror trails a ramp, from the arrival times of light on lines swept there and back.

The way to the wall and back differs from point to point. Swept one way, the curve of mean arrival times is shifted
along the line by what the commands lead too much; swept the other way, by as much to the other side. What the curve
looks like does not matter: both are fitted by one polynomial and its shift.
"""

import json
import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.layout import EVENT

DEGREE = 4
ROUNDS = 6
PEAK_PART = 0.1
"""The arrivals that are averaged: around the highest bin, until the light falls below this part of it."""
SIGMAS = 3.0

Counts = npt.NDArray[np.uint32]
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lag:
    """What was measured on the bench before its continuous lines: the lag, and how many steps of a line the beam may be
    away from a point in the middle of its dwell."""

    lag_s: float
    within_px: float
    refused: str = ""
    """Why no lines are swept by it, so that points are taken one by one; neither number need be finite then."""

    def text(self) -> str:
        """As the event log of a recording keeps it. What is refused has no `within_px`, so that no reader takes it for
        a lag to sweep by, and as much of the reason as a row holds."""
        if not self.refused:
            return json.dumps({"lag_s": self.lag_s, "within_px": self.within_px})
        lag_s, why = float(f"{self.lag_s:.4g}") if math.isfinite(self.lag_s) else None, self.refused
        while len(said := json.dumps({"lag_s": lag_s, "within_px": None, "refused": why})) > EVENT["text"].itemsize:
            why = why[:-1]
        return said

    @classmethod
    def of_text(cls, text: str) -> "Lag":
        """Raises `InvalidData` for anything else."""
        try:
            values = json.loads(text)
            if refused := str(values.get("refused", "")):
                lag_s = values["lag_s"]
                return cls(math.nan if lag_s is None else float(lag_s), math.inf, refused)
            lag = cls(float(values["lag_s"]), float(values["within_px"]))
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise InvalidData(f"an event of kind lag says {text[:80]!r}") from error
        if not (math.isfinite(lag.lag_s) and 0 <= lag.within_px < 1):
            raise InvalidData(f"an event of kind lag says {text[:80]!r}")
        return lag


@dataclass(frozen=True)
class Shift:
    """How far ahead of its points the beam was, in steps of the line, and the standard error of that."""

    points: float
    error: float


def shift(there: Counts, back: Counts) -> Shift:
    """From histograms (n, T) of the same n points in the same order, swept upwards and downwards."""
    window = peak_window(there.sum(axis=0) + back.sum(axis=0))
    bins = np.arange(window.start, window.stop)
    counts = np.concatenate([there, back]).astype(np.float64)[:, window]
    photons = counts.sum(axis=1)
    lit = photons > 0
    if not lit.any():
        return Shift(0.0, math.inf)
    mean = counts[lit] @ bins / photons[lit]
    spread = float((counts[lit] * (bins - mean[:, None]) ** 2).sum() / photons.sum()) + 1 / 12
    points = len(there)
    half = (points - 1) / 2
    place = np.tile((np.arange(points) - half) / max(half, 1.0), 2)[lit]
    sign = np.repeat([1.0, -1.0], points)[lit] / max(half, 1.0)
    weight = np.sqrt(photons[lit] / spread)
    degree = min(DEGREE, points // 4)
    ahead, curve = 0.0, np.zeros(degree + 1)
    design = np.zeros((len(mean), degree + 2))
    for _ in range(ROUNDS):
        at = place + ahead * sign
        powers = np.vander(at, degree + 1, increasing=True)
        slope = powers[:, :-1] @ (curve[1:] * np.arange(1, degree + 1))
        design = np.column_stack([powers, slope * sign])
        found, *_ = np.linalg.lstsq(design * weight[:, None], mean * weight, rcond=1e-10)
        curve = found[:-1]
        ahead = float(np.clip(ahead + found[-1], -points / 4, points / 4))
    left = (design[:, :-1] @ curve - mean) * weight
    inflation = max(1.0, float((left**2).sum()) / max(len(mean) - degree - 2, 1))
    information = (design * weight[:, None]).T @ (design * weight[:, None])
    variance = float(np.linalg.pinv(information)[-1, -1]) * inflation
    known = float(information[-1, -1]) > 0 and variance > 0
    return Shift(ahead, math.sqrt(variance) if known else math.inf)


def combined(shifts: list[Shift]) -> Shift:
    """Their mean, weighted by what each knows."""
    weights = np.array([1 / each.error**2 for each in shifts])
    if not weights.sum() > 0:
        return Shift(0.0, math.inf)
    mean = float((weights * [each.points for each in shifts]).sum() / weights.sum())
    return Shift(mean, float(weights.sum()) ** -0.5)


def peak_window(total: npt.NDArray[np.integer]) -> slice:
    """The bins around the highest one until the light falls below a part of it."""
    smooth = np.convolve(total, np.ones(3), mode="same")
    peak = int(np.argmax(smooth))
    low = np.flatnonzero(smooth <= PEAK_PART * smooth[peak])
    before, after = low[low < peak], low[low > peak]
    start = int(before[-1]) - 1 if len(before) else 0
    stop = int(after[0]) + 2 if len(after) else len(total)
    return slice(max(start, 0), min(stop, len(total)))
