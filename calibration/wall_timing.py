"""When direct light arrives: wall, scanner position and one electronic delay, fitted jointly to all points."""

from dataclasses import dataclass
from operator import attrgetter
from typing import Any

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
    metres = arrival_s * SPEED_OF_LIGHT_M_PER_S / 2
    floor_m = max(float(np.median(error_s[usable])), 1e-13) * SPEED_OF_LIGHT_M_PER_S / 2
    error_m = np.hypot(np.where(usable, error_s, np.inf) * SPEED_OF_LIGHT_M_PER_S / 2, floor_m)

    def residuals(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        distance = np.sqrt((x_m[keep] - p[0]) ** 2 + (y_m[keep] - p[1]) ** 2 + p[2] ** 2)
        return np.asarray((p[3] + distance - metres[keep]) / error_m[keep])

    def slopes(p: Floats, keep: npt.NDArray[np.bool_]) -> Floats:
        dx, dy = p[0] - x_m[keep], p[1] - y_m[keep]
        distance = np.sqrt(dx**2 + dy**2 + p[2] ** 2)
        columns = [dx / distance, dy / distance, p[2] / distance, np.ones_like(dx)]
        return np.asarray(np.column_stack(columns) / error_m[keep, None])

    bounds = ([-np.inf, -np.inf, 0.02 * extent, -np.inf], np.inf)
    starts = [np.array([*origin, ratio * extent, 0.0]) for ratio in (1.0, 4.0)]
    if near is not None and near.accepted[usable].mean() > NEARLY_ALL:
        starts = [np.array([*near.scanner_position_m, 0.0])]

    def searched(start: Floats) -> Any:
        start[2] = max(start[2], bounds[0][2])
        start[3] = -np.median(residuals(start, usable) * error_m[usable])
        return scipy.optimize.least_squares(
            residuals, start, slopes, bounds, loss="soft_l1", f_scale=2.0, x_scale=[extent] * 4, args=(usable,),
            max_nfev=_MOST_STEPS,
        )  # fmt: skip

    cost = attrgetter("cost")
    best = min(map(searched, starts), key=cost)
    if best.nfev >= _MOST_STEPS:
        best = min(best, searched(np.array([*origin, _WITHOUT_END * extent, 0.0])), key=cost)
    accepted, solution = usable, best.x
    for _ in range(4):
        off = residuals(solution, usable)
        limit = 4 * max(1.4826 * float(np.median(np.abs(off))), 1e-6)
        kept = usable.copy()
        kept[usable] = np.abs(off) <= limit
        if kept.sum() < FEWEST_POINTS:
            return None
        if (kept == accepted).all():
            break
        accepted = kept
        solution = scipy.optimize.least_squares(
            residuals, solution, slopes, bounds, x_scale=[extent] * 4, args=(accepted,), max_nfev=_MOST_STEPS
        ).x
    off = residuals(solution, accepted)
    jacobian = slopes(solution, accepted)
    information = jacobian.T @ jacobian
    if solution[2] > _FARTHEST * extent or np.linalg.cond(information) > 1e15:
        return None
    to_seconds = np.diag([1.0, 1.0, 1.0, 2 / SPEED_OF_LIGHT_M_PER_S])
    scatter = float((off**2).sum() / max(len(off) - 4, 1))
    return WallTiming(
        scanner_position_m=solution[:3].copy(),
        delay_s=float(solution[3] * 2 / SPEED_OF_LIGHT_M_PER_S),
        covariance=to_seconds @ np.linalg.inv(information) @ to_seconds * scatter,
        rms_s=float(np.sqrt(np.mean((off * error_m[accepted]) ** 2)) * 2 / SPEED_OF_LIGHT_M_PER_S),
        accepted=accepted,
    )
