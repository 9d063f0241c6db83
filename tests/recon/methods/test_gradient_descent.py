"""Steepest descent begins from nothing, which total variation neither smooths nor slows."""

import numpy as np

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.reconstruct import reconstruct


def test_total_variation_changes_no_first_step_and_every_later_one() -> None:
    counts = np.random.default_rng(0).poisson(3, (20, 6, 8)).astype(np.float32)
    scan = Transient(counts, np.ones((6, 8)), WallGrid(1.0, 1.0, 6, 8), TimeAxis(20, 100e-12))

    def volume(iterations: int, tv: float) -> np.ndarray:
        found = reconstruct(scan, "gradient_descent", {"iterations": iterations, "tv": tv}).volume
        assert found is not None
        return found.albedo

    np.testing.assert_array_equal(volume(1, 0.0), volume(1, 1.0))
    assert np.abs(volume(2, 0.0) - volume(2, 1.0)).max() > 1e-3 * volume(2, 0.0).max()
