"""A scan unlike those that weights were trained on is said to be so, by what differs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import save
from nlos.recon.weights.outside import outside_range

GRID = {"rows": 8, "cols": 8, "bins": 32, "bin_width_ps": 256.0, "detector": {"noiseless": 0.0}}


def scan(counts: float = 20.0, width_m: float = 2.0, points: int = 8, bin_s: float = 256e-12) -> Transient:
    shape = (32, points, points)
    values = np.full(shape, counts, np.float32)
    return Transient(values, np.ones(shape[1:]), WallGrid(width_m, width_m, points, points), TimeAxis(32, bin_s))


@pytest.fixture
def weights(tmp_path: Path) -> str:
    trained = TrainSettings.model_validate({"method": "unet", "data": GRID}).model_dump(mode="json")
    save(tmp_path / "w.safetensors", {}, {"method": "unet", "settings": trained})
    return str(tmp_path / "w.safetensors")


@pytest.mark.parametrize("like", [{}, {"width_m": 1.0, "bin_s": 128e-12}, {"counts": 0.5}, {"counts": 300.0}])
def test_a_scan_of_their_range_needs_no_words(weights: str, like: dict[str, Any]) -> None:
    """A wall half as wide in bins half as long is the same in wall widths."""
    assert outside_range(weights, scan(**like), falloff=4) == ""


UNLIKE: dict[str, tuple[dict[str, Any], str]] = {
    "more points": ({"points": 16}, "16 x 16 points, trained on 8 x 8"),
    "a smaller wall": ({"width_m": 1.0}, "bins of 256 ps on 1 m, trained on 256 ps on 2 m"),
    "few photons": ({"counts": 0.0}, "0 counts at the peak, trained on 0.4 to 200"),
    "many photons": ({"counts": 9000.0}, "9e+03 counts at the peak, trained on 0.4 to 200"),
}


@pytest.mark.parametrize("how", UNLIKE)
def test_a_scan_outside_of_it_is_told_by_what_differs(weights: str, how: str) -> None:
    unlike, words = UNLIKE[how]
    assert words in outside_range(weights, scan(**unlike))


def test_response_and_surfaces_count_too(weights: str) -> None:
    slow = replace(scan(), response=gaussian(800e-12, "slow"))
    assert "a response of 800 ps on 2 m, trained on up to 120 ps on 2 m" in outside_range(weights, slow)
    assert "retroreflective surfaces, trained on diffuse ones" in outside_range(weights, scan(), falloff=2)


def test_values_that_are_no_counts_are_not_taken_for_few(weights: str) -> None:
    assert outside_range(weights, scan(0.01)) == ""


def test_weights_that_ship_and_those_that_do_not_say_are_let_be(tmp_path: Path) -> None:
    save(tmp_path / "old.safetensors", {}, {"method": "unet"})
    for name in ("nano", str(tmp_path / "old.safetensors"), str(tmp_path / "none.safetensors"), None):
        assert outside_range(name, scan(points=5)) == ""
