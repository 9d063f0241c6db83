"""LCT and f-k migration need no torch, and give the same pictures without it."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import PLAIN, find
from tests.command import nlos

WALL, TIME = WallGrid(1.0, 0.75, 18, 24), TimeAxis(96, 96e-12)
WITHOUT = "import sys; sys.modules['torch'] = None; from nlos.__main__ import run; sys.exit(run(sys.argv[1:]))"


def scene(kind: str) -> tuple[np.ndarray[Any, np.dtype[np.float32]], np.ndarray[Any, np.dtype[np.float64]]]:
    """Noisy counts of a small object, evenly, unevenly or sparsely exposed."""
    draw = np.random.default_rng(5)
    x, y = np.meshgrid(WALL.x_m(), WALL.y_m())
    distance = np.sqrt((x - 0.2) ** 2 + (y + 0.1) ** 2 + 0.5**2)
    rates = np.full((TIME.bins, WALL.rows, WALL.cols), 0.3)
    arrival = np.floor(2 * distance / 299792458.0 / TIME.bin_width_s).astype(int)
    np.put_along_axis(rates, arrival[None], 3 / distance[None] ** 4, 0)
    exposure_s = np.ones((WALL.rows, WALL.cols))
    if kind == "uneven":
        exposure_s = draw.uniform(0.2, 2.0, exposure_s.shape)
    elif kind == "sparse":
        exposure_s[draw.random(exposure_s.shape) < 0.7] = 0
    return draw.poisson(rates * exposure_s).astype(np.float32), exposure_s


@pytest.mark.parametrize("kind", ["even", "uneven", "sparse"])
@pytest.mark.parametrize("settings", [{}, {"falloff": 2, "snr": 0.2}, {"conventions": "authors"}], ids=str)
@pytest.mark.parametrize("name", PLAIN)
def test_numpy_gives_what_torch_gives(name: str, settings: dict[str, object], kind: str) -> None:
    counts, exposure_s = scene(kind)
    method = find(name)
    chosen = method.Settings.model_validate(settings, strict=False)
    with torch.inference_mode():
        expected = method.build(chosen, WALL, TIME)(
            torch.from_numpy(counts)[None, None], torch.from_numpy(exposure_s)[None]
        )
    plain = import_module(f"nlos.recon.without_torch.{name}").build(chosen, WALL, TIME)
    found = plain(counts, exposure_s)
    np.testing.assert_array_equal(plain.depths_m, find(name).build(chosen, WALL, TIME).depths_m)
    for ours, theirs in ((found.volume, expected.volume[0].numpy()), (found.albedo, expected.albedo[0].numpy())):
        assert ours.shape == theirs.shape
        assert np.abs(ours - theirs).max() <= 1e-5 * theirs.max()


@pytest.mark.parametrize("kind", ["even", "sparse"])
@pytest.mark.parametrize("name", PLAIN)
def test_numpy_undoes_a_response_as_torch_does(name: str, kind: str) -> None:
    counts, exposure_s = scene(kind)
    method, taps = find(name), np.array([0.0, 0.3, 0.4, 0.2, 0.1])
    with torch.inference_mode():
        expected = method.build(method.Settings(), WALL, TIME)(
            torch.from_numpy(counts)[None, None], torch.from_numpy(exposure_s)[None], torch.from_numpy(taps)[None]
        )
    found = import_module(f"nlos.recon.without_torch.{name}").build(method.Settings(), WALL, TIME)(
        counts, exposure_s, taps
    )
    theirs = expected.albedo[0].numpy()
    assert np.abs(found.albedo - theirs).max() <= 1e-5 * theirs.max()


@pytest.mark.parametrize("method", [*PLAIN, "nano"])
def test_the_command_line_reconstructs_where_torch_is_not_installed(tmp_path: Path, method: str) -> None:
    counts, _ = scene("even")
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["histograms"] = np.moveaxis(counts, 0, 2)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = TIME.bin_width_s, (WALL.width_m, WALL.height_m)
    words = ["reconstruct", "scan.h5", "--method", method]
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *words, "-o", "without"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if method == "nano":
        assert done.returncode == 2
        assert "pip install" in done.stderr
        return
    assert done.returncode == 0, done.stderr
    nlos(tmp_path, *words, "-o", "usual", check=True)
    with (
        h5py.File(tmp_path / "without" / "reconstruction.h5") as without,
        h5py.File(tmp_path / "usual" / "reconstruction.h5") as usual,
    ):
        expected = usual["albedo"][()]
        np.testing.assert_allclose(without["albedo"][()], expected, rtol=0, atol=1e-5 * float(expected.max()))
