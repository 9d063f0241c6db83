"""NANO: the same picture for every count unit, wall and grid; nothing out of nothing; every switch trains."""

import hashlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from nlos.acquisition.errors import StorageError
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidSettings
from nlos.recon.layers.rates import rates_of
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.reconstruct import reconstruct
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import make_scene, surfels
from nlos.recon.weights import files
from nlos.recon.weights.files import save
from tests.recon.methods.one_point import shell

WALL = WallGrid(2.0, 2.0, 16, 16)
TIME = TimeAxis(64, 128e-12)
SMALL = {"weights": None, "channels": (4, 6, 8), "features": 3}


def network(**settings: object) -> Nano:
    torch.manual_seed(0)
    made = build(Settings.model_validate(SMALL | settings), WALL, TIME)
    torch.nn.init.normal_(made.projection.finish.head.weight, std=0.02)  # type: ignore[union-attr,arg-type]
    return made.eval()


@pytest.mark.parametrize("unit", [7, 1000])
def test_the_picture_does_not_depend_on_the_count_unit(unit: int) -> None:
    torch.manual_seed(0)
    method = build(Settings.model_validate(SMALL | {"lifting": "both"}), WALL, TIME).eval()
    counts = shell(WALL, TIME)
    with torch.no_grad():
        one, other = method(counts), method(unit * counts)
    for a, b in zip(one[:3], other[:3], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3, equal_nan=True)


@pytest.mark.parametrize("rate", [0.0, 0.02, 5.0])
def test_nothing_and_noise_give_an_empty_picture(rate: float) -> None:
    counts = torch.poisson(torch.full((1, 1, 64, 16, 16), rate), generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        albedo, depth_m, volume, *_ = network()(counts)
    assert albedo.abs().max() == 0
    assert torch.isnan(depth_m).all()
    assert volume.abs().max() == 0


def test_a_scaled_bench_gives_the_same_picture() -> None:
    small, large = (
        build(Settings.model_validate(SMALL), WallGrid(w, w, 16, 16), TimeAxis(64, 64e-12 * w)) for w in (0.5, 2.0)
    )
    large.load_state_dict(small.state_dict())
    counts = shell(WALL, TIME)
    with torch.no_grad():
        a, b = small.eval()(counts), large.eval()(counts)
    torch.testing.assert_close(a[0], b[0], rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(4 * a[1], b[1], rtol=1e-3, atol=1e-3, equal_nan=True)


@pytest.mark.parametrize(
    ("wall", "time"),
    [
        (WallGrid(2.0, 2.0, 32, 32), TIME),
        (WallGrid(1.0, 0.6, 20, 12), TimeAxis(100, 64e-12)),
        (WallGrid(0.7, 0.7, 9, 9), TimeAxis(300, 16e-12, -1e-10)),
        (WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 64e-12, 1e-9)),
    ],
)
def test_one_set_of_weights_serves_every_geometry(wall: WallGrid, time: TimeAxis) -> None:
    settings = Settings.model_validate(SMALL | {"lifting": "both"})
    method, other = build(settings, WALL, TIME), build(settings, wall, time)
    other.load_state_dict(method.state_dict())
    with torch.no_grad():
        albedo, depth_m, volume, *_ = other.eval()(shell(wall, time))
    assert albedo.shape == depth_m.shape == (1, wall.rows, wall.cols)
    assert volume.shape == (1, len(other.depths_m), wall.rows, wall.cols)
    assert torch.isfinite(albedo).all()


@pytest.mark.parametrize("dim", [-1, -2])
def test_a_mirrored_scan_gives_the_mirrored_picture(dim: int) -> None:
    method, counts = network(), shell(WALL, TIME)
    with torch.no_grad():
        albedo, depth_m, volume, *_ = method(counts)
        mirror = method(counts.flip(dim))
        turned = method(counts.transpose(-1, -2))
    torch.testing.assert_close(mirror[0], albedo.flip(dim), rtol=1e-3, atol=1e-3)
    torch.testing.assert_close(mirror[1], depth_m.flip(dim), rtol=1e-3, atol=1e-3, equal_nan=True)
    torch.testing.assert_close(turned[2], volume.transpose(-1, -2), rtol=1e-3, atol=1e-3)


def test_depths_lie_where_the_light_says() -> None:
    method = network()
    with torch.no_grad():
        albedo, depth_m, *_ = method(shell(WALL, TIME))
    brightest = int(albedo.argmax())
    assert abs(float(depth_m.flatten()[brightest]) - 1.0) < 0.1


def test_points_that_were_not_measured_are_not_looked_at() -> None:
    exposure = torch.ones(1, 16, 16, dtype=torch.float64)
    exposure[:, 1::2] = 0
    counts = shell(WALL, TIME)
    wrong = torch.where(exposure[:, None, None] > 0, counts, 1e4)
    with torch.no_grad():
        a, b = network()((counts * exposure[:, None, None]).float(), exposure), network()(wrong, exposure)
    torch.testing.assert_close(a[0], b[0])


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    "switches",
    [{"lifting": lifting} for lifting in ("none", "mlp", "global", "local", "both")]
    + [{"projection": False}, {"nle": False}, {"sfe": True}, {"outer_iterations": 3}, {"spectral_scales": 0}],
)
def test_every_switch_trains(switches: dict[str, object]) -> None:
    torch.manual_seed(0)
    method = build(Settings.model_validate(SMALL | switches), WALL, TIME).train()
    albedo, depth_m, volume, *_ = method(shell(WALL, TIME))
    (albedo.square().mean() + depth_m.mean() + volume.mean()).backward()
    gradients = [p.grad for name, p in method.named_parameters() if name.startswith("unfolding.")]
    assert all(g is None or torch.isfinite(g).all() for g in gradients)
    assert any(g is not None and g.abs().max() > 0 for g in gradients)
    assert all(p.grad is None for name, p in method.named_parameters() if name.startswith("noise_level."))


def test_noise_estimation_trains_alone_and_can_be_taken_over(tmp_path: Path) -> None:
    method = build(Settings.model_validate(SMALL | {"stage": "noise"}), WALL, TIME).train()
    batch = {
        "counts": shell(WALL, TIME),
        "exposure": torch.ones(1, 16, 16),
        "noise_level": torch.tensor([0.1]),
        "noise_map": torch.full((1, 16, 16), 0.1),
    }
    assert method.training_loss is not None
    method.training_loss(batch)["loss"].backward()  # type: ignore[no-untyped-call]
    assert {name.split(".")[0] for name, p in method.named_parameters() if p.grad is not None} == {"noise_level"}
    save(tmp_path / "noise.safetensors", dict(method.named_parameters()), {})
    other = build(Settings.model_validate(SMALL | {"noise_weights": str(tmp_path / "noise.safetensors")}), WALL, TIME)
    assert other.training_loss is None
    for a, b in zip(method.noise_level.parameters(), other.noise_level.parameters(), strict=True):
        assert torch.equal(a, b)
        assert not b.requires_grad


def test_depths_before_the_first_light_are_left_out_of_films() -> None:
    wall, time = WallGrid(2.0, 2.0, 32, 32), TimeAxis(512, 32e-12)
    scene = surfels(make_scene(7, 3, wall), np.random.default_rng(0))
    light = render(scene, wall, time)
    light = 5 * light / light.amax(dim=0).mean() + 0.01
    counts = torch.poisson(light, generator=torch.Generator().manual_seed(0))[None, None]
    with torch.inference_mode():
        whole, part = (
            build(Settings(symmetries=False, from_first_light=on), wall, time).eval()(counts) for on in (False, True)
        )
        method = build(Settings(symmetries=False, from_first_light=True), wall, time).eval()
        given = method.prepared(counts, None)
    nearest_m = float(scene.position_m[:, 2].min())
    assert 4 <= given.first <= np.searchsorted(method.depths_m, nearest_m) - 4
    assert part.volume is not None
    assert whole.volume is not None
    assert part.volume.shape == whole.volume.shape
    assert not part.volume[:, : given.first].any()
    assert float((part.albedo - whole.albedo).norm() / whole.albedo.norm()) < 0.15
    bright = (whole.albedo > 0.3) & (part.albedo > 0.3)
    assert float((part.depth_m - whole.depth_m)[bright].abs().median()) < 0.01


def test_depths_behind_the_last_light_are_left_out() -> None:
    wall, time = WallGrid(0.5, 0.5, 16, 16), TimeAxis(256, 32e-12)
    torch.manual_seed(0)
    method = build(Settings.model_validate(SMALL), wall, time).eval()
    near = shell(wall, time)
    dark = method.prepared(near, None)[0].new_zeros(1, 1, method.physics.bins, 16, 16)
    assert method.reach(dark) == (0, len(method.depths_m))
    volumes = method.prepared(near, None)[0]
    assert 80 <= volumes.shape[2] < len(method.depths_m)
    with torch.no_grad():
        _, _, volume, *_ = method(near)
    assert volume.shape[1] == len(method.depths_m)
    assert volume[:, volumes.shape[2] :].abs().max() == 0


def test_less_falloff_is_undone_for_retroreflectors() -> None:
    diffuse, retroreflective = (
        build(Settings.model_validate(SMALL | {"falloff": f}), WALL, TIME).eval() for f in (4, 2)
    )
    rates, level = rates_of(torch.rand(1, 1, diffuse.physics.bins, 16, 16), None), torch.tensor([-2.0])
    squared = diffuse.physics.relative[:, None, None] ** 2
    divided = replace(rates, net=rates.net / squared.clamp(min=1e-6))
    expected = diffuse.physics(divided, level)
    torch.testing.assert_close(retroreflective.physics(rates, level), expected, rtol=1e-3, atol=1e-4)


def test_a_reconstruction_names_the_weights_it_was_made_with(tmp_path: Path) -> None:
    path = tmp_path / "small.safetensors"
    save(path, dict(network().named_parameters()), {})
    transient = Transient(shell(WALL, TIME)[0, 0].numpy(), np.ones((16, 16)), WALL, TIME)
    done = reconstruct(transient, "nano", SMALL | {"weights": str(path)})
    assert done.weights_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert reconstruct(transient, "lct").weights_sha256 is None

    other = {name: 0.9 * tensor for name, tensor in network().named_parameters()}
    save(path, other, {})  # as a training that goes on does
    again = reconstruct(transient, "nano", SMALL | {"weights": str(path)})
    assert again.weights_sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert not np.array_equal(again.albedo, done.albedo)


def test_weights_that_change_while_a_picture_is_made_by_them_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, one = tmp_path / "small.safetensors", dict(network().named_parameters())
    save(path, one, {})
    transient = Transient(shell(WALL, TIME)[0, 0].numpy(), np.ones((16, 16)), WALL, TIME)
    put = files.put_weights

    def put_while_a_training_writes(*given: Any) -> None:
        put(*given)
        save(path, one, {"samples": 2})

    monkeypatch.setattr(files, "put_weights", put_while_a_training_writes)
    with pytest.raises(InvalidSettings, match="has changed while a picture was made"):
        reconstruct(transient, "nano", SMALL | {"weights": str(path)})


def test_weights_that_are_cut_while_they_are_read_end_no_process(tmp_path: Path) -> None:
    """Of a mapped file that ends early the system tells by a signal, which nothing survives."""
    path = tmp_path / "small.safetensors"
    save(path, {"a": torch.zeros(100)}, {"samples": 2})
    whole = path.read_bytes()
    assert files.read_about(path) == {"samples": 2}
    for size in (0, 7, 8, 20, len(whole) - 1):
        path.write_bytes(whole[:size])
        with pytest.raises(files.WeightsError, match="not a readable safetensors file"):
            files.read_weights(path)
    path.unlink()
    path.symlink_to("/proc/self/mem")  # of which the first byte is an error of the disk's
    if path.exists():
        for read in (files.read_weights, files.read_about):
            with pytest.raises(StorageError, match="says nothing about what is in it"):
                read(path)


def test_the_weights_that_ship_see_a_point_where_it_is_in_any_count_unit() -> None:
    wall = WallGrid(2.0, 1.5, 24, 19)
    method, counts = build(Settings(symmetries=False), wall, TIME), shell(wall, TIME)
    with torch.no_grad():
        one, many, none = method(counts), method(1000 * counts), method(torch.poisson(torch.full_like(counts, 3.0)))
    row, col = divmod(int(one[0].argmax()), wall.cols)
    assert abs(wall.x_m()[col] - 0.2) < 0.2
    assert abs(wall.y_m()[row]) < 0.2
    assert abs(float(one[1][0, row, col]) - 1.0) < 0.05
    for a, b in zip(one, many, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-4, equal_nan=True)
    assert none[0].abs().max() == 0
