"""One set of weights on several grids: what is compared with what."""

import numpy as np
import pytest

from studies.grid_study import COARSEST, study
from studies.results.studies import grid_table


def test_pictures_are_compared_on_their_own_pixels_and_on_those_of_the_coarsest_grid() -> None:
    fine, coarse = study("nano", 1, ((64, 256), (COARSEST, 256)))
    assert coarse.psnr == pytest.approx(coarse.psnr_coarse)
    assert fine.psnr_coarse > fine.psnr > 10
    assert np.isfinite([fine.depth_mad_m, coarse.depth_mad_m]).all()
    last = grid_table({"nano": [fine.__dict__, coarse.__dict__]}).splitlines()[-1]
    assert last.split(" | ")[:4] == ["| 32", "256", f"{coarse.psnr:.2f}", f"{coarse.psnr - fine.psnr:+.2f}"]


def test_finer_bins_hold_the_same_photons() -> None:
    trained, finer = study("nano", 1, ((64, 256), (64, 1024)))
    assert finer.psnr == pytest.approx(trained.psnr, abs=1e-3)  # NANO adds bins finer than it was trained on
