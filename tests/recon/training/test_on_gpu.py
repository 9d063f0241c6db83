"""Training for a GPU that is had for minutes, on the processor: the same scans, the same loss, weights that load."""

import itertools
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from nlos.recon.errors import ReconstructionFailed
from nlos.recon.training import on_gpu
from nlos.recon.training.dataset import sample, samples_of_scene
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.kept_scans import KeptScans
from nlos.recon.training.losses import LossSettings, losses
from nlos.recon.training.network import build
from nlos.recon.training.on_gpu import Steps, rate_at
from nlos.recon.training.prepared_feed import Made, Maker, Place, PreparedFeed, Recipe, Size
from nlos.recon.training.told import told
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.weights.files import load_weights, read_weights

GRID: dict[str, Any] = {"rows": 8, "cols": 8, "bins": 64, "bin_width_ps": 256.0}


def settings(**changes: Any) -> TrainSettings:
    given: dict[str, Any] = {
        "method": "nano",
        "method_settings": {"noise_weights": "nano", "channels": (4, 6, 8), "iterations": 1, "features": 2},
        "data": DatasetSettings(scenes=50, degradations=2, detector=DetectorSettings(slow=0.5, told=0.5), **GRID),
        "validation": DatasetSettings(seed=2, scenes=1, degradations=1, held_out=True, **GRID),
        "loss": LossSettings(picture=0.0, log_picture=0.15, depth=1.0),
        "samples": 12, "batch": 2, "cache": None, "pooled_share": 0.0, "precision": "float32",
    }  # fmt: skip
    return TrainSettings(**(given | changes))


def scans(count: int, of: TrainSettings) -> list[Made]:
    return list(itertools.islice(Maker(Recipe(of, "cpu")).scans(itertools.count()), count))


class OneScan:
    """A feed that hands out the same scan, once for each place."""

    def __init__(self, made: Made, places: int) -> None:
        self.made, self.left, self.back = made, [Place(0, slot) for slot in range(places)], 0

    def arrived(self) -> Iterator[tuple[Place, Size]]:
        for place in self.left:
            yield place, self.made.size
        self.left = []

    def next(self) -> tuple[Place, Size]:
        raise LookupError("nothing comes any more")

    def read(self, place: Place, size: Size) -> tuple[torch.Tensor, torch.Tensor]:
        return self.made.volumes.flatten(), self.made.others

    def give_back(self, place: Place) -> None:
        self.back += 1


def test_a_prepared_scan_has_the_loss_of_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    of = settings(batch=1)
    data = of.data.model_copy(update={"degradations": 1})
    of = of.model_copy(update={"data": data})
    torch.manual_seed(0)
    steps = Steps(of, "cpu")
    batches = [collate([sample(data, scene)]) for scene in range(20)]
    by_light = {round(float(batch["intensity"].sum()), 3): batch for batch in batches}
    for made in scans(8, of):
        for into, part in zip(steps.inputs(made.size), (made.volumes.flatten(), made.others), strict=True):
            into[0].copy_(part)
        steps.lost.zero_()
        steps.take(made.size, 0.0)
        batch = by_light[round(float(made.truth[0].sum()), 3)]
        network = build(of, data.wall, data.time)
        network.load_state_dict(steps.model.state_dict())
        monkeypatch.setattr(network, "reach", lambda net, deep=made.size.slices: (0, deep))
        seen = network(batch["counts"], batch["exposure"], *told(network, batch))
        own = float(losses(seen, batch, of.loss)["loss"].detach())
        assert float(steps.lost[0]) == pytest.approx(own, abs=0.002)  # volumes are handed over in half precision


def test_scans_are_learned_from_as_often_as_was_asked_in_all_mirror_images() -> None:
    of = settings()
    made = scans(1, of)[0]
    feed = OneScan(made, 8)
    kept = KeptScans(feed, "cpu", batch=2, capacity=5, uses=3.0, seed=0)  # type: ignore[arg-type]
    steps, images = Steps(of, "cpu"), set()
    for _ in range(3 * 8 // 2):
        size, rows, image = kept.next()
        assert size == made.size
        assert len(set(rows)) == 2
        assert max(rows) < 5
        inputs = steps.inputs(size)
        kept.put_into(inputs, size, rows, image)
        images.add(inputs[1][0].numpy().tobytes())
    with pytest.raises(LookupError):
        kept.next()
    assert (feed.back, kept.arrived) == (8, 8)
    assert len(images) > 3


def test_makers_that_died_are_told_of() -> None:
    with (
        PreparedFeed(Recipe(settings(), "no such device"), 1, 4) as feed,
        pytest.raises(ReconstructionFailed, match="died"),
    ):
        feed.next()


def test_samples_of_a_scene_are_those_by_their_numbers() -> None:
    data = settings().data
    for which, made in enumerate(samples_of_scene(data, 3)):
        assert (made.counts == sample(data, 6 + which).counts).all()


def test_the_rate_rises_and_falls_with_time() -> None:
    of = settings(learning_rate=1e-3, last_rate=1e-5)
    assert rate_at(of, 0.0) == 0.0
    assert rate_at(of, 0.02) == pytest.approx(1e-3, rel=0.01)
    assert rate_at(of, 1.0) == pytest.approx(1e-5)


def test_minutes_of_training_leave_weights_that_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    of = settings(pooled_share=0.5, last_rate=0.0005)
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump(of.model_dump(mode="json")))
    words = [str(file), str(tmp_path / "run"), "--minutes", "0.35", "--processes", "1", "--capacity", "40"]
    monkeypatch.setattr(sys, "argv", ["on_gpu", *words])
    on_gpu.main()
    lines = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    ends = [line for line in lines if "validation" in line]
    assert ends[0]["step"] == 0
    assert min(ends[-1]["step"], ends[-1]["scans"]) > 0, lines
    weights = tmp_path / "run" / "weights.safetensors"
    network = build(of, of.data.wall, of.data.time)
    load_weights(network, str(weights))
    assert read_weights(weights).about["samples"] == 2 * ends[-1]["step"]
    before, after = scans_and_weights(of), network.state_dict()
    assert any(not torch.equal(before[name], after[name]) for name in after)


def scans_and_weights(of: TrainSettings) -> dict[str, torch.Tensor]:
    torch.manual_seed(of.seed)
    return Steps(of, "cpu").model.state_dict()
