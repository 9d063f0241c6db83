"""A wall that is not as bright everywhere: paint, bricks, a poster. Hidden light goes by it twice, so it differs as the
square of what direct light does; taken for the scene's own, that is another picture. Also light that differs once from
point to point: a laser's power, dwells that nobody stored."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.calibration.told import warn

Floats = npt.NDArray[np.float64]
Places = npt.NDArray[np.int64]
_NEIGHBOURS = 4
_AROUND = 0.25
"""Of their distance, by which the middle of a point's neighbours may lie beside it: even changes are none then."""
_FEWEST = 24
"""Points that differ from what is around them."""
_UNEVEN = 1.15
"""Times as bright as what is around it, or as dark, a point's direct light is then, distance aside, and two standard
errors beyond: hidden light does not change so from point to point, and if it does, direct light does not follow."""
_BETTER = 0.5
"""Of what points differ by from those around them in hidden light, is left where it follows direct light."""
_CHANCE = 2.0
"""Times what chance would leave is no difference to speak of."""
_TOO_DARK = 0.05
"""Of the light of bright points: what such a point adds is noise."""
_BRIGHT = 0.9


@dataclass(frozen=True, eq=False)
class HiddenLight:
    """Aligned histograms of N points without their direct light."""

    counts: npt.NDArray[np.floating]  # (N, T)
    variance: npt.NDArray[np.floating]  # (N, T)
    usable: npt.NDArray[np.bool_]  # (N, T)
    exposure_s: Floats  # (N,)
    direct_counts: Floats
    """(N,); 0 where direct light was not found."""
    x_m: Floats  # (N,)
    y_m: Floats


@dataclass(frozen=True, eq=False)
class WallBrightness:
    """Of N points, how bright hidden light is for the wall's sake."""

    light: Floats
    """(N,), by its median: what exposures are multiplied by; 0 where next to nothing is left, 1 where not known."""
    power: int
    """1: as direct light; 2: its square, as by a wall's reflectance."""
    uneven: float
    """How many times the tenth brightest point's direct light is the tenth darkest's."""


def wall_brightness(done: HiddenLight, scanner_position_m: npt.ArrayLike) -> WallBrightness | None:
    """By points whose direct light differs from that around them, where hidden light does, too; None where it does not
    follow, or direct light changes evenly."""
    lit = (done.direct_counts > 0) & (done.exposure_s > 0) & np.isfinite(done.exposure_s)
    if lit.sum() <= _NEIGHBOURS:
        return None
    direct = done.direct_counts[lit]
    x, y, seconds = done.x_m[lit], done.y_m[lit], done.exposure_s[lit] / np.median(done.exposure_s[lit])
    right, up, off = np.asarray(scanner_position_m, dtype=np.float64)
    bright = direct / seconds * ((x - right) ** 2 + (y - up) ** 2 + off**2)
    bright /= np.median(bright)
    at, around = _unlike(bright, direct, x, y)
    if len(at) < _FEWEST:
        return None
    when = (done.usable | ~lit[:, None]).all(axis=0)
    shape = np.where(when, np.mean(done.counts, axis=0, dtype=np.float64, where=lit[:, None]), 0.0)
    shape = np.where(when, shape - shape[when].mean(), 0.0) if when.any() else shape  # blind to what is even in time
    hidden, chance = (  # without a copy of all counts in twice the memory
        np.einsum("nt,t->n", each, by, dtype=np.float64)[lit]
        for each, by in ((done.counts, shape), (done.variance, shape**2))
    )
    no_chance = np.zeros(len(hidden))
    left = [_left(hidden, chance, bright**power * seconds, no_chance, at, around) for power in (0, 1, 2)]
    by_chance = 1 / direct
    once, twice = (_left(hidden, chance, bright**p * seconds, p**2 * by_chance, at, around) for p in (1, 2))
    power = 1 if once < twice else 2
    if not left[0] > _CHANCE or left[power] > _BETTER * left[0]:
        return None
    dark_tenth, bright_tenth = np.quantile(bright, [0.1, 0.9])
    each = np.ones(len(lit))
    each[lit] = np.where(bright**power < _TOO_DARK * np.quantile(bright, _BRIGHT) ** power, 0.0, bright**power)
    return WallBrightness(each, power, float(bright_tenth / dark_tenth))


def _unlike(bright: Floats, counts: Floats, x: Floats, y: Floats) -> tuple[Places, Places]:
    """Points (P,) whose direct light, `bright` (N,) by `counts` (N,), differs from their neighbours' (P, K)."""
    from scipy.spatial import cKDTree

    places = np.stack([x, y], axis=1)
    nearest = np.asarray(cKDTree(places).query(places, k=_NEIGHBOURS + 1)[1])
    at, around = nearest[:, 0], nearest[:, 1:]
    aside = np.linalg.norm(places[around].mean(axis=1) - places[at], axis=1)
    far = np.linalg.norm(places[around] - places[at][:, None], axis=2).mean(axis=1)
    apart = np.abs(np.log(bright[at]) - np.log(bright[around]).mean(axis=1))
    error = np.sqrt(1 / counts[at] + (1 / counts[around]).mean(axis=1) / _NEIGHBOURS)
    unlike = (aside < _AROUND * far) & (apart > np.log(_UNEVEN) + 2 * error)
    return at[unlike], around[unlike]


def _left(hidden: Floats, chance: Floats, factor: Floats, of_factor: Floats, at: Places, around: Places) -> float:
    """What hidden light (N,) differs by from that around it, beyond its factors (N,), over what chance makes of it and
    `of_factor` (N,), its square over that of the factor."""
    even = hidden / factor
    error = chance / factor**2 + even**2 * of_factor
    apart = even[at] - even[around].mean(axis=1)
    return float(np.mean(apart**2 / np.maximum(error[at] + error[around].mean(axis=1) / _NEIGHBOURS, 1e-30)))


def doubt_wall_brightness(found: WallBrightness) -> None:
    """Says what differs, by how much, and what is done about it."""
    dark = int((found.light == 0).sum())
    warn(
        "direct light is %.2g times as bright at some points as at others, distance aside, and hidden light follows "
        "%s. It is undone, as by longer exposures%s. A wall that is even shows more.",
        found.uneven,
        "its square: the wall is not as bright everywhere" if found.power == 2 else "it: laser or dwell differ",
        f"; {dark} of {len(found.light)} points are too dark to add anything, and count as not measured"
        if dark else "",
    )  # fmt: skip
