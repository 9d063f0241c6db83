"""What is not finite is never written, never shown, never counted as a picture that has stopped changing."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.layers.noise_level import NoiseLevel
from nlos.recon.live import LiveReconstruction
from nlos.recon.reconstruct import reconstruct
from nlos.recon.results import write_results
from nlos.recon.volume import Volume
from nlos.recon.weights.files import find_weights, read_weights, save

WALL, TIME = WallGrid(1.0, 1.0, 12, 12), TimeAxis(96, 100e-12)


@pytest.fixture
def transient() -> Transient:
    """A few photons of a plane."""
    counts = np.random.default_rng(1).poisson(0.05, (96, 12, 12)).astype(np.float32)
    counts[60:63] += 3
    return Transient(counts, np.ones((12, 12)), WALL, TIME)


@pytest.fixture
def broken(tmp_path: Path) -> str:
    """Weights as they are after a training that went wrong: one of their numbers is NaN."""
    weights = read_weights(find_weights("lfe"))
    tensors = {name: tensor.clone() for name, tensor in weights.tensors.items()}
    tensors["log_sharpness"][0] = torch.nan
    save(tmp_path / "broken.safetensors", tensors, weights.about)
    return str(tmp_path / "broken.safetensors")


def test_a_picture_that_is_not_finite_is_refused(transient: Transient, broken: str) -> None:
    with pytest.raises(ReconstructionFailed, match=r"lfe: numbers that are not finite: 144 of 144 \(brightness\)"):
        reconstruct(transient, "lfe", {"weights": broken})


def test_a_picture_that_is_not_finite_is_no_picture_without_change(transient: Transient, broken: str) -> None:
    live = LiveReconstruction("lfe", {"weights": broken})
    for samples in (50, 144):
        with pytest.raises(ReconstructionFailed):
            live.update(transient, samples)


@pytest.mark.parametrize("field", ["albedo", "depth_m", "volume"])
def test_a_result_that_is_not_finite_is_never_written(transient: Transient, tmp_path: Path, field: str) -> None:
    good = reconstruct(transient, "lct")
    assert good.volume is not None
    wrong = np.full_like(good.albedo, np.inf)
    volume = Volume(np.full_like(good.volume.albedo, np.nan), good.volume.depths_m, good.volume.wall)
    bad = replace(good, volume=volume) if field == "volume" else replace(good, **{field: wrong})
    with pytest.raises(ReconstructionFailed, match="not finite"):
        write_results(tmp_path / "out", bad)
    assert not (tmp_path / "out").exists()
    write_results(tmp_path / "out", replace(good, depth_m=np.full_like(good.depth_m, np.nan)))


@pytest.mark.parametrize("seed", range(4))
@torch.inference_mode()
def test_counts_less_their_background_have_a_finite_noise(seed: int) -> None:
    """Where noise outweighs the light, rates and their averages fall below 0."""
    rng = torch.Generator().manual_seed(seed)
    rates = torch.randn((1, 1, 64, 16, 16), generator=rng) * 10.0 ** (seed - 1)
    exposure = (torch.rand((1, 16, 16), generator=rng) < (0.06, 0.3, 1.0, 1.0)[seed]).float()
    eta, noise_map = NoiseLevel().eval()(rates * (exposure > 0)[:, None, None], exposure)
    assert torch.isfinite(eta).all()
    assert torch.isfinite(noise_map[exposure > 0]).all()
    assert torch.isinf(noise_map[exposure == 0]).all()
