"""Every training configuration that comes with the program is one that starts."""

from pathlib import Path

import pytest

from nlos.configs.load import load
from nlos.recon.training.batches import batch_at
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.network import build, objective
from nlos.recon.training.train_settings import TrainSettings

FOLDER = Path(__file__).parents[3] / "configs" / "train"
NAMES = sorted(path.stem for path in FOLDER.glob("*.yaml"))
SMALL = DatasetSettings(rows=16, cols=16, bins=64, bin_width_ps=256.0, scenes=1, degradations=2)


@pytest.mark.sampled(3)
@pytest.mark.parametrize("name", NAMES)
def test_a_configuration_takes_its_first_step(name: str) -> None:
    settings = load("train", name, TrainSettings).settings
    model = build(settings, SMALL.wall, SMALL.time)
    batch = batch_at(SMALL, None, settings.seed, 0, 1)
    loss = objective(model, batch, settings, "cpu")["loss"]
    loss.backward()  # type: ignore[no-untyped-call]
    assert any(p.grad is not None and p.grad.abs().max() > 0 for p in model.parameters())


@pytest.mark.parametrize("name", NAMES)
def test_no_configuration_trains_on_the_scenes_that_judge(name: str) -> None:
    settings = load("train", name, TrainSettings).settings
    assert settings.validation.held_out
    assert not settings.data.held_out
    assert settings.data.seed != settings.validation.seed
