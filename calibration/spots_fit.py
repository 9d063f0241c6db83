"""Where the scanner stands and how its mirrors turn, from spots alone or together with a scan's direct arrivals."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import (
    FROM_SPOTS,
    FROM_TIMES,
    METRES_PER_S,
    TURNS_AS_TOLD,
    DirectTimes,
    GeometryFit,
    Spots,
    fit_geometry,
    height_m,
)
from nlos.calibration.reduced_times import reduced_times
from nlos.calibration.spots_sense import check_sense, refuse_other_units

log = logging.getLogger(__name__)
PLACE = ("scanner_x_m", "scanner_y_m", "wall_distance_m", "wall_pitch_rad", "wall_yaw_rad")
OFFSETS = ("y_offset_rad", "x_offset_rad")
LEANS = ("wall_pitch_rad", "wall_yaw_rad")
AS_TOLD = {
    "x_gain": 5e-4, "y_gain": 5e-4, "x_offset_rad": math.radians(0.02), "y_offset_rad": math.radians(0.02),
}  # fmt: skip
"""How well closed-loop mirrors turn as they are told, where nothing says otherwise: one standard error."""
_ANY_OFFSET = {"x_offset_rad": math.radians(1.0), "y_offset_rad": math.radians(1.0)}
"""So wide that an offset that the points tell is told by them; without it the search runs after what they do not."""
FREED = 12.0
"""By so much must the squared misfit fall for each gain or offset that is let go: 3.5 standard errors."""
WORTH = {
    "scanner_x_m": 5e-3, "scanner_y_m": 5e-3, "wall_distance_m": 1e-2,
    "wall_pitch_rad": math.radians(0.5), "wall_yaw_rad": math.radians(0.5),
    "x_gain": 0.01, "y_gain": 0.01, "x_offset_rad": math.radians(0.2), "y_offset_rad": math.radians(0.2),
}  # fmt: skip
"""A standard error above this says nothing that a tape measure would not."""
WIDEST_M = 0.02
"""RMS of spots about the fit beyond which it is none."""


@dataclass(frozen=True)
class PlacedScanner:
    """`undetermined`: what these spots do not tell, with what a fit would have said and its error; it is kept as the
    bench file draws it. `freed`: gains and offsets that are not as the mirrors were told."""

    fit: GeometryFit
    undetermined: dict[str, tuple[float, float]]
    freed: tuple[str, ...] = ()
    spots_alone: GeometryFit | None = None
    times_alone: GeometryFit | None = None
    """What each kind says by itself, for mirrors that turn as told; None where it was not asked, or cannot."""


def place_from_spots(spots: Spots, drawn: ScannerGeometry) -> PlacedScanner:
    """The scanner's place, the wall's distance and lean, as far as the spots determine them; the others as `drawn`.

    Raises `InvalidData` for fewer than nine spots, for axes that are swapped or reversed, for spots on one line, for
    other units than metres, and where no plane wall explains them.
    """
    check_sense(spots)
    refuse_other_units(spots, drawn.wall_distance_m)
    placed = fit_determined(replace(drawn, **TURNS_AS_TOLD), None, spots, PLACE)
    _refuse_no_fit(placed.fit)
    return placed


def place_with_run(spots: Spots, times: DirectTimes, start: ScannerGeometry) -> PlacedScanner:
    """The same from spots and direct arrivals together, with the mirrors' gains and offsets.

    Those stay as the mirrors are told, to within `AS_TOLD`, unless the points say otherwise beyond doubt: let go for
    nothing, a gain doubles a ruler's error in the distance. Of all ways to let some go, the one with the smallest
    misfit wins, where each that is let go has to earn `FREED`.
    """
    check_sense(spots)
    refuse_other_units(spots, start.wall_distance_m)
    few = reduced_times(times, start)
    log.debug("fitting place, gains and offsets to spots and arrivals")
    full = fit_determined(start, few, spots, (*FROM_SPOTS, *FROM_TIMES), told=_ANY_OFFSET)
    undetermined = {name: said for name, said in full.undetermined.items() if name in OFFSETS}
    names = [name for name in (*FROM_SPOTS, *FROM_TIMES) if name not in undetermined]
    held = [name for name in AS_TOLD if name in names]
    best: tuple[float, PlacedScanner] | None = None
    for count in range(len(held) + 1):
        for freed in combinations(held, count):
            log.debug("fitting mirrors that turn as told, but for: %s", ", ".join(freed) or "nothing")
            told = {name: AS_TOLD[name] for name in held if name not in freed}
            try:
                placed = fit_determined(start, few, spots, names, told=told, like=full.fit)
            except InvalidData:
                continue
            cost = placed.fit.misfit + FREED * count
            if not set(freed) & set(placed.undetermined) and (best is None or cost < best[0]):
                best = cost, replace(placed, freed=freed)
        if best is not None and full.fit.misfit + FREED * (count + 1) >= best[0]:
            break  # no fit has a smaller misfit than the one with everything free
    if best is None:
        raise InvalidData("spots and arrivals together do not determine the place: mark spots further to the sides.")
    _refuse_no_fit(best[1].fit)
    as_told = replace(start, **TURNS_AS_TOLD)
    log.debug("fitting spots alone, and arrivals alone")
    return replace(
        best[1],
        fit=_of_all_times(best[1].fit, times),
        undetermined={**undetermined, **best[1].undetermined},
        spots_alone=fit_determined(as_told, None, spots, PLACE).fit,
        times_alone=fit_geometry(as_told, few),
    )


def fit_determined(
    start: ScannerGeometry,
    times: DirectTimes | None,
    spots: Spots,
    free: Sequence[str],
    *,
    told: Mapping[str, float] | None = None,
    like: GeometryFit | None = None,
) -> PlacedScanner:
    """`fit_geometry` of as many parameters of `free` as the data determine, the others as in `start`.

    A mirror's offset is let go first: with the scanner's place and the wall's lean it makes a rotation that no spot on
    a plane wall and no arrival tells from none. Raises `InvalidData` where nothing is left to fit.
    """
    left, undetermined = list(free), {}
    while True:
        known = {name: error for name, error in (told or {}).items() if name in left}
        try:
            fit = fit_geometry(start, times, spots, left, told=known, like=like)
        except InvalidData:
            if not (loose := [name for name in (*OFFSETS, *LEANS) if name in left]):
                raise
            undetermined[loose[0]] = (getattr(start, loose[0]), math.inf)
        else:
            if not (loose := poorly_determined(fit)) or len(left) == 1:
                return PlacedScanner(fit, undetermined)
            undetermined[loose[0]] = (getattr(fit.geometry, loose[0]), fit.errors[loose[0]])
        left.remove(loose[0])


def poorly_determined(fit: GeometryFit) -> list[str]:
    """Fitted parameters whose errors say that the data did not tell them: offsets first, then the worst."""
    loose = [name for name, error in fit.errors.items() if name in WORTH and error > WORTH[name]]
    return sorted(loose, key=lambda name: (name not in OFFSETS, -fit.errors[name] / WORTH[name]))


def _refuse_no_fit(fit: GeometryFit) -> None:
    if not fit.spots_rms_m <= WIDEST_M:
        raise InvalidData(
            f"the spots scatter by {fit.spots_rms_m * 1e3:.0f} mm RMS about the best plane wall: no geometry fits. "
            "x_deg and y_deg are the angles sent (optical, twice the mechanical), x_m and y_m metres from the wall's "
            "centre; check the mirror's volts_per_degree, and that neither scanner nor wall was moved in between."
        )


def _of_all_times(fit: GeometryFit, times: DirectTimes) -> GeometryFit:
    """The fit of the averaged arrivals, with every single one's height and whether it belongs to the wall."""
    height = height_m(fit.geometry, times, fit.delay_s * METRES_PER_S)
    there = np.isfinite(height) & np.isfinite(times.error_s)
    error_m = np.where(there, times.error_s, np.inf) * METRES_PER_S
    off = np.abs(height / error_m)
    limit = 4 * max(1.4826 * float(np.median(off[there])), 1.0)
    return replace(fit, height_m=height, accepted=there & (off <= limit))
