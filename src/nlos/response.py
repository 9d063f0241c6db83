"""Which response of the instrument a picture is made with: what was said, else that of the bench's constants, of the
file, of the scan's own direct peak, else none."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.acquisition.response import Response, gaussian, measured
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, Transient
from nlos.calibration.checked import response_checked
from nlos.recon.errors import InvalidSettings

if TYPE_CHECKING:
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.impulse_response import ImpulseResponse
    from nlos.loaded import LoadedScan

log = logging.getLogger(__name__)

FAINTEST_OF_PEAK = 0.01
STANDS_OUT = 5.0  # a direct peak over the brightest of what follows it
FEWEST_WIDTHS = 10
"""A wall so many resolution cells wide shows a letter; a slower response is said to be too slow."""
NARROWEST_PS, WIDEST_PS = 1.0, 25_000.0


@dataclass(frozen=True)
class ResponseWanted:
    """What was said about the response: `auto`, or one and only that (None: none)."""

    auto: bool = True
    response: Response | None = None


AUTO = ResponseWanted()


def response_wanted(said: object) -> ResponseWanted:
    """From `auto`, `none`, a FWHM in ps, a file, or (curve, width of its bins in s).

    A file is one of constants, or HDF5 with a histogram of a sharp reflection. Raises `InvalidSettings` for a number
    that no response can be, `FileNotFoundError`, and `InvalidData` for a file that holds no response.
    """
    if isinstance(said, ResponseWanted):
        return said
    if said is None or (isinstance(said, str) and said == "auto"):  # a curve alone equals no word, but elementwise
        return AUTO
    if isinstance(said, str) and said == "none":
        return ResponseWanted(False)
    if isinstance(said, Response):
        return ResponseWanted(False, said)
    curve = None
    try:
        if isinstance(said, tuple) and len(said) == 2:
            curve, step_s = np.asarray(said[0], dtype=float), float(said[1])
        else:
            fwhm_ps = float(said)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        if not isinstance(said, str | Path):
            raise InvalidSettings(
                f"response={said!r}: auto, none, a FWHM in picoseconds, a file, or (curve, bin width in s) is expected"
            ) from None
        return ResponseWanted(False, _of_file(Path(said)))
    if curve is not None:
        return ResponseWanted(False, measured(curve, step_s, "the curve given"))
    if not NARROWEST_PS <= fwhm_ps <= WIDEST_PS:
        hint = f" Did you mean {fwhm_ps * 1e12:g}?" if NARROWEST_PS <= fwhm_ps * 1e12 <= WIDEST_PS else ""
        raise InvalidSettings(
            f"response {said}: a full width at half maximum in picoseconds, {NARROWEST_PS:g} to {WIDEST_PS:g}, is "
            f"expected.{hint}"
        )
    return ResponseWanted(False, gaussian(fwhm_ps * 1e-12, "a Gaussian, as given"))


def _of_file(path: Path) -> Response:
    """Of a constants file, or of a histogram of a sharp reflection."""
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: no such file. A response is auto, none, a FWHM in picoseconds, or a file of one."
        )
    return _of_bench(response_checked(path), str(path))


def _of_bench(found: "ImpulseResponse", source: str) -> Response:
    return measured(found.density, found.step_s, source, -found.start_s / found.step_s - 0.5)


def response_of(constants: "BenchConstants | None") -> Response | None:
    """The response that a bench's constants hold; None without."""
    if constants is None or constants.response is None:
        return None
    return _of_bench(constants.response, f"the bench's constants of {constants.measured_utc}")


def known_response(
    scan: "LoadedScan", constants: "BenchConstants | None", own: "ImpulseResponse | None"
) -> Response | None:
    """The best there is without being told: of the bench's constants, of the file, of the direct peak `own` that the
    calibration found or that a rectified file still holds; None without any."""
    if (of_bench := response_of(constants)) is not None:
        return of_bench
    if scan.response is not None:
        return scan.response
    if own is not None:
        return _of_bench(own, "the scan's own direct peak")
    return _left_in(scan.transient, scan.direct_cut_bins) if scan.rectified else None


def _left_in(transient: Transient, cut_bins: int | None) -> Response | None:
    """Of the direct light that a rectified file still holds in its first `cut_bins`; None where that is gone."""
    if cut_bins is None:
        return None
    profile = transient.counts.mean(axis=(1, 2), dtype=np.float64)
    before, after = profile[:cut_bins], profile[cut_bins:]
    if not after.size or not before.max() > STANDS_OUT * max(float(after.max()), 0.0):
        return None
    curve = _around_peak(before - np.median(after))
    return measured(curve, transient.time.bin_width_s, "the scan's own direct peak") if curve.size > 1 else None


def _around_peak(curve: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """The part around the maximum that stays above `FAINTEST_OF_PEAK` of it."""
    low, peak = curve < FAINTEST_OF_PEAK * curve.max(), int(np.argmax(curve))
    before, after = np.flatnonzero(low[:peak]), np.flatnonzero(low[peak:])
    return curve[int(before[-1]) + 1 if before.size else 0 : peak + int(after[0]) if after.size else len(curve)]


def with_response(transient: Transient, wanted: ResponseWanted) -> Transient:
    """The transient with the response that is wanted."""
    return transient if wanted.auto else replace(transient, response=wanted.response)


def say_response(transient: Transient) -> None:
    """Warns of a response that is too slow; with -v which one is known (what it was used for, every verb says once)."""
    found = transient.response
    if found is None:
        log.debug("response: none known")
        return
    log.debug("response: %.0f ps FWHM, %s", found.fwhm_s * 1e12, found.source)
    across_m, wall_m = lateral_m(transient, found.fwhm_s), transient.wall.longer_m
    if across_m * FEWEST_WIDTHS > wall_m:
        log.warning(
            "a response of %.0f ps is slow for this wall: it blurs %.2g m across, more than a tenth of its %.3g m. "
            "What is finer is guessed at best; a faster detector or a larger wall would show it.",
            found.fwhm_s * 1e12, across_m, wall_m,
        )  # fmt: skip


def lateral_m(transient: Transient, fwhm_s: float) -> float:
    """The finest detail across at the depth from which most light comes: c FWHM sqrt(w^2 + z^2) / (2 w), w half the
    wall's longer side. Source: O'Toole et al., Nature 2018, eq. 4."""
    profile = np.maximum(transient.counts.sum(axis=(1, 2), dtype=np.float64), 0)
    brightest_s = float(transient.time.centres_s()[int(profile.argmax())])
    return resolution_across_m(fwhm_s, transient.wall.longer_m, brightest_s * SPEED_OF_LIGHT_M_PER_S / 2)


def resolution_across_m(fwhm_s: float, wall_width_m: float, depth_m: float) -> float:
    """What a response lets one tell apart across, behind a wall of that width at that depth."""
    half_m = wall_width_m / 2
    return float(SPEED_OF_LIGHT_M_PER_S * fwhm_s * np.hypot(half_m, depth_m) / (2 * half_m))
