"""Arrays of few points on a finer grid: where their points lie there, what comes back, and that pictures gain by it."""

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.interval_scores import interval_scores
from nlos.recon.layers.finer_grid import CELLS, FinerGrid
from nlos.recon.layers.rates import presence
from nlos.recon.method import MethodResult, sure
from nlos.recon.metrics import image_scores
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings

DETECTOR = DetectorSettings(sparse=0.0, peak_counts_most=60.0)


@pytest.mark.parametrize(("rows", "cols"), [(4, 4), (5, 5), (8, 8), (9, 15), (16, 16), (8, 64), (27, 27)])
def test_points_keep_their_places_on_the_wall(rows: int, cols: int) -> None:
    wall = WallGrid(1.5, 2.0, rows, cols)
    grid = FinerGrid.of_few(wall)
    assert (min(grid.wall.rows, grid.wall.cols), grid.wall.width_m) >= (CELLS, 1.5)
    x, y = (torch.from_numpy(each) for each in np.meshgrid(wall.x_m(), wall.y_m()))
    counts = torch.stack([x, y])[None, None]
    spread, exposure = grid.spread(counts, None)
    assert exposure is not None
    row, col = (at.numpy() for at in exposure[0].nonzero(as_tuple=True))
    assert len(row) == rows * cols
    assert np.allclose(spread[0, 0, 0].numpy()[row, col], grid.wall.x_m()[col])
    assert np.allclose(spread[0, 0, 1].numpy()[row, col], grid.wall.y_m()[row])


@pytest.mark.parametrize("points", [28, 32, 64])
def test_what_is_not_few_stays_as_it_is(points: int) -> None:
    wall = WallGrid(2.0, 2.0, points, points)
    grid, counts = FinerGrid.of_few(wall), torch.ones(1, 1, 4, points, points)
    assert grid == FinerGrid(wall)
    assert grid.spread(counts, None) == (counts, None)


def test_cells_are_gathered_by_brightness() -> None:
    grid = FinerGrid(WallGrid(1.0, 1.0, 3, 6), (3, 3))
    albedo, depth_m = torch.zeros(1, 3, 6), torch.full((1, 3, 6), torch.nan)
    albedo[0, 1, :2], depth_m[0, 1, :2] = torch.tensor([1.0, 0.5]), torch.tensor([1.0, 1.6])
    known = {"albedo_low": albedo / 2, "depth_low_m": depth_m.nan_to_num(3.0), "seen": (albedo > 0).float()}
    made = grid.gathered(sure(MethodResult(albedo, depth_m, torch.ones(1, 5, 3, 6)), known))
    assert made.albedo.tolist() == [[[1.0, 0.0]]]
    assert made.depth_m[0, 0, 0] == pytest.approx(1.2)
    assert made.depth_m[0, 0, 1].isnan()
    assert made.volume is not None
    assert made.volume.shape == (1, 5, 1, 2)
    held = made.intervals  # type: ignore[attr-defined]
    assert held["albedo_low"].tolist() == [[[0.5, 0.0]]]
    assert held["depth_low_m"][0, 0, 0] == pytest.approx(1.2, abs=1e-3)
    assert held["seen"][0, 0].tolist() == pytest.approx([2 / 9, 0])


def test_small_arrays_gain_and_their_intervals_hold() -> None:
    """Scenes of kinds that nothing learned from, of 8 to 16 points a side."""
    gain, scores = [], []
    for points, index in ((8, 5), (8, 7), (12, 1), (12, 8), (16, 0), (16, 3)):
        data = DatasetSettings(
            seed=8800 + points, rows=points, cols=points, degradations=1, scenes=10**6, held_out=True, detector=DETECTOR
        )
        made = sample(data, index)
        scan = Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), data.wall, data.time)
        now, before = (reconstruct(scan, "nano", {"finer_grid": finer}, explain=False) for finer in (True, False))
        assert now.albedo.shape == now.depth_m.shape == (points, points)
        psnr = [image_scores(each.albedo, made.intensity)["psnr"] for each in (now, before)]
        gain.append(psnr[0] - psnr[1])
        assert now.intervals is not None
        held = interval_scores(
            now.albedo, now.depth_m, now.intervals, made.intensity, made.depth_m, made.coverage >= 0.5
        )
        scores.append((held["albedo_coverage"], held["depth_coverage"]))
    print(gain, scores)
    assert np.mean(gain) > 2.5
    assert (np.mean(scores, axis=0) > 0.8).all()


@pytest.mark.parametrize("points", [5, 8])
def test_few_points_far_apart_see_light_at_times_of_their_own(points: int) -> None:
    rng, bins = np.random.default_rng(points), 256
    rate = np.full((bins, points, points), 0.5)
    for row in range(points):
        for col in range(points):
            rate[60 + 15 * row + 7 * col :, row, col][:12] += 3
    even = torch.ones(1, points, points)
    for scale in (1.0, 700.0):
        lit = torch.from_numpy(scale * rng.poisson(rate)[None, None]).float()
        assert presence(lit, even) == 1
        slope = np.linspace(1.2, 0.8, bins)[:, None, None] * rng.uniform(0.3, 2, (points, points))
        assert presence(torch.from_numpy(scale * rng.poisson(2 * slope)[None, None]).float(), even) == 0
