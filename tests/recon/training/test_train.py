"""Training: it learns, resumes bit for bit after a kill, and two processes follow the curve of one."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.log import Log
from nlos.recon.training.run_folder import STATE, WEIGHTS
from nlos.recon.training.schedule import learning_rate
from nlos.recon.training.ship import ship
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.described import describe_weights, summary
from nlos.recon.weights.files import WeightsError, load_weights, put_weights, read_weights, save

TINY: dict[str, Any] = {"rows": 16, "cols": 16, "bins": 64, "bin_width_ps": 256.0}
SCRIPT = """
import sys
from pathlib import Path
from nlos.recon.training.log import Log
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
train(TrainSettings.model_validate_json(sys.argv[2]), Path(sys.argv[1]), lambda line: None)
"""


def settings(cache: Path, **changes: Any) -> TrainSettings:
    given: dict[str, Any] = {
        "method": "unet",
        "method_settings": {"widths": (4, 8), "finish_widths": (8, 8), "core_points": 8},
        "data": DatasetSettings(scenes=6, **TINY),
        "validation": DatasetSettings(seed=2, scenes=2, degradations=1, held_out=True, **TINY),
        "samples": 24,
        "warm_up_steps": 3,
        "pooled_share": 0.5,
        "cache": str(cache),
    }
    return TrainSettings(**(given | changes))


@pytest.fixture(scope="session")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


def quiet(line: str) -> None:
    del line


def process(folder: Path, chosen: TrainSettings, **environment: str) -> subprocess.Popen[bytes]:
    words = [sys.executable, "-c", SCRIPT, str(folder), json.dumps(chosen.model_dump(mode="json"))]
    return subprocess.Popen(words, env=os.environ | {"OMP_NUM_THREADS": "1"} | environment)


def assert_equal_states(a: Path, b: Path) -> None:
    first, second = read_weights(a / STATE), read_weights(b / STATE)
    assert first.about["step"] == second.about["step"]
    assert first.tensors.keys() == second.tensors.keys()
    for name, tensor in first.tensors.items():
        assert torch.equal(tensor, second.tensors[name]), name


def test_a_run_stopped_and_resumed_ends_bit_equal(tmp_path: Path, cache: Path) -> None:
    whole = train(settings(cache), tmp_path / "whole", quiet)
    stopped = train(settings(cache, max_minutes=1e-5), tmp_path / "parts", quiet)
    assert stopped["step"] < whole["step"] == 12
    assert not stopped["finished"]
    resumed = train(settings(cache), tmp_path / "parts", quiet)
    assert resumed["finished"]
    assert resumed["validation"] == whole["validation"]
    assert_equal_states(tmp_path / "whole", tmp_path / "parts")
    lines = [json.loads(line) for line in (tmp_path / "parts" / "log.jsonl").read_text().splitlines()]
    assert [line["step"] for line in lines if "loss" in line] == list(range(1, 13))
    assert (tmp_path / "parts" / "loss.png").stat().st_size > 1000


def test_a_run_that_keeps_no_scenes_learns_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    few = DatasetSettings(scenes=4, degradations=1, **TINY)
    for cache in (tmp_path / "scenes", None):
        chosen = settings(tmp_path, data=few, samples=4).model_copy(
            update={"cache": None if cache is None else str(cache)}
        )
        train(chosen, tmp_path / f"{cache is None}", quiet)
    assert_equal_states(tmp_path / "True", tmp_path / "False")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["False", "True", "scenes"]


def test_a_run_killed_without_warning_ends_bit_equal(tmp_path: Path, cache: Path) -> None:
    chosen = settings(cache, samples=40, checkpoint_minutes=0.02)
    victim = process(tmp_path / "killed", chosen)
    deadline = time.monotonic() + 240
    while not (tmp_path / "killed" / STATE).exists():
        assert victim.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    victim.send_signal(signal.SIGKILL)
    victim.wait()
    assert process(tmp_path / "killed", chosen).wait(240) == 0
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    train(chosen, tmp_path / "whole", quiet)
    torch.set_num_threads(threads)
    assert_equal_states(tmp_path / "killed", tmp_path / "whole")


def pair(folder: Path, chosen: TrainSettings) -> list[subprocess.Popen[bytes]]:
    """Two processes that train together, as torchrun starts them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    shared = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port, "WORLD_SIZE": "2"}
    return [process(folder, chosen, RANK=str(rank), LOCAL_RANK=str(rank), **shared) for rank in (0, 1)]


def test_two_processes_follow_the_loss_of_one_also_when_they_are_killed_and_resume(tmp_path: Path, cache: Path) -> None:
    chosen = settings(cache, precision="float32", samples=60, checkpoint_minutes=0.02)
    victims = pair(tmp_path / "two", chosen)
    deadline = time.monotonic() + 240
    while not (tmp_path / "two" / STATE).exists():
        assert all(one.poll() is None for one in victims)
        assert time.monotonic() < deadline
        time.sleep(0.02)
    for one in victims:
        one.kill()
        one.wait()
    both = pair(tmp_path / "two", chosen)
    train(chosen, tmp_path / "one", quiet)
    assert [one.wait(240) for one in both] == [0, 0]
    curves = []
    for name in ("one", "two"):
        lines = [json.loads(line) for line in (tmp_path / name / "log.jsonl").read_text().splitlines()]
        curves.append([line["loss"] for line in lines if "loss" in line])
    assert len(curves[0]) == 30
    assert curves[1] == pytest.approx(curves[0], rel=5e-3)


def test_training_lowers_the_loss_and_weights_can_be_used(tmp_path: Path, cache: Path) -> None:
    chosen = settings(cache, samples=120, learning_rate=5e-3, data=DatasetSettings(scenes=2, **TINY), pooled_share=0.0)
    train(chosen, tmp_path, quiet)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    losses = [line["loss"] for line in lines if "loss" in line]
    assert sum(losses[-10:]) < 0.7 * sum(losses[:10])
    about = read_weights(tmp_path / WEIGHTS).about
    assert 0 < about["samples"] <= 120  # of the best validation, not the last step
    assert about["settings"]["method"] == "unet"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no modes")
def test_colleagues_who_read_the_folder_read_weights_and_scenes(tmp_path: Path) -> None:
    for mode in (0o755, 0o770):
        run, kept = tmp_path / f"run{mode}", tmp_path / f"scenes{mode}"
        for folder in (run, kept):
            folder.mkdir()
            folder.chmod(mode)
        train(settings(kept, samples=2, warm_up_steps=0), run, quiet)
        files = [run / "weights.safetensors", run / "state.safetensors"]
        assert {path.stat().st_mode & 0o777 for path in files} == {mode & 0o666}
        scenes = list(kept.rglob("*.safetensors"))
        assert scenes
        assert all(path.stat().st_mode & 0o777 == path.parent.stat().st_mode & 0o666 for path in scenes)


def test_a_run_that_is_killed_as_it_resumes_keeps_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.jsonl"
    lines = "".join(json.dumps({"step": step, "loss": 1 / step}) + "\n" for step in (1, 2, 3))
    path.write_text(lines + '{"step": 4, "lo')

    def killed(self: Path, target: Path) -> Path:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", killed)
        with pytest.raises(KeyboardInterrupt):
            Log(path, 2, active=True)
    assert path.read_text().startswith(lines)
    Log(path, 2, active=True)
    assert [json.loads(line)["step"] for line in path.read_text().splitlines()] == [1, 2]


def test_a_folder_with_another_run_is_refused(tmp_path: Path, cache: Path) -> None:
    train(settings(cache, samples=4), tmp_path, quiet)
    with pytest.raises(ValueError, match="learning_rate"):
        train(settings(cache, samples=4, learning_rate=0.1), tmp_path, quiet)


def test_the_rate_warms_up_and_ends_at_the_last_rate() -> None:
    chosen = settings(Path("unused"), samples=2000, warm_up_steps=100)
    rates = [learning_rate(chosen, step) for step in range(1000)]
    assert rates[0] == pytest.approx(chosen.learning_rate / 100)
    assert max(rates) == pytest.approx(chosen.learning_rate)
    assert rates[-1] == pytest.approx(chosen.last_rate, rel=0.01)


def test_weights_of_another_network_are_refused_by_name(tmp_path: Path) -> None:
    small, large = torch.nn.Linear(2, 3), torch.nn.Linear(2, 4)
    save(tmp_path / "w.safetensors", dict(small.named_parameters()), {"steps": 3})
    assert load_weights(small, str(tmp_path / "w.safetensors")) == {"steps": 3}
    with pytest.raises(WeightsError, match=r"bias is \(3,\), not \(4,\)"):
        load_weights(large, str(tmp_path / "w.safetensors"))
    with pytest.raises(WeightsError, match="extra is not of this network"):
        put_weights(small, dict(small.named_parameters()) | {"extra": torch.zeros(1)}, "here")
    save(tmp_path / "s.safetensors", {"average/weight": torch.zeros(3, 2)}, {"method": "unet"})
    with pytest.raises(WeightsError, match=r"the state of a training. Use weights\.safetensors"):
        load_weights(small, str(tmp_path / "s.safetensors"))
    with pytest.raises(WeightsError, match="the state of a training"):
        describe_weights(str(tmp_path / "s.safetensors"))
    assert summary(str(tmp_path / "s.safetensors"))["format"] == "training state"
    (tmp_path / "w.safetensors").write_bytes(b"no weights")
    with pytest.raises(WeightsError, match="not a readable safetensors file"):
        load_weights(small, str(tmp_path / "w.safetensors"))
    with pytest.raises(WeightsError, match="no weights 'nothing'"):
        load_weights(small, "nothing")


def test_finished_weights_are_shipped_with_a_card_and_unfinished_ones_are_not(tmp_path: Path, cache: Path) -> None:
    train(settings(cache, max_minutes=1e-5), tmp_path / "run", quiet)
    with pytest.raises(WeightsError, match="not finished"):
        ship(tmp_path / "run", "small", tmp_path)
    stopped = ship(tmp_path / "run", "stopped", tmp_path, half=True, unfinished=True)
    words = stopped.with_suffix(".md").read_text()
    assert "2 of 24: stopped there, in 1 steps" in words
    assert "half precision" in words
    assert all(x.dtype == torch.float16 for x in read_weights(stopped).tensors.values())
    train(settings(cache), tmp_path / "run", quiet)
    path = ship(tmp_path / "run", "small", tmp_path)
    card = path.with_suffix(".md").read_text()
    for words in ("`unet`", "24 in 12 steps", "6 scenes x 3", "16 x 16 points", "commit", "light cone"):
        assert words in card
    assert read_weights(path).tensors.keys() == read_weights(tmp_path / "run" / WEIGHTS).tensors.keys()


def test_tensorboard_shows_the_same_figures(tmp_path: Path, cache: Path) -> None:
    events = pytest.importorskip("tensorboard.backend.event_processing.event_accumulator", reason="an extra")
    train(settings(cache, tensorboard=True), tmp_path, quiet)
    seen = events.EventAccumulator(str(tmp_path / "tensorboard")).Reload()
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    losses = [line["loss"] for line in lines if "loss" in line]
    assert [event.value for event in seen.Scalars("loss")] == pytest.approx(losses, rel=1e-6)
    assert seen.Scalars("psnr")
