"""Where something is, by straight lines through its places around each moment: through as many of them as agree."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

SIZES = (3, 5, 7, 9)
"""Places that a line goes through."""
AGREE = 1.0
"""Of the errors of two lines, added: places by them that are farther apart than that do not lie on one line. With more
than one, what turns within a second is cut short; with less, little is gained on straight ways."""
OF_A_PIXEL = 0.15
"""What is off in all frames alike, as the picture's grid: no line tells."""


def scatter(places: Floats, time_s: Floats, apart: int = 1) -> Floats:
    """By how much places (F, 3) are off, (3,), from how far each is from between those `apart` places before and after
    it; NaN where there are none. Gaps in time are passed over."""
    before, middle, after = slice(None, -2 * apart), slice(apart, -apart), slice(2 * apart, None)
    took_s = time_s[after] - time_s[before]
    near = took_s < 2 * np.median(took_s) if len(took_s) else np.zeros(0, dtype=np.bool_)
    if not near.any():
        return np.full(3, np.nan)
    share = ((time_s[middle] - time_s[before]) / took_s)[near, None]
    left = places[middle][near] - share * places[after][near] - (1 - share) * places[before][near]
    return np.asarray(np.sqrt((left**2 / (1 + share**2 + (1 - share) ** 2)).mean(axis=0)))


def on_line(
    places: Floats, time_s: Floats, at: int, off_m: Floats, most: int, window: int = 1
) -> tuple[Floats, Floats]:
    """The place (3,) at moment `at`, and its standard error, by lines through the 1, 3, 5 ... `most` nearest ones: the
    longest whose place agrees with all shorter ones' along every axis, and is surer (Goldenshluger and Nemirovski,
    1997: the intersection of confidence intervals); none of them beyond a gap in time. `off_m` (3,) as of `scatter`.
    `window`: so many neighbours share what is off."""
    away_s = np.abs(time_s - time_s[at])
    nearest = np.argsort(away_s, kind="stable")
    nearest = nearest[away_s[nearest] <= most * float(np.median(np.diff(time_s)))] if len(nearest) > 1 else nearest
    place, error = places[at], off_m
    low, high = place - AGREE * off_m, place + AGREE * off_m
    for count in SIZES:
        if count > min(most, len(nearest)):
            break
        some = nearest[:count]
        since_s = time_s[some] - time_s[at]
        mean_s = float(since_s.mean())
        lever = float(((since_s - mean_s) ** 2).sum())
        by_line = places[some].mean(axis=0) - mean_s * ((since_s - mean_s) @ places[some]) / lever
        its = off_m * np.sqrt(window * (1 / count + mean_s**2 / lever))
        low, high = np.maximum(low, by_line - AGREE * its), np.minimum(high, by_line + AGREE * its)
        if not (low <= high).all():
            break
        if (its <= error).all():
            place, error = by_line, its
    return place, error
