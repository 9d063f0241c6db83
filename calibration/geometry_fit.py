"""The scanner's geometry fitted to what is known of its beam: direct arrivals, spots measured on the wall, or both.

Arrivals tell the wall's distance and tilt and the electronic delay for mirrors that turn by as much as they are told;
spots tell gains, offsets and the scanner's place besides. Distance and gain pull in the same direction on a small wall,
so both kinds enter one fit. No point counts for more than its stated error, however well it fits: rulers are read to
whole millimetres, and what all of them share shows in no residual.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
RULER_M = 1e-3
"""How well a spot's middle is read off a ruler: one standard error, where nobody says another."""
METRES_PER_S = SPEED_OF_LIGHT_M_PER_S / 2
"""Distance to a point for the time there and back."""
FEWEST_POINTS = 9
FROM_TIMES = ("wall_distance_m", "wall_pitch_rad", "wall_yaw_rad", "delay_s")
FROM_SPOTS = ("x_gain", "y_gain", "x_offset_rad", "y_offset_rad", "scanner_x_m", "scanner_y_m")
TURNS_AS_TOLD = {"x_gain": 1.0, "y_gain": 1.0, "x_offset_rad": 0.0, "y_offset_rad": 0.0}
OUTLIER = 4.0
"""Standard errors: what is further off the fit is left aside."""
MOST_ASIDE = 0.25
"""Of the spots: where more of them are off, nobody knows which are wrong."""


@dataclass(frozen=True)
class DirectTimes:
    """When direct light arrived for commanded angles, all (N,); points with an infinite error do not count."""

    x_rad: Floats
    y_rad: Floats
    arrival_s: Floats
    error_s: Floats


@dataclass(frozen=True)
class Spots:
    """Where on the wall the beam was seen for commanded angles, all (N,), each to within `error_m`."""

    x_rad: Floats
    y_rad: Floats
    x_m: Floats
    y_m: Floats
    error_m: float = RULER_M
    lines: tuple[int, ...] = ()
    table: str = ""
    """Where each stands, for people; empty where they came from no table."""

    def name(self, index: int) -> str:
        """What to call a spot."""
        return f"{self.table}:{self.lines[index]}" if self.lines else f"spot {index + 1}"


@dataclass(frozen=True)
class GeometryFit:
    """A fitted geometry; `errors` are one standard error for each free parameter (metres, radians, seconds)."""

    geometry: ScannerGeometry
    delay_s: float
    """Arrival of a photon that travelled no distance; 0 where no times were given."""
    errors: dict[str, float]
    height_m: Floats  # (times,): how far the wall stands out of the fitted plane towards the scanner
    accepted: Flags  # (times,)
    spot_residual_m: Floats  # (spots, 2): measured less fitted
    spots_accepted: Flags  # (spots,)
    covariance: Floats  # of the free parameters, in the order of `errors`
    misfit: float
    """Sum of squared residuals in standard errors, of what was accepted: for comparing fits of the same points."""
    counted: Flags  # (residuals,): which residuals took part, and by what each kind's was divided
    scatter: Floats
    undetermined: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """What was to be fitted and is kept as it was: what the fit would have said, and its error."""

    @property
    def spots_rms_m(self) -> float:
        """Of the accepted spots' residuals, along each axis."""
        return float(np.sqrt(np.mean(self.spot_residual_m[self.spots_accepted] ** 2)))


def fit_geometry(
    start: ScannerGeometry,
    times: DirectTimes | None = None,
    spots: Spots | None = None,
    free: Sequence[str] | None = None,
    *,
    told: Mapping[str, float] | None = None,
    like: GeometryFit | None = None,
) -> GeometryFit:
    """Fits `free` (fields of `ScannerGeometry`, and `delay_s`); by default, what the given data can tell.

    Robust: a soft loss first, then without residuals beyond 4 times their scatter, each kind of data weighed by its
    own, but never by less than its stated error. `told`: parameters that are known beforehand to be as the mirrors are
    told, each to that standard error. `like`: counts and weighs the points as that fit of the same points did. Raises
    `InvalidData` with fewer than nine points of a kind, where they leave a parameter undetermined, and where more than
    a quarter of the spots would have to be left aside.
    """
    names = list(free or (*(FROM_SPOTS if spots else ()), *(FROM_TIMES if times else ())))
    model = _Model(start, names, times, spots, told or {})
    model.check()
    near = start if like is None else like.geometry
    first = np.array([0.0 if name == "delay_s" else getattr(near, name) for name in names])
    if times is not None and "delay_s" in names:
        path = near.spots(times.x_rad, times.y_rad)[2]
        first[names.index("delay_s")] = np.median((times.arrival_s * METRES_PER_S - path)[model.timed])
    if like is not None:
        keep, scatter = like.counted, like.scatter
        solution = _solved(model, first, keep, scatter)
    else:
        solution, keep, scatter = _robust(model, first)
    here = scipy.optimize.least_squares(model.residuals, solution, args=(keep, scatter), max_nfev=1)
    jacobian = np.asarray(here.jac, dtype=np.float64)
    information = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(information))
    if (scale == 0).any() or np.linalg.cond(information / np.outer(scale, scale)) > 1e13:
        raise InvalidData(f"these points do not determine all of {', '.join(names)}: fix some, or spread the points.")
    left = model.residuals(solution, keep, scatter)
    misfit = float((left**2).sum())
    geometry, delay_m = model.unpack(solution)
    units = np.array([1 / METRES_PER_S if name == "delay_s" else 1.0 for name in names])
    variance = max(misfit / max(int(keep.sum()) + len(told or {}) - len(names), 1), 1.0)
    covariance = np.asarray(np.linalg.inv(information) * variance * np.outer(units, units), np.float64)
    return GeometryFit(
        geometry,
        delay_m / METRES_PER_S,
        dict(zip(names, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        np.empty(0) if times is None else height_m(geometry, times, delay_m),
        np.empty(0, bool) if times is None else model.accepted_times(keep),
        np.empty((0, 2)) if spots is None else _off_spots(geometry, spots),
        model.accepted_spots(keep),
        covariance,
        misfit,
        keep,
        scatter,
    )


def _solved(model: "_Model", first: Floats, keep: Flags, scatter: Floats, soft: bool = False) -> Floats:
    """What the points leave open is searched no longer than 50 steps: its error says so afterwards."""
    loss: Literal["soft_l1", "linear"] = "soft_l1" if soft else "linear"
    found = scipy.optimize.least_squares(
        model.residuals, first, args=(keep, scatter), x_scale="jac", max_nfev=50, loss=loss, f_scale=2.0
    )
    return np.asarray(found.x, dtype=np.float64)


def _robust(model: "_Model", first: Floats) -> tuple[Floats, Flags, Floats]:
    """Parameters, which residuals count, and by what each kind's is divided."""
    keep, scatter = model.everything(), np.ones(2)
    solution = _solved(model, first, keep, scatter, soft=True)
    for _ in range(6):
        off = model.residuals(solution, model.everything(), np.ones(2))[: len(model.kinds)]
        scatter = model.scatter(off)
        kept = model.whole_spots(np.abs(off / scatter[model.kinds]) <= OUTLIER)
        solution = _solved(model, solution, kept, scatter)
        if (kept == keep).all():
            break
        keep = kept
    model.refuse_scattered_spots(keep)
    return solution, keep, scatter


class _Model:
    """Residuals in standard errors: spots in x, spots in y (kind 0), then times (kind 1), then what was told."""

    def __init__(
        self,
        start: ScannerGeometry,
        names: list[str],
        times: DirectTimes | None,
        spots: Spots | None,
        told: Mapping[str, float],
    ) -> None:
        self._start, self._names, self._times, self._spots = start, names, times, spots
        self._told = [(names.index(name), TURNS_AS_TOLD[name], error) for name, error in told.items()]
        self.timed = np.empty(0, bool)
        if times is not None:
            self.timed = np.isfinite(times.arrival_s) & np.isfinite(times.error_s)
        self._count = 0 if spots is None else len(spots.x_rad)
        self.kinds = np.repeat([0, 1], [2 * self._count, int(self.timed.sum())])

    def check(self) -> None:
        """Raises `InvalidData` for fewer than nine points of a kind."""
        for kind, given, count in (
            ("spots", self._spots, self._count),
            ("direct arrivals", self._times, int((self.kinds == 1).sum())),
        ):
            if given is not None and count < FEWEST_POINTS:
                raise InvalidData(f"{count} {kind} are given; the two-mirror model needs nine. Measure more points.")

    def everything(self) -> Flags:
        return np.ones(len(self.kinds), bool)

    def unpack(self, parameters: Floats) -> tuple[ScannerGeometry, float]:
        """Geometry, and the delay as a distance."""
        values = dict(zip(self._names, parameters.tolist(), strict=True))
        delay_m = values.pop("delay_s", 0.0)
        return replace(self._start, **values), delay_m

    def residuals(self, parameters: Floats, keep: Flags, scatter: Floats) -> Floats:
        """Of the points that are kept, then of what was told, which always counts."""
        geometry, delay_m = self.unpack(parameters)
        parts = [np.empty(0)]
        if self._spots is not None:
            parts += list(_off_spots(geometry, self._spots).T / self._spots.error_m)
        if self._times is not None:
            times, timed = self._times, self.timed
            path = geometry.spots(times.x_rad[timed], times.y_rad[timed])[2]
            off_m = times.arrival_s[timed] * METRES_PER_S - path - delay_m
            parts.append(off_m / (times.error_s[timed] * METRES_PER_S))
        measured = (np.concatenate(parts) / scatter[self.kinds])[keep]
        known = [(parameters[index] - value) / error for index, value, error in self._told]
        return np.append(measured, known)

    def scatter(self, off: Floats) -> Floats:
        """Of each kind's residuals, in stated errors; no less than one."""
        return np.array(
            [max(1.4826 * float(np.median(np.abs(off[self.kinds == k]))), 1.0) if (self.kinds == k).any() else 1.0
             for k in range(2)]
        )  # fmt: skip

    def whole_spots(self, kept: Flags) -> Flags:
        """A spot that is off along one axis counts along neither."""
        count = self._count
        good = kept[:count] & kept[count : 2 * count]
        return np.concatenate([good, good, kept[2 * count :]])

    def refuse_scattered_spots(self, kept: Flags) -> None:
        """Raises `InvalidData` where too many are off for the others to be believed."""
        aside = np.flatnonzero(~kept[: self._count])
        if self._spots is not None and len(aside) > MOST_ASIDE * self._count:
            far = ", ".join(self._spots.name(int(row)) for row in aside[:8])
            raise InvalidData(
                f"{len(aside)} of {self._count} spots do not fit the others: {far}. x_deg and y_deg are the angles "
                "sent (optical), x_m and y_m metres from the wall's centre. Correct these, or mark them again."
            )

    def accepted_spots(self, keep: Flags) -> Flags:
        return keep[: self._count]

    def accepted_times(self, keep: Flags) -> Flags:
        accepted = self.timed.copy()
        accepted[self.timed] = keep[self.kinds == 1]
        return accepted


def _off_spots(geometry: ScannerGeometry, spots: Spots) -> Floats:
    x, y, _ = geometry.spots(spots.x_rad, spots.y_rad)
    return np.column_stack([spots.x_m - x, spots.y_m - y])


def height_m(geometry: ScannerGeometry, times: DirectTimes, delay_m: float) -> Floats:
    """(times,) How much earlier than the fitted plane's the light came back, along the wall's normal."""
    path = geometry.spots(times.x_rad, times.y_rad)[2]
    step = 1e-4
    moved = replace(geometry, wall_distance_m=geometry.wall_distance_m + step)
    along = (moved.spots(times.x_rad, times.y_rad)[2] - path) / step
    cosine = np.cos(geometry.wall_pitch_rad) * np.cos(geometry.wall_yaw_rad) / along
    return np.asarray((path + delay_m - times.arrival_s * METRES_PER_S) * cosine)
