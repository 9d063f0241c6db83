"""What is told beside what a scan tells is true, and the table has a line for each."""

import numpy as np
import pytest

from nlos.recon.methods.nano import Settings, build
from nlos.recon.training.dataset import _transient
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import measure
from nlos.recon.training.scenes import make_scene
from studies import any_noise, noise_limits
from studies.noise_figure import KINDS
from studies.noise_limits import SEED, drawn, main


def test_the_deviation_told_of_photons_is_the_root_of_their_counts_over_the_signal() -> None:
    data = DatasetSettings(seed=SEED, scenes=6, degradations=1, rows=16, cols=16)
    scans = drawn(build(Settings(), data.wall, data.time), data, 6)
    told = scans.told("deviation")[scans.kind == 0, -1]
    expected = []
    for number in range(1, 7):
        light = _transient(data, make_scene(SEED, number, data.wall), np.random.default_rng((SEED, number)))
        photons = KINDS["photons"].model_copy(update={"sparse": 0.0})
        got = measure(light, data.time, photons, np.random.default_rng((SEED, number, 0, 0)))
        counted = float(got.counts.mean())
        expected.append(np.log10(np.sqrt(counted) / (counted - got.background)))
    assert told == pytest.approx(expected, abs=0.1)


def test_the_table_has_a_line_for_each(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noise_limits, "LEARNED", 3)
    monkeypatch.setattr(noise_limits, "JUDGED", 2)
    monkeypatch.setattr(any_noise, "STEPS", 2)
    lines = main(16).splitlines()
    assert [line.split("|")[1].strip() for line in lines[2:]] == ["nothing", "peak", "deviation"]
