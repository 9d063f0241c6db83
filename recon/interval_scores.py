"""How good intervals are against a truth: do they hold, how wide are they, do they point at the errors."""

import numpy as np
import numpy.typing as npt

from nlos.recon.metrics import by_maximum
from nlos.recon.volume import Intervals

Image = npt.NDArray[np.float32]
NAMES = ("albedo_coverage", "albedo_width", "albedo_ause", "depth_coverage", "depth_width_m", "depth_ause", "seen_ece")
BINS = 10
STEPS = 50


def interval_scores(
    albedo: Image, depth_m: Image, sure: Intervals | None, intensity: Image, true_m: Image, mask: npt.NDArray[np.bool_]
) -> dict[str, float]:
    """Figures by `NAMES`, NaN where there are no intervals; (H, W) each argument.

    Coverage and mean width over the pixels of the `mask` (for depth: those that have one): of the rest the truth is 0
    and any interval from 0 holds. Brightness is in the picture's units, the truth at its best scale, widths over the
    picture's maximum. `ause`: the area between the sparsification curves by width and by the error itself, over the
    error's range (Ilg et al., ECCV 2018). `seen_ece`: the expected calibration error of `seen` over the whole picture.
    """
    if sure is None:
        return dict.fromkeys(NAMES, float("nan"))
    truth = by_maximum(intensity)
    power = float(np.vdot(albedo, albedo))
    scale = float(np.vdot(albedo, truth)) / power if power > 0 else 0.0
    scaled = truth / scale if scale > 0 else np.full(truth.shape, np.inf)
    top = max(float(albedo.max()), 1e-30)
    known = mask & np.isfinite(depth_m)
    high_a, low_a, high_z, low_z = sure.albedo_high, sure.albedo_low, sure.depth_high_m, sure.depth_low_m
    return {
        "albedo_coverage": _share((scaled >= low_a) & (scaled <= high_a), mask),
        "albedo_width": _mean((high_a - low_a) / top, mask),
        "albedo_ause": ause(np.abs(albedo - scaled)[mask], (high_a - low_a)[mask]),
        "depth_coverage": _share((true_m >= low_z) & (true_m <= high_z), known),
        "depth_width_m": _mean(high_z - low_z, known),
        "depth_ause": ause(np.abs(depth_m - true_m)[known], (high_z - low_z)[known]),
        "seen_ece": calibration_error(sure.seen, mask),
    }


def ause(error: npt.NDArray[np.floating], doubt: npt.NDArray[np.floating]) -> float:
    """The area between the mean error of what is left when the most doubtful go first and when the worst do, over the
    error's range; 0 where doubt orders as error does, NaN where nothing is to be ordered."""
    if not error.size or not np.isfinite(error).all() or not np.ptp(error) > 0:
        return float("nan")
    left = [max(1, round(error.size * (1 - k / STEPS))) for k in range(STEPS)]
    by_doubt = np.cumsum(error[np.argsort(doubt, kind="stable")])
    by_error = np.cumsum(np.sort(error))
    return float(np.mean([(by_doubt[n - 1] - by_error[n - 1]) / n for n in left]) / np.ptp(error))


def calibration_error(seen: Image, there: npt.NDArray[np.bool_]) -> float:
    """The mean distance, over ten bins of probability and weighted by their pixels, of the mean probability from the
    share of pixels with a surface."""
    place = np.minimum((seen * BINS).astype(np.int64), BINS - 1).ravel()
    told = np.bincount(place, weights=seen.ravel(), minlength=BINS)
    found = np.bincount(place, weights=there.ravel(), minlength=BINS)
    return float(np.abs(told - found).sum() / seen.size)


def _share(holds: npt.NDArray[np.bool_], where: npt.NDArray[np.bool_]) -> float:
    return float(holds[where].mean()) if where.any() else float("nan")


def _mean(width: npt.NDArray[np.floating], where: npt.NDArray[np.bool_]) -> float:
    return float(width[where].mean()) if where.any() else float("nan")
