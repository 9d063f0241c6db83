"""The metrics are what their names say, checked against their formulas written out."""

import numpy as np
import pytest
import torch
import torch.nn.functional as functional

from nlos.recon.metrics import (
    best_scaled,
    by_maximum,
    correlation,
    depth_scores,
    image_scores,
    psnr,
    ssim,
)

RNG = np.random.default_rng(11)
TRUTH = RNG.uniform(size=(40, 50))
NOISY = TRUTH + RNG.normal(0, 0.1, TRUTH.shape)


def test_psnr_of_a_known_error() -> None:
    assert psnr(TRUTH, TRUTH) == pytest.approx(80)
    assert psnr(TRUTH + 0.1, TRUTH) == pytest.approx(-10 * np.log10(0.01 + 1e-8))


def test_ssim_is_that_of_the_gaussian_window_with_zero_padding() -> None:
    line = torch.exp(-0.5 * ((torch.arange(11).double() - 5) / 1.5) ** 2)
    window = (torch.outer(line, line) / line.sum() ** 2)[None, None]

    def mean(image: np.ndarray) -> np.ndarray:
        return functional.conv2d(torch.from_numpy(image)[None, None], window, padding=5)[0, 0].numpy()

    a, b = mean(NOISY), mean(TRUTH)
    variances = mean(NOISY**2) - a**2 + mean(TRUTH**2) - b**2
    covariance = mean(NOISY * TRUTH) - a * b
    expected = ((2 * a * b + 1e-4) * (2 * covariance + 9e-4) / ((a**2 + b**2 + 1e-4) * (variances + 9e-4))).mean()
    assert ssim(NOISY, TRUTH) == pytest.approx(expected, abs=1e-12)
    assert ssim(TRUTH, TRUTH) == pytest.approx(1)


def test_a_scaled_picture_scores_like_the_picture() -> None:
    first, second = image_scores(NOISY, TRUTH), image_scores(NOISY * 1e-9, TRUTH * 30)
    assert second == pytest.approx(first)
    assert first["psnr"] >= first["psnr_max"]
    assert first["corr"] == pytest.approx(np.corrcoef(NOISY.ravel(), TRUTH.ravel())[0, 1])


def test_best_scale_is_best() -> None:
    scaled = best_scaled(NOISY * 7, TRUTH)
    for factor in (0.99, 1.01):
        assert np.sum((scaled * factor - TRUTH) ** 2) > np.sum((scaled - TRUTH) ** 2)


def test_an_empty_prediction_has_scores_too() -> None:
    empty = np.zeros_like(TRUTH)
    assert np.isfinite(list(image_scores(empty, TRUTH).values())).all()
    assert correlation(empty, TRUTH) == 0
    assert by_maximum(empty).max() == 0


def test_depth_counts_what_has_no_depth_apart() -> None:
    truth, mask = np.full((4, 5), 1.0), np.zeros((4, 5), dtype=bool)
    mask[:2] = True
    depth = truth + 0.01
    depth[0, 0] = np.nan
    depth[1, 1] = 1.1
    scores = depth_scores(depth, truth, mask)
    assert scores["depth_missing"] == pytest.approx(0.1)
    assert scores["depth_median_abs_m"] == pytest.approx(0.01)
    assert scores["depth_mad_m"] == pytest.approx((8 * 0.01 + 0.1) / 9)
    assert scores["depth_rmse_m"] == pytest.approx(np.sqrt((8 * 0.01**2 + 0.1**2) / 9))
    nothing = depth_scores(np.full((4, 5), np.nan), truth, mask)
    assert nothing["depth_missing"] == 1
    assert np.isnan(nothing["depth_rmse_m"])
