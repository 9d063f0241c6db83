"""What is said of the noise is so: background, quality, and the choices that follow."""

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.recon.noise import estimate, first_lit_bin, without_background

TIME = TimeAxis(200, 32e-12)


def pulse(counts: float, background: float, points: int = 64, seed: int = 0) -> torch.Tensor:
    """(1, 1, T, H, W): a smooth pulse that wanders over the wall, Poisson."""
    t = np.arange(200)[:, None, None]
    delay = 80 + 30 * np.hypot(*np.meshgrid(np.linspace(-1, 1, points), np.linspace(-1, 1, points)))
    rate = counts * np.exp(-0.5 * ((t - delay) / 6) ** 2) + background
    return torch.from_numpy(np.random.default_rng(seed).poisson(rate).astype(np.float32))[None, None]


@pytest.mark.parametrize("background", [0.02, 0.3, 5.0])
def test_the_background_is_found(background: float) -> None:
    found = float(estimate(pulse(10, background), None, TIME).background)
    assert found == pytest.approx(background, rel=0.06, abs=0.006)  # the darkest stretch: a little below the mean


def test_cut_bins_take_no_part() -> None:
    counts = pulse(10, 0.5)
    counts[:, :, :60] = 0
    assert first_lit_bin(counts) == 60
    noise = estimate(counts, None, TIME)
    assert float(noise.background) == pytest.approx(0.5, rel=0.06)
    clean = without_background(counts, noise)
    assert float(clean[:, :, :60].abs().max()) == 0
    assert abs(float(clean[:, :, 150:].mean())) < 0.05


def test_quality_is_photons_whatever_the_unit_the_bins_or_the_part_of_the_wall() -> None:
    counts = pulse(20, 0.2)
    reference = float(estimate(counts, None, TIME).quality)
    assert float(estimate(counts * 1e-7, None, TIME).quality) == pytest.approx(reference, abs=1e-3)
    paired = counts.reshape(1, 1, 100, 2, 64, 64).sum(3)
    assert float(estimate(paired, None, TimeAxis(100, 64e-12)).quality) == pytest.approx(reference, abs=0.1)
    some = torch.zeros(1, 64, 64, dtype=torch.bool)
    some[:, 1::2, ::2] = True
    quarter = float(estimate(counts * some, some, TIME).quality)
    assert quarter == pytest.approx(reference - np.log10(4), abs=0.08)


def test_more_light_means_a_higher_snr_and_more_of_the_falloff_undone() -> None:
    found = [estimate(pulse(counts, 0.02 * counts), None, TIME) for counts in (1, 5, 20, 500)]
    snr, undone = [float(noise.snr()) for noise in found], [float(noise.undone()) for noise in found]
    assert snr == sorted(snr)
    assert undone == sorted(undone)
    assert undone[-1] == 1
    assert snr[0] < 0.1 < snr[-1]


def test_samples_of_a_batch_are_judged_apart() -> None:
    both = torch.cat([pulse(1, 0.02), pulse(100, 0.02)])
    together = estimate(both, None, TIME)
    for b in range(2):
        alone = estimate(both[b : b + 1], None, TIME)
        assert torch.allclose(together.quality[b], alone.quality[0])
