"""Scans of few points, from shipped configurations to NANO's picture: held against where the bench has its letters."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.configs.load import load
from nlos.drivers.bench_settings import BenchSettings
from tests.command import nlos


@pytest.mark.parametrize("scan", ["demo", "five_by_five"])
def test_letters_are_where_the_bench_has_them(scan: str, tmp_path: Path) -> None:
    nlos(tmp_path, "scan", scan, "-o", "run.h5", "-q", check=True)
    made = nlos(tmp_path, "reconstruct", "run.h5", "--method", "nano", "-o", "out", "--no-volume", "--json", check=True)
    with h5py.File(tmp_path / "out" / "reconstruction.h5") as file:
        albedo, depth_m, x_m = (file[name][()] for name in ("albedo", "depth_m", "x_m"))
    letters = load("bench", "simulated", BenchSettings).settings.simulation.scene.objects
    assert len(letters) == 2
    assert json.loads(made.stdout)["intervals_to_m"] > max(letter.centre_m[2] for letter in letters)
    for letter in letters:
        side = np.sign(x_m) == np.sign(letter.centre_m[0])
        light, depth, x = albedo[:, side], depth_m[:, side], np.broadcast_to(x_m[side], albedo[:, side].shape)
        bright = (light > 0.4 * light.max()) & np.isfinite(depth)
        assert np.average(x[bright], weights=light[bright]) == pytest.approx(letter.centre_m[0], abs=0.05)
        assert np.median(depth[bright]) == pytest.approx(letter.centre_m[2], abs=0.02)
