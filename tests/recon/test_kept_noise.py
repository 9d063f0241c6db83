"""Between the looks whose noise level is found, it is told by their counts: as the network would have found it."""

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.kept_noise import EVERY, KeptNoise, kept_noise
from nlos.recon.layers.rates import rates_of
from nlos.recon.live import LiveReconstruction
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import make_scene, surfels

WALL, TIME = WallGrid(2.0, 2.0, 32, 32), TimeAxis(512, 32e-12)


@pytest.fixture(scope="module")
def network() -> Nano:
    """As it ships, for films."""
    made = build(Settings(symmetries=False, refine=False), WALL, TIME)
    return made.eval()


def _look(peak: float, seed: int) -> torch.Tensor:
    """Photons of one scene, (1, 1, T, H, W), so many in the brightest bin of a point on average."""
    scene = make_scene(7, 3, WALL)
    light = render(surfels(scene, np.random.default_rng(0)), WALL, TIME)
    light = peak * light / light.amax(dim=0).mean() + 0.01
    return torch.poisson(light, generator=torch.Generator().manual_seed(seed))[None, None]


def _noise(network: Nano, counts: torch.Tensor) -> tuple[float, torch.Tensor]:
    with torch.inference_mode():
        rebinned = network.physics.rebin(counts)
        level, noise_map = network.noise(rates_of(rebinned, None), rebinned)
    return float(level), noise_map[0]


@pytest.mark.parametrize("peaks", [(2.0, 2.0, 2.0), (2.0, 2.6, 1.6)])
def test_what_counts_tell_is_what_would_be_found(network: Nano, peaks: tuple[float, ...]) -> None:
    kept = KeptNoise()
    for seed, peak in enumerate(peaks):
        counts = _look(peak, seed)
        alone, map_alone = _noise(network, counts)
        with kept.in_use():
            told, map_told = _noise(network, counts)
        assert told == pytest.approx(alone, abs=0.04)
        assert float((map_told - map_alone).abs().mean()) < 0.08
        assert (told == alone) == (seed == 0)


def test_it_is_found_for_every_fourth_look_and_where_light_changed() -> None:
    kept, found = KeptNoise(), []

    def told(counts: float, where: str = "here") -> float:
        def find() -> tuple[torch.Tensor, torch.Tensor]:
            found.append(counts)
            return torch.tensor([-1.0]), torch.zeros(1, 2, 2)

        return float(kept.of(where, torch.tensor([counts]), find)[0])

    levels = [told(counts) for counts in (100.0, 125.0, 80.0, *[100.0] * (EVERY - 3), 110.0)]
    assert found == [100.0, 110.0]
    told_by_counts = [-1.0 - 0.5 * np.log10(1.25), -1.0 + 0.5 * np.log10(1.25)]
    assert levels == pytest.approx([-1.0, *told_by_counts, *[-1.0] * (EVERY - 2)])
    told(250.0)
    told(110.0, "on another grid")
    assert found[2:] == [250.0, 110.0]


def test_it_is_kept_for_the_frames_of_a_film_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    as_it_was = Nano._noise_everywhere

    def counted(self: Nano, rates: object) -> object:
        found.append(kept_noise())
        return as_it_was(self, rates)  # type: ignore[arg-type]

    monkeypatch.setattr(Nano, "_noise_everywhere", counted)
    live = LiveReconstruction("nano", {"refine": False, "symmetries": False})
    frames = [Transient(_look(2.0, seed)[0, 0].numpy(), np.ones((32, 32)), WALL, TIME) for seed in range(EVERY + 1)]
    for frame in frames:
        live.made_of_film(HalfGrid(frame, WALL), hurried=True)
    assert len(found) == 2
    assert kept_noise() is None
    live.update(frames[0], 1024)
    assert found[2:] == [None]
