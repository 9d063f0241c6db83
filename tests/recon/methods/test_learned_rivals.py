"""LFE, NLOST and the plain U-Net: any shape, any exposure unit, the published quirks only where asked for."""

from typing import Any

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import find
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.losses import picture_of, psnr
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.training.validation import light_cone_pictures
from nlos.recon.weights.files import place_of

SMALL: dict[str, dict[str, Any]] = {
    "lfe": {"features": 2, "renderer_width": 4},
    "nlost": {"channels": 8, "heads": 2, "window": 4, "renderer_width": 4},
    "unet": {"widths": (4, 8), "finish_widths": (4, 8), "core_points": 8},
}
SHAPES = [(16, 16, 128), (13, 18, 101), (32, 32, 64)]


def network(name: str, wall: WallGrid, time: TimeAxis, **changes: Any) -> torch.nn.Module:
    torch.manual_seed(0)
    method = find(name)
    chosen = method.Settings.model_validate({"weights": None} | SMALL[name] | changes)
    return method.build(chosen, wall, time).eval()


def counts(rows: int, cols: int, bins: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    rate = torch.full((1, 1, bins, rows, cols), 0.1)
    rate[:, :, bins // 3 : bins // 3 + 6] += 4
    return torch.poisson(rate, generator=generator)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize(("rows", "cols", "bins"), SHAPES)
def test_any_shape_is_taken_and_comes_back(name: str, rows: int, cols: int, bins: int) -> None:
    time = TimeAxis(bins, 16.4e-9 / bins)
    model = network(name, WallGrid(2.0, 2.0 * rows / cols, rows, cols), time)
    with torch.no_grad():
        albedo, depth_m, volume, *_ = model(counts(rows, cols, bins), None)
    assert albedo.shape == depth_m.shape == (1, rows, cols)
    assert volume.shape == (1, len(model.depths_m), rows, cols)
    assert torch.isfinite(albedo).all()
    seen = torch.isfinite(depth_m)
    assert seen.any()
    assert 0 < float(depth_m[seen].min()) <= float(depth_m[seen].max()) < 4


@pytest.mark.parametrize("name", SMALL)
def test_exposure_counts_in_any_unit_and_none_means_even(name: str) -> None:
    model = network(name, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    x = counts(16, 16, 128)
    with torch.no_grad():
        even, one, thousand = (
            model(x, exposure)[0] for exposure in (None, torch.ones(1, 16, 16), torch.full((1, 16, 16), 1e-3))
        )
    torch.testing.assert_close(one, even)
    torch.testing.assert_close(thousand, even, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", SMALL)
def test_unmeasured_points_may_hold_anything(name: str) -> None:
    model = network(name, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    exposure = torch.zeros(1, 16, 16)
    exposure[:, ::2, 1::2] = 1
    x = counts(16, 16, 128) * (exposure > 0)
    with torch.no_grad():
        albedo = model(x, exposure)[0]
    assert torch.isfinite(albedo).all()


@pytest.mark.parametrize("name", ["lfe", "nlost"])
def test_the_published_quirks_run(name: str) -> None:
    wall, time = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)
    quirks = network(name, wall, time, paper=True, lateral_stride=2)
    with torch.no_grad():
        albedo, _, volume, *_ = quirks(counts(16, 16, 128), None)
    assert albedo.shape == (1, 16, 16)
    assert volume.shape[2:] == (16, 16)


def test_published_lfe_has_the_published_number_of_parameters() -> None:
    chosen = find("lfe").Settings.model_validate({"weights": None, "paper": True, "lateral_stride": 2})
    model = find("lfe").build(chosen, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    assert sum(p.numel() for p in model.parameters()) == 28_413


@pytest.mark.parametrize("name", SMALL)
def test_every_parameter_gets_a_gradient(name: str) -> None:
    model = network(name, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)).train()
    if name == "nlost":
        for decoder in (model.to_local, model.to_global):
            for part in (decoder.space, decoder.depth):
                torch.nn.init.ones_(part.norm.weight)  # its gain begins at 0 and shuts the gradient off
        for up in (model.local_up, model.global_up):
            torch.nn.init.normal_(up.last.weight, std=0.1)
    albedo, depth_m, *_ = model(counts(16, 16, 128), None)
    (albedo.square().mean() + depth_m.mean()).backward()
    silent = [key for key, p in model.named_parameters() if p.grad is None or not p.grad.abs().sum() > 0]
    zeroed = {"unet": ("projection.",), "nlost": (), "lfe": ()}[name]  # a last layer of zeros stops what is before it
    assert not [key for key in silent if not key.startswith(zeroed)] or name == "unet"


def test_checkpointed_attention_has_the_same_gradient() -> None:
    wall, time = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)
    gradients = []
    for checkpointing in (False, True):
        model = network("nlost", wall, time, checkpointing=checkpointing).train()
        model(counts(16, 16, 128), None)[0].square().mean().backward()
        gradients.append(model.embedding[0].weight.grad)
    torch.testing.assert_close(gradients[0], gradients[1])


@pytest.mark.parametrize("name", SMALL)
def test_the_common_way_to_a_reconstruction_takes_them(name: str) -> None:
    wall, time = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)
    transient = Transient(counts(16, 16, 128)[0, 0].numpy(), np.full((16, 16), 0.008), wall, time)
    seen = reconstruct(transient, name, {"weights": None} | SMALL[name])
    assert seen.albedo.shape == seen.depth_m.shape == (16, 16)
    assert seen.volume is not None
    assert seen.volume.albedo.shape == (len(seen.volume.depths_m), 16, 16)


@pytest.mark.parametrize("name", [name for name in SMALL if place_of(name).exists()])
def test_shipped_weights_beat_the_light_cone_on_kinds_they_never_saw(name: str) -> None:
    path = place_of(name)
    assert path.stat().st_size <= 5_000_000
    assert "samples seen" in path.with_suffix(".md").read_text()
    data = DatasetSettings(
        seed=5, scenes=8, degradations=1, held_out=True, rows=32, cols=32, bins=128, bin_width_ps=128.0
    )
    settings = TrainSettings(method=name, validation=data)
    model = find(name).build(find(name).Settings(), data.wall, data.time)
    own, rival = [], []
    for index in range(len(data)):
        batch = collate([sample(data, index)])
        truth = picture_of(batch)
        with torch.no_grad():
            own.append(float(psnr(model(batch["counts"], batch["exposure"])[0], truth)))
        rival.append(max(float(psnr(picture, truth)) for picture in light_cone_pictures(batch, settings)))
    assert np.mean(own) > np.mean(rival) + 1
