"""A method of one's own takes one short file that keeps the contract of `recon/method.py`."""

from pathlib import Path

import numpy as np
import pytest

import nlos.recon.methods
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import catalogue, parse_settings
from nlos.recon.reconstruct import reconstruct

EXAMPLE = Path(__file__).with_name("method_of_ones_own.py")
WALL, TIME = WallGrid(1.0, 0.5, 4, 8), TimeAxis(32, 100e-12)


@pytest.fixture
def _in_the_catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of methods with the example in it."""
    (tmp_path / "brightest.py").write_text(EXAMPLE.read_text(encoding="utf-8"), encoding="utf-8")
    monkeypatch.setattr(nlos.recon.methods, "__path__", [*nlos.recon.methods.__path__, str(tmp_path)])


def test_the_example_is_short() -> None:
    lines = [line for line in EXAMPLE.read_text(encoding="utf-8").splitlines() if line.strip()]
    assert len(lines) <= 30


@pytest.mark.usefixtures("_in_the_catalogue")
def test_a_file_with_settings_and_build_is_a_method() -> None:
    counts = np.zeros((32, 4, 8), np.float32)
    counts[20, 1, 5] = 9
    seen = reconstruct(Transient(counts, np.ones((4, 8)), WALL, TIME), "brightest", {"least_counts": 2})
    assert seen.albedo[1, 5] == 9
    assert seen.depth_m[1, 5] == pytest.approx(20.5 * 100e-12 * 299_792_458 / 2)
    assert np.isnan(seen.depth_m).sum() == 31
    assert seen.volume is None
    assert seen.settings == {"least_counts": 2}
    assert catalogue()["brightest"].startswith("The brightest return")
    assert parse_settings("brightest", {}).model_dump() == {"least_counts": 1.0}
