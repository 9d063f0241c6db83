"""Decibels are of energies: of photons they follow from the counts alone, and no background is signal."""

import numpy as np
import pytest

from studies.snr import snr_db


@pytest.mark.parametrize("scale", [3.0, 30.0, 3000.0])
def test_photon_noise_has_the_decibels_that_its_counts_say(scale: float) -> None:
    rng = np.random.default_rng(1)
    transient = np.zeros((40, 30, 30))
    transient[15:18] = rng.uniform(0.5, 1, (3, 30, 30))
    background = 0.2 * scale
    counts = rng.poisson(scale * transient + background).astype(np.float32)
    expected = 10 * np.log10((scale * transient).__pow__(2).sum() / (scale * transient + background).sum())
    assert snr_db(counts, transient) == pytest.approx(expected, abs=0.2)
    seen = np.zeros((30, 30), dtype=bool)
    seen[::3, ::2] = True
    assert snr_db(counts, 7 * transient, seen) == pytest.approx(expected, abs=0.5)
