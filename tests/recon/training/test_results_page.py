"""Held-out scene files in the layout that evaluation reads, and the page of results made from its figures."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from acquisition.transient import TimeAxis
from acquisition.wall import WallGrid
from recon.training.checkpoint import save
from recon.training.results_page import page, training
from recon.training.scene_files import write_scene


def row(method: str, scene: str, condition: str, psnr: float) -> dict[str, object]:
    figures = {"psnr": psnr, "psnr_max": psnr - 1, "ssim": 0.5, "depth_mad_m": 0.01, "depth_rmse_m": None}
    return {"method": method, "scene": scene, "condition": condition, **figures}


def test_the_page_shows_means_margins_and_gaps(tmp_path: Path) -> None:
    rows = [row("lct", "a", "c1", 10), row("lct", "b", "c1", 20), row("lfe", "a", "c1", 16), row("lfe", "b", "c1", 18)]
    rows += [row("lct", "a", "c2", 9)]
    folder = tmp_path / "synthetic"
    folder.mkdir()
    (folder / "results.json").write_text(json.dumps(rows))
    text = page([folder / "results.json"])
    assert "## synthetic" in text
    assert "| lfe | +2.00 | - |" in text
    assert "| lct | 15.00 | 9.00 |" in text
    assert "| a | 10.00 | 16.00 |" in text
    assert "| lct | - | - |" in text  # no depth error was measured


def test_the_cost_of_training_comes_from_the_weights_themselves(tmp_path: Path) -> None:
    about = {"samples": 3000, "hours": 0.5, "device": "cpu", "threads": 1, "validation": {"psnr": 18.25}}
    save(tmp_path / "lfe.safetensors", {"a": torch.zeros(3, 4)}, about)
    assert "| lfe | 12 | 3,000 | 0.50 | cpu, threads: 1 | 18.25 |" in training(["lct", "lfe"], tmp_path)
    assert "No weights" in training(["lct"], tmp_path)


@pytest.mark.parametrize("kind", ["signs", "shelves"])
def test_a_held_out_scene_file_has_the_layout_of_the_test_scenes(tmp_path: Path, kind: str) -> None:
    write_scene(tmp_path / "s.h5", kind, 0, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    with h5py.File(tmp_path / "s.h5") as file:
        assert file["transient"].shape == (16, 16, 128)
        assert file["transient"][...].max() == 1
        assert file.attrs["bin_width_s"] == 128e-12
        peaks = {n: file[f"counts_p{n}"][...].max(axis=2).mean() for n in (20, 5, 1)}
        assert peaks[20] > peaks[5] > peaks[1]
        assert peaks[20] == pytest.approx(20, rel=0.35)
        depth, mask = file["gt_depth"][...], file["gt_mask"][...]
        assert (depth[mask > 0] > 0).all()
        assert np.isfinite(file["gt_intensity"][...]).all()
