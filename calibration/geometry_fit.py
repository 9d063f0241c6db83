"""The scanner's geometry fitted to what is known of its beam: direct arrivals, spots measured on the wall, or both.

Arrivals tell the wall's distance and tilt and the electronic delay for mirrors that turn by as much as they are told;
spots tell gains, offsets and the scanner's place besides. Distance and gain pull in the same direction on a small wall,
so both kinds enter one fit.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
METRES_PER_S = SPEED_OF_LIGHT_M_PER_S / 2
"""Distance to a point for the time there and back."""
FEWEST_POINTS = 9
_FINEST = (0.1, 0.1, 1e-6)
"""Of each kind's stated error: spots that fit better than a tenth of it are still no better measured."""
FROM_TIMES = ("wall_distance_m", "wall_pitch_rad", "wall_yaw_rad", "delay_s")
FROM_SPOTS = ("x_gain", "y_gain", "x_offset_rad", "y_offset_rad", "scanner_x_m", "scanner_y_m")


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
    error_m: float = 1e-3


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
    undetermined: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """What was to be fitted and is kept as it was: what the fit would have said, and its error."""


def fit_geometry(
    start: ScannerGeometry,
    times: DirectTimes | None = None,
    spots: Spots | None = None,
    free: Sequence[str] | None = None,
) -> GeometryFit:
    """Fits `free` (fields of `ScannerGeometry`, and `delay_s`); by default, what the given data can tell.

    Robust: a soft loss first, then without residuals beyond 4 times their scatter, each kind of data weighed by its
    own. Raises `InvalidData` with fewer than nine points of a kind, or where they leave a parameter undetermined.
    """
    names = list(free or (*(FROM_SPOTS if spots else ()), *(FROM_TIMES if times else ())))
    model = _Model(start, names, times, spots)
    model.check()
    first = np.array([0.0 if name == "delay_s" else getattr(start, name) for name in names])
    if times is not None and "delay_s" in names:
        path = start.spots(times.x_rad, times.y_rad)[2]
        first[names.index("delay_s")] = np.median((times.arrival_s * METRES_PER_S - path)[model.timed])
    keep, weight = model.everything(), np.ones(3)
    solution = least_squares(model.residuals, first, loss="soft_l1", f_scale=2.0, args=(keep, weight)).x
    for _ in range(4):
        off = model.residuals(solution, model.everything(), np.ones(3))
        weight = model.weights(off)
        kept = np.abs(off * weight[model.kinds]) <= 4
        solution = least_squares(model.residuals, solution, args=(kept, weight)).x
        if (kept == keep).all():
            break
        keep = kept
    jacobian = np.asarray(least_squares(model.residuals, solution, args=(keep, weight)).jac, dtype=np.float64)
    information = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(information))
    if (scale == 0).any() or np.linalg.cond(information / np.outer(scale, scale)) > 1e13:
        raise InvalidData(f"these points do not determine all of {', '.join(names)}: fix some, or spread the points.")
    left = model.residuals(solution, keep, weight)
    variance = float((left**2).sum()) / max(len(left) - len(names), 1)
    if model.finer_than_measured:
        variance = max(variance, 1.0)
    errors = np.sqrt(np.diag(np.linalg.inv(information)) * variance)
    geometry, delay_m = model.unpack(solution)
    in_units = [1 / METRES_PER_S if name == "delay_s" else 1.0 for name in names]
    return GeometryFit(
        geometry,
        delay_m / METRES_PER_S,
        {name: float(e * u) for name, e, u in zip(names, errors, in_units, strict=True)},
        np.empty(0) if times is None else _height(geometry, times, delay_m),
        np.empty(0, bool) if times is None else model.accepted_times(keep),
        np.empty((0, 2)) if spots is None else _off_spots(geometry, spots),
    )


class _Model:
    """Residuals in standard errors: spots in x, spots in y, then times (kinds 0, 1, 2)."""

    def __init__(
        self, start: ScannerGeometry, names: list[str], times: DirectTimes | None, spots: Spots | None
    ) -> None:
        self._start, self._names, self._times, self._spots = start, names, times, spots
        self.timed = np.empty(0, bool)
        self.finer_than_measured = False
        if times is not None:
            self.timed = np.isfinite(times.arrival_s) & np.isfinite(times.error_s)
        count = 0 if spots is None else len(spots.x_rad)
        self.kinds = np.repeat([0, 1, 2], [count, count, int(self.timed.sum())])

    def check(self) -> None:
        """Raises `InvalidData` for fewer than nine points of a kind."""
        for kind, given, count in (
            ("spots", self._spots, int((self.kinds == 0).sum())),
            ("direct arrivals", self._times, int((self.kinds == 2).sum())),
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

    def residuals(self, parameters: Floats, keep: Flags, weight: Floats) -> Floats:
        geometry, delay_m = self.unpack(parameters)
        parts = []
        if self._spots is not None:
            parts += list(_off_spots(geometry, self._spots).T / self._spots.error_m)
        if self._times is not None:
            times, timed = self._times, self.timed
            path = geometry.spots(times.x_rad[timed], times.y_rad[timed])[2]
            off_m = times.arrival_s[timed] * METRES_PER_S - path - delay_m
            parts.append(off_m / (times.error_s[timed] * METRES_PER_S))
        return np.asarray((np.concatenate(parts) * weight[self.kinds])[keep])

    def weights(self, off: Floats) -> Floats:
        """One over the scatter of each kind."""
        scatter = [
            1.4826 * float(np.median(np.abs(off[self.kinds == k]))) if (self.kinds == k).any() else 1.0
            for k in range(3)
        ]
        self.finer_than_measured = any(scatter[k] < _FINEST[k] for k in range(3) if (self.kinds == k).any())
        return np.asarray(1 / np.maximum(scatter, _FINEST))

    def accepted_times(self, keep: Flags) -> Flags:
        accepted = self.timed.copy()
        accepted[self.timed] = keep[self.kinds == 2]
        return accepted


def _off_spots(geometry: ScannerGeometry, spots: Spots) -> Floats:
    x, y, _ = geometry.spots(spots.x_rad, spots.y_rad)
    return np.column_stack([spots.x_m - x, spots.y_m - y])


def _height(geometry: ScannerGeometry, times: DirectTimes, delay_m: float) -> Floats:
    """How much earlier than the fitted plane's the light came back, along the wall's normal."""
    path = geometry.spots(times.x_rad, times.y_rad)[2]
    step = 1e-4
    moved = replace(geometry, wall_distance_m=geometry.wall_distance_m + step)
    along = (moved.spots(times.x_rad, times.y_rad)[2] - path) / step
    cosine = np.cos(geometry.wall_pitch_rad) * np.cos(geometry.wall_yaw_rad) / along
    return np.asarray((path + delay_m - times.arrival_s * METRES_PER_S) * cosine)
