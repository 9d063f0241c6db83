"""A wall finer than NANO learned on: in the large as the halved scan's picture, with its own detail."""

import numpy as np
import pytest
import torch

from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.fine_detail import in_the_large, with_detail
from nlos.recon.methods import nano
from nlos.recon.metrics import image_scores
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.dataset import DatasetSettings
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import front_view, make_scene, surfels

QUICK = nano.Settings(symmetries=False)


def test_what_the_halved_picture_can_tell_is_its_own_and_the_rest_is_not() -> None:
    draw = torch.Generator().manual_seed(3)
    smooth = torch.nn.functional.interpolate(
        torch.rand((1, 1, 4, 4), generator=draw) + 1, size=(32, 32), mode="bicubic"
    )
    coarse = torch.nn.functional.avg_pool2d(smooth, 2)[0]
    checks = ((torch.arange(32)[:, None] + torch.arange(32)) % 2 * 2.0 - 1)[None] * 0.1
    fine = 0.8 + checks  # flat in the large
    seen = with_detail(coarse, fine)
    halves = torch.nn.functional.avg_pool2d(seen[:, None], 2)[:, 0]
    assert np.corrcoef(halves.ravel(), coarse.ravel())[0, 1] > 0.99
    assert np.corrcoef((seen - smooth[:, 0] / smooth.max() * 0.9).ravel(), checks.ravel())[0, 1] > 0.8
    assert float(seen.max()) == float(fine.max())
    assert torch.equal(with_detail(torch.zeros(1, 16, 16), fine), fine)
    assert torch.equal(with_detail(None, fine), fine)
    assert not with_detail(coarse, torch.zeros_like(fine)).any()


def test_only_fine_walls_that_are_mostly_measured_are_halved() -> None:
    time = TimeAxis(64, 128e-12)
    assert not nano.build(QUICK, WallGrid(2.0, 2.0, 64, 64), time).halved
    assert not nano.build(QUICK, WallGrid(2.0, 2.0, 97, 96), time).halved
    network = nano.build(QUICK, WallGrid(2.0, 2.0, 96, 96), time).eval()
    (half,) = network.halved
    assert half.physics.wall == WallGrid(2.0, 2.0, 48, 48)
    assert all(a.data_ptr() == b.data_ptr() for a, b in zip(network.parameters(), half.parameters(), strict=True))
    assert not any(name.startswith("halved") for name in network.state_dict())
    sparse = torch.zeros(1, 96, 96)
    sparse[:, ::2, ::2] = 1
    assert in_the_large(network.halved, torch.zeros(1, 1, 64, 96, 96), sparse, None) is None


def test_a_finer_scan_is_no_worse_where_both_can_tell() -> None:
    def points(side: int) -> DatasetSettings:
        return DatasetSettings(rows=side, cols=side, bins=128, bin_width_ps=128.0)

    scene = make_scene(21, 4, points(96).wall)
    seen_db = {}
    for side in (96, 48):
        data = points(side)
        clean = render(surfels(scene, np.random.default_rng(0)), data.wall, data.time).numpy()
        level = 10 / clean.max(axis=0).mean()
        counts = torch.from_numpy(np.random.default_rng(1).poisson(level * clean + 0.05).astype(np.float32))
        network = nano.build(QUICK, data.wall, data.time).eval()
        with torch.inference_mode():
            first, again = (network(factor * counts[None, None]).albedo[0] for factor in (1, 7))
        # Rounding differs from processor to processor: 0.0011 of a brightest pixel was seen.
        assert float((first - again).abs().max()) < 3e-3 * float(first.max())
        picture = torch.nn.functional.adaptive_avg_pool2d(first[None], 48)[0].numpy()
        seen_db[side] = image_scores(picture, front_view(scene, points(48).wall).intensity)["psnr"]
    assert seen_db[96] > seen_db[48] - 0.1


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("exposure", "told"), [("even", True), ("uneven", False), ("a twelfth missing", True)])
def test_a_fine_walls_intervals_hold_its_picture(told: bool, exposure: str) -> None:
    data = DatasetSettings(rows=96, cols=96, bins=96, bin_width_ps=160.0)
    scene = make_scene(21, 5, data.wall)
    clean = render(surfels(scene, np.random.default_rng(0)), data.wall, data.time).numpy()
    draw = np.random.default_rng(2)
    dwell = {
        "even": np.ones((96, 96)),
        "uneven": draw.uniform(0.3, 2, (96, 96)),
        "a twelfth missing": (draw.random((96, 96)) > 1 / 12).astype(float),
    }[exposure]
    counts = draw.poisson((8 / clean.max(axis=0).mean() * clean + 0.05) * dwell).astype(np.float32)
    response = gaussian(300e-12, "told") if told else None
    seen = reconstruct(Transient(counts, dwell, data.wall, data.time, response), "nano", explain=False)
    assert seen.intervals is not None
    assert seen.response_used is told
    assert (seen.intervals.albedo_low <= seen.albedo).all()
    assert (seen.intervals.albedo_high >= seen.albedo).all()
    assert 0 <= seen.albedo.min() < seen.albedo.max() <= 1
    assert image_scores(seen.albedo, front_view(scene, data.wall).intensity)["psnr"] > 15
