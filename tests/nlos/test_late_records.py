"""Records that begin after time 0 hold their light to the end."""

from pathlib import Path

import numpy as np
import pytest

import nlos

BINS, BIN_S, LATE = 160, 64e-12, 60


def test_light_in_the_last_bins_of_a_record_that_begins_late_is_seen(tmp_path: Path) -> None:
    """As much of the record as it begins late used to be dropped at its end."""
    places = (np.arange(24) - 11.5) / 24
    distance_m = np.sqrt((places[None, :] - 0.1) ** 2 + (places[:, None] + 0.1) ** 2 + 1.85**2)
    at = np.floor(2 * distance_m / 299_792_458 / BIN_S).astype(int)
    assert BINS < at.min() < at.max() < BINS + LATE
    counts = np.zeros((24, 24, BINS + LATE))
    np.put_along_axis(counts, at[..., None], np.random.default_rng(0).poisson(300 / distance_m**4)[..., None], axis=2)
    np.savez(
        tmp_path / "late.npz", histograms=counts[..., LATE:].astype(np.uint32), wall_size_m=1.0,
        bin_width_s=BIN_S, offset_s=LATE * BIN_S, rectified=True,
    )  # fmt: skip
    picture = nlos.reconstruct(nlos.load(tmp_path / "late.npz"), method="lct")
    row, col = np.unravel_index(picture.albedo.argmax(), picture.albedo.shape)
    assert picture.depth_m[row, col] == pytest.approx(1.85, abs=0.02)
