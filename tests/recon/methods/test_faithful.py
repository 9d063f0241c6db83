"""NANO as it is printed: what its parts start from, what they depend on, and that every reading of it trains."""

from pathlib import Path

import pytest
import torch
import torch.nn.functional as F

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.noise_level import NoiseLevel
from nlos.recon.layers.rates import rates_of
from nlos.recon.methods.faithful import Faithful, Settings, brightness, build, halved
from nlos.recon.methods.nano import Nano
from nlos.recon.methods.nano import Settings as NanoSettings
from nlos.recon.methods.nano import build as build_nano
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.weights.files import WeightsError, save
from tests.recon.methods.one_point import shell

WALL = WallGrid(2.0, 2.0, 16, 16)
TIME = TimeAxis(64, 128e-12)
SMALL = {"weights": None, "channels": (4, 6, 8), "sfe_bandwidth": 12}


def network(**settings: object) -> Faithful:
    torch.manual_seed(0)
    return build(Settings.model_validate(SMALL | settings), WALL, TIME).eval()


def silence(module: torch.nn.Module, *parts: str) -> None:
    """All parameters whose names hold one of `parts` to zero."""
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            if any(part in name for part in parts):
                parameter.zero_()


STEPS = (".convolution.", "prolong.", "aggregate.", "encoded.")


@torch.inference_mode()
def test_with_its_steps_at_zero_the_paper_s_network_is_the_regularised_inverse() -> None:
    method, counts = network(), shell(WALL, TIME)
    silence(method.unfolding, *STEPS)
    _, _, volume = method(counts)
    physics = method.physics
    rates = rates_of(physics.rebin(counts), None)
    level = method.noise(rates)
    inverse = physics.inverse(physics.squared(physics.slices(rates.net), level), level)
    inverse = halved(inverse / brightness(physics.metric(inverse))[:, None, None, None, None])
    expected = F.interpolate(physics.metric(inverse)[:, 0], size=(16, 16), mode="bilinear", align_corners=False)
    torch.testing.assert_close(volume, expected, rtol=1e-3, atol=1e-3)


@torch.inference_mode()
def test_with_its_networks_at_zero_nano_is_the_regularised_inverse_under_its_own_attention() -> None:
    torch.manual_seed(0)
    method = Nano(NanoSettings(weights=None, channels=(4, 6, 8), symmetries=False), WALL, TIME).eval()
    silence(method, "head.", "projection.finish.")
    counts = shell(WALL, TIME)
    volumes = method.prepared(counts, None)[0]
    weight = torch.softmax(4.0 * volumes[:, 0], dim=1)
    expected = 0.8 * (weight * volumes[:, 0]).sum(dim=1)
    torch.testing.assert_close(method(counts)[0], expected.clamp(0, 1), rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("unit", [7, 1000])
@torch.inference_mode()
def test_the_picture_does_not_depend_on_the_count_unit(unit: int) -> None:
    method, counts = network(), shell(WALL, TIME)
    for a, b in zip(method(counts), method(unit * counts), strict=True):
        torch.testing.assert_close(a, b, rtol=1e-3, atol=1e-3, equal_nan=True)


@torch.inference_mode()
def test_depths_lie_where_the_light_says() -> None:
    method = network()
    silence(method.unfolding, *STEPS)
    albedo, depth_m, _ = method(shell(WALL, TIME))
    row, col = divmod(int(albedo.argmax()), 16)
    assert abs(WALL.x_m()[col] - 0.2) <= 0.13
    assert abs(WALL.y_m()[row]) <= 0.13
    assert abs(float(depth_m[0, row, col]) - 1.0) < 0.1


@pytest.mark.parametrize(
    ("wall", "time"),
    [
        (WallGrid(2.0, 2.0, 32, 32), TIME),
        (WallGrid(1.0, 0.6, 21, 12), TimeAxis(100, 64e-12)),
        (WallGrid(0.7, 0.7, 9, 9), TimeAxis(300, 16e-12, -1e-10)),
        (WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 64e-12, 1e-9)),
    ],
)
@torch.inference_mode()
def test_one_set_of_weights_serves_every_geometry(wall: WallGrid, time: TimeAxis) -> None:
    other = build(Settings.model_validate(SMALL), wall, time).eval()
    other.load_state_dict(network().state_dict())
    albedo, depth_m, volume = other(shell(wall, time))
    assert albedo.shape == depth_m.shape == (1, wall.rows, wall.cols)
    assert volume.shape == (1, len(other.depths_m), wall.rows, wall.cols)
    assert torch.isfinite(albedo).all()


SWITCHES: list[dict[str, object]] = [
    {},
    {"lifting": "none"},
    {"lifting": "mlp"},
    {"lifting": "global"},
    {"lifting": "local"},
    {"projection": False},
    {"nle": False},
    {"sfe": False},
    {"outer_iterations": 3},
    {"start": "zero"},
    {"guide": "adjoint"},
    {"depth_axis": "metric"},
    {"depth_axis": "metric", "outer_iterations": 2},
    {"activation": "tanh"},
    {"operator_activation": "prelu"},
    {"restriction": "truncation", "whiten": True, "activation": "modrelu", "operator_activation": "modrelu"},
    {"prolongation": "transposed"},
    {"transport": "fixed", "nle": False},
    {"noise_estimate": "any_kind", "noise_weights": "nano"},
    {"embedding": "shared", "meeting": "concatenated", "operator_kernel": 3},
    {"meeting": "concatenated", "lifting": "none"},
    {"sfe_place": "beside", "sfe_redrawn": True},
    {"sfe_place": "beside", "sfe": False},
]


@pytest.mark.parametrize("switches", SWITCHES)
def test_every_reading_trains(switches: dict[str, object]) -> None:
    method = network(**switches).train()
    albedo, _, volume = method(shell(WALL, TIME))
    (albedo.square().mean() + volume.square().mean()).backward()
    for name, parameter in method.named_parameters():
        if name.startswith(("noise_level.", "any_noise.")):
            assert parameter.grad is None
        elif name.startswith("unfolding."):
            assert parameter.grad is not None, name
            assert torch.isfinite(parameter.grad).all(), name


@torch.inference_mode()
def test_the_noise_level_is_the_only_condition_and_it_conditions() -> None:
    method = network()
    prepared = torch.randn(1, 1, 64, 8, 8)
    lifted = torch.randn(1, 4, 64, 8, 8)
    quiet, loud = (method.one_pass(prepared, lifted, prepared, torch.tensor([level])) for level in (-2.0, 0.0))
    assert (quiet - loud).abs().max() > 1e-4 * quiet.abs().max()
    deaf = network(nle=False)
    quiet, loud = (deaf.one_pass(prepared, lifted, prepared, torch.tensor([level])) for level in (-2.0, 0.0))
    assert torch.equal(quiet, loud)


@torch.inference_mode()
def test_with_h_fixed_and_no_estimation_nothing_knows_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    counts = shell(WALL, TIME)

    def seen(level: float, **switches: object) -> torch.Tensor:
        method = network(**switches)
        monkeypatch.setattr(method, "noise", lambda rates: torch.tensor([level]))
        return method(counts).albedo

    knows_nothing = {"transport": "fixed", "nle": False}
    assert torch.equal(seen(-1.8, **knows_nothing), seen(-0.4, **knows_nothing))
    for left in ({"transport": "fixed"}, {"nle": False}):
        assert not torch.allclose(seen(-1.8, **left), seen(-0.4, **left), rtol=1e-3)


@torch.inference_mode()
def test_told_of_any_noise_it_is_told_what_nano_is(tmp_path: Path) -> None:
    grain = DetectorSettings(noiseless=1.0, uniform=0.0, sparse=0.0)
    data = DatasetSettings(
        seed=1, scenes=4, degradations=1, rows=32, cols=32, bins=128, bin_width_ps=128.0, detector=grain
    )
    wall, time = data.wall, data.time
    batch = collate([sample(data, 3)])
    counts = batch["counts"]
    asked = SMALL | {"noise_weights": "nano", "noise_estimate": "any_kind"}
    method = build(Settings.model_validate(asked), wall, time).eval()
    rates = rates_of(method.physics.rebin(counts), None)
    ships = build_nano(NanoSettings(), wall, time)
    expected = ships.noise(rates)[0]
    torch.testing.assert_close(method.noise(rates), expected)
    assert float(expected) == pytest.approx(float(batch["noise_level"].log10()), abs=0.1)
    photons = build(Settings.model_validate(asked | {"noise_estimate": "photons"}), wall, time)
    assert (photons.noise(rates) - expected).abs() > 0.1
    save(tmp_path / "kept.safetensors", method.state_dict(), {"method": "faithful"})
    again = asked | {"noise_weights": None, "weights": str(tmp_path / "kept.safetensors")}
    torch.testing.assert_close(build(Settings.model_validate(again), wall, time).noise(rates), expected)


def test_weights_without_an_estimate_of_any_noise_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.safetensors"
    save(other, {f"noise_level.{k}": x for k, x in NoiseLevel().state_dict().items()}, {"method": "nano"})
    with pytest.raises(WeightsError, match="comes without an estimate of noise of any kind"):
        network(noise_estimate="any_kind", noise_weights=str(other))


def test_m_is_drawn_anew_in_training_alone() -> None:
    method, counts = network(sfe_redrawn=True), shell(WALL, TIME)
    with torch.no_grad():
        assert torch.equal(method(counts).albedo, method(counts).albedo)
        method.train()
        assert not torch.equal(method(counts).albedo, method(counts).albedo)
        once = network().train()
        assert torch.equal(once(counts).albedo, once(counts).albedo)


@torch.inference_mode()
def test_an_operator_beside_the_encoding_adds_to_it() -> None:
    beside = network(sfe_place="beside").unfolding.encoded
    assert beside is not None
    u, lifted = (torch.randn(1, 8, 4, 4, 4, dtype=torch.complex64) for _ in range(2))
    guide, embedding = torch.randn_like(u), torch.randn(1, 8, 1, 1, 1, dtype=torch.complex64)
    assert beside.beside is not None
    expected = u + beside.convolution(guide + beside.encoding(u) + beside.beside(u, lifted, embedding))
    torch.testing.assert_close(beside(u, guide, lifted, embedding), expected)


@torch.inference_mode()
def test_a_second_pass_starts_from_the_first() -> None:
    counts = shell(WALL, TIME)
    method = network(start="zero")
    again = network(start="zero", outer_iterations=2)
    assert (method(counts)[2] - again(counts)[2]).abs().max() > 1e-3
