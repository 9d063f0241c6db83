"""When direct light arrives: wall, scanner position and one electronic delay, fitted jointly to all points."""

from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

Floats = npt.NDArray[np.float64]
FEWEST_POINTS = 9
"""Four unknowns, and enough points over to notice an outlier."""
NEARLY_ALL = 0.9
"""Of the points: a wall that explains more of them is no accident of where the search for it began."""
_MOST_STEPS = 100
"""Of a search, where 20 are usual: times that are alike at all points lead towards a scanner without end."""
_WITHOUT_END, _FARTHEST = 1e4, 1e3
"""Of the points' extent: where a search that came to no end begins once more, and from where on light comes to all
points at one time, to 3 ps a metre, so that nothing tells how far away the scanner is."""


@dataclass(frozen=True)
class WallTiming:
    """The scanner's place in wall coordinates and the delay between sync and a photon that travelled no distance."""

    scanner_position_m: Floats  # (3,): x, y, z > 0: distance from the wall's plane, on the side away from the scene
    delay_s: float
    covariance: Floats  # (4, 4) of (x, y, z in m, delay in s)
    rms_s: float
    """Scatter of the accepted points about the fit."""
    accepted: npt.NDArray[np.bool_]  # (N,)
    drawn: bool = False
    """Whether the bench's drawing, and not the points, told the scanner's place."""

    @property
    def placed(self) -> bool:
        """Whether the points themselves tell scanner and delay apart: those of a circle about its axis do not."""
        return not self.drawn and bool(np.sqrt(self.covariance[2, 2]) < self.scanner_position_m[2])

    def arrival_s(self, x_m: npt.ArrayLike, y_m: npt.ArrayLike) -> Floats:
        """Arrival of the direct light from wall points: delay + 2 |scanner - point| / c."""
        sx, sy, sz = self.scanner_position_m
        distance = np.sqrt((np.asarray(x_m) - sx) ** 2 + (np.asarray(y_m) - sy) ** 2 + sz**2)
        return np.asarray(self.delay_s + 2 * distance / SPEED_OF_LIGHT_M_PER_S)


@dataclass(frozen=True)
class TimedPoints:
    """Arrivals as lengths of the way to the wall, at points (N,) of it."""

    x_m: Floats
    y_m: Floats
    metres: Floats
    error_m: Floats
    """Infinite where there is no arrival."""
    usable: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, arrival_s: Floats, error_s: Floats, x_m: Floats, y_m: Floats) -> Self:
        """`error_s` (N,) are the arrivals' own standard errors, infinite where there is none; at least one is not."""
        usable = np.isfinite(arrival_s) & np.isfinite(error_s)
        floor_m = max(float(np.median(error_s[usable])), 1e-13) * SPEED_OF_LIGHT_M_PER_S / 2
        error_m = np.hypot(np.where(usable, error_s, np.inf) * SPEED_OF_LIGHT_M_PER_S / 2, floor_m)
        return cls(x_m, y_m, arrival_s * SPEED_OF_LIGHT_M_PER_S / 2, error_m, usable)

    def residuals(self, p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        """By how many standard errors a scanner at `p` (x, y, z, delay, all in m) is off, at the points to keep."""
        distance = np.sqrt((self.x_m[keep] - p[0]) ** 2 + (self.y_m[keep] - p[1]) ** 2 + p[2] ** 2)
        return np.asarray((p[3] + distance - self.metres[keep]) / self.error_m[keep])

    def slopes(self, p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        """Derivatives of `residuals` by `p`, (points, 4)."""
        dx, dy = p[0] - self.x_m[keep], p[1] - self.y_m[keep]
        distance = np.sqrt(dx**2 + dy**2 + p[2] ** 2)
        columns = [dx / distance, dy / distance, p[2] / distance, np.ones_like(dx)]
        return np.asarray(np.column_stack(columns) / self.error_m[keep, None])

    def delay_m(self, p: Floats) -> float:
        """The delay, as a length, that suits a scanner at `p` best."""
        without = np.append(p[:3], 0.0)
        return -float(np.median(self.residuals(without, self.usable) * self.error_m[self.usable]))

    def timing(
        self, p: Floats, accepted: npt.NDArray[np.bool_], covariance: Floats, *, drawn: bool = False
    ) -> WallTiming:
        """What was found; `covariance` (4, 4) of `p`."""
        to_seconds = np.diag([1.0, 1.0, 1.0, 2 / SPEED_OF_LIGHT_M_PER_S])
        off_m = self.residuals(p, accepted) * self.error_m[accepted]
        return WallTiming(
            scanner_position_m=p[:3].copy(),
            delay_s=float(p[3] * 2 / SPEED_OF_LIGHT_M_PER_S),
            covariance=to_seconds @ covariance @ to_seconds,
            rms_s=float(np.sqrt(np.mean(off_m**2)) * 2 / SPEED_OF_LIGHT_M_PER_S),
            accepted=accepted,
            drawn=drawn,
        )


def fit_wall_timing(
    arrival_s: Floats, error_s: Floats, x_m: Floats, y_m: Floats, near: WallTiming | None = None
) -> WallTiming | None:
    """Least squares with a soft loss first, then without the points beyond 4 times the scatter. A wall that was fitted
    to the same points before, `near`, is where to begin if it explained nearly all of them.

    `error_s` (N,) are the arrivals' own standard errors, infinite where there is none. Returns None where fewer than
    nine points are left, they do not span the wall, or light comes to all at one time, so that position and delay
    cannot be told apart.
    """
    usable = np.isfinite(arrival_s) & np.isfinite(error_s)
    if usable.sum() < FEWEST_POINTS:
        return None
    origin = np.array([x_m[usable].mean(), y_m[usable].mean()])
    spread = np.column_stack([x_m[usable] - origin[0], y_m[usable] - origin[1]])
    extent = float(np.sqrt((spread**2).sum(axis=1).max()))
    if np.linalg.matrix_rank(spread, tol=1e-6 * max(extent, 1e-9)) < 2:
        return None
    timed = TimedPoints.of(arrival_s, error_s, x_m, y_m)
    bounds = ([-np.inf, -np.inf, 0.02 * extent, -np.inf], np.inf)
    starts = [np.array([*origin, ratio * extent, 0.0]) for ratio in (1.0, 4.0)]
    if near is not None and near.accepted[usable].mean() > NEARLY_ALL:
        starts = [np.array([*near.scanner_position_m, 0.0])]

    def searched(start: Floats) -> Any:
        start[2] = max(start[2], bounds[0][2])
        start[3] = timed.delay_m(start)
        return scipy.optimize.least_squares(
            timed.residuals, start, timed.slopes, bounds, loss="soft_l1", f_scale=2.0, x_scale=[extent] * 4,
            args=(usable,), max_nfev=_MOST_STEPS,
        )  # fmt: skip

    cost = attrgetter("cost")
    best = min(map(searched, starts), key=cost)
    if best.nfev >= _MOST_STEPS:
        best = min(best, searched(np.array([*origin, _WITHOUT_END * extent, 0.0])), key=cost)
    accepted, solution = usable, best.x
    for _ in range(4):
        off = timed.residuals(solution, usable)
        limit = 4 * max(1.4826 * float(np.median(np.abs(off))), 1e-6)
        kept = usable.copy()
        kept[usable] = np.abs(off) <= limit
        if kept.sum() < FEWEST_POINTS:
            return None
        if (kept == accepted).all():
            break
        accepted = kept
        solution = scipy.optimize.least_squares(
            timed.residuals, solution, timed.slopes, bounds, x_scale=[extent] * 4, args=(accepted,),
            max_nfev=_MOST_STEPS,
        ).x  # fmt: skip
    off = timed.residuals(solution, accepted)
    jacobian = timed.slopes(solution, accepted)
    information = jacobian.T @ jacobian
    if solution[2] > _FARTHEST * extent or np.linalg.cond(information) > 1e15:
        return None
    scatter = float((off**2).sum() / max(len(off) - 4, 1))
    return timed.timing(solution, accepted, np.asarray(np.linalg.inv(information) * scatter))
