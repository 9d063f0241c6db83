"""How close a reconstruction is to the truth: the published metrics, and plain ones that are fair to noise.

Published (NLOST, Li et al., CVPR 2023): images in [0, 1], PSNR = -10 log10(mse + 1e-8), SSIM with an 11 x 11 Gaussian
of sigma 1.5 and zero padding, on a crop around the truth.
"""

import numpy as np
import numpy.typing as npt
from scipy.ndimage import correlate1d

Image = npt.NDArray[np.float32] | npt.NDArray[np.float64]


def psnr(prediction: Image, truth: Image) -> float:
    """Peak signal to noise ratio in dB for a peak of 1; at most 80."""
    return float(-10 * np.log10(np.mean((_double(prediction) - _double(truth)) ** 2) + 1e-8))


def ssim(prediction: Image, truth: Image) -> float:
    """Structural similarity for a range of 1, mean over the image (Wang et al. 2004)."""
    a, b = _double(prediction), _double(truth)
    mean_a, mean_b = _blurred(a), _blurred(b)
    variance_a = _blurred(a * a) - mean_a**2
    variance_b = _blurred(b * b) - mean_b**2
    covariance = _blurred(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * mean_a * mean_b + c1) * (2 * covariance + c2)
    return float(np.mean(similarity / ((mean_a**2 + mean_b**2 + c1) * (variance_a + variance_b + c2))))


def by_maximum(image: Image) -> npt.NDArray[np.float64]:
    """The image divided by its maximum; all zero stays all zero."""
    top = float(np.max(image))
    return _double(image) / top if top > 0 else np.zeros(image.shape)


def best_scaled(prediction: Image, truth: Image) -> npt.NDArray[np.float64]:
    """The prediction times the factor that brings it closest to the truth in least squares."""
    p, t = _double(prediction), _double(truth)
    energy = float(np.vdot(p, p))
    return p * (float(np.vdot(p, t)) / energy) if energy > 0 else np.zeros(p.shape)


def correlation(prediction: Image, truth: Image) -> float:
    """Pearson's coefficient over all pixels; 0 where one of the two is constant."""
    p, t = _double(prediction) - np.mean(prediction), _double(truth) - np.mean(truth)
    norm = float(np.linalg.norm(p) * np.linalg.norm(t))
    return float(np.vdot(p, t)) / norm if norm > 0 else 0.0


def image_scores(prediction: Image, truth: Image) -> dict[str, float]:
    """psnr and ssim on the full image after best scaling, the same after division by the maximum, and corr."""
    peak_one = by_maximum(truth)
    fair, published = best_scaled(prediction, peak_one), by_maximum(prediction)
    return {
        "psnr": psnr(fair, peak_one),
        "ssim": ssim(fair, peak_one),
        "psnr_max": psnr(published, peak_one),
        "ssim_max": ssim(published, peak_one),
        "corr": correlation(prediction, truth),
    }


def depth_scores(depth_m: Image, truth_m: Image, mask: npt.NDArray[np.bool_]) -> dict[str, float]:
    """Depth errors in metres over the masked pixels that have a depth, and the fraction that have none.

    rmse and mad (mean absolute deviation), as published, and the median of the absolute error; NaN where no pixel has
    a depth.
    """
    known = mask & np.isfinite(depth_m)
    inside = int(mask.sum())
    missing = 1 - int(known.sum()) / inside if inside else 0.0
    if not known.any():
        nan = float("nan")
        return {"depth_rmse_m": nan, "depth_mad_m": nan, "depth_median_abs_m": nan, "depth_missing": missing}
    error = np.abs(_double(depth_m)[known] - _double(truth_m)[known])
    return {
        "depth_rmse_m": float(np.sqrt(np.mean(error**2))),
        "depth_mad_m": float(np.mean(error)),
        "depth_median_abs_m": float(np.median(error)),
        "depth_missing": missing,
    }


def _double(image: Image) -> npt.NDArray[np.float64]:
    return np.asarray(image, dtype=np.float64)


def _blurred(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    kernel = np.exp(-0.5 * ((np.arange(11) - 5) / 1.5) ** 2)
    kernel /= kernel.sum()
    along_rows = correlate1d(image, kernel, axis=0, mode="constant")
    return np.asarray(correlate1d(along_rows, kernel, axis=1, mode="constant"), dtype=np.float64)
