"""Wrong training files are refused before the first step, with exit 2, the line, and what to do."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from nlos.configs.load import load, names
from nlos.recon.errors import InvalidSettings, ReconstructionFailed
from nlos.recon.training.checks import _shared_scenes, problems, trainable
from nlos.recon.training.memory import least_bytes, out_of_memory_in_words, too_large
from nlos.recon.training.run_folder import STATE
from nlos.recon.training.schedule import validation_steps
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import read_about

GOOD = """\
method: unet
method_settings: {widths: [4, 8], finish_widths: [8, 8], core_points: 8}
data: {scenes: 4, degradations: 1, rows: 16, cols: 16, bins: 64, bin_width_ps: 256.0}
validation: {seed: 2, scenes: 2, degradations: 1, held_out: true}
samples: 4
warm_up_steps: 1
cache: null
"""
DATA = "data: {scenes: 4, degradations: 1, rows: 16, cols: 16, bins: 64, bin_width_ps: 256.0}"
VALIDATION = "validation: {seed: 2, scenes: 2, degradations: 1, held_out: true}"
SETTINGS = "method_settings: {widths: [4, 8], finish_widths: [8, 8], core_points: 8}"

WRONG = {
    "no such method": (("method: unet", "method: unett"), ":1:", "did you mean 'unet'"),
    "a method that learns nothing": (("method: unet", "method: lct"), ":1:", "lct learns nothing"),
    "no method": (("method: unet\n", ""), ":1:", "method: is missing"),
    "an unknown key": (("samples: 4", "sampels: 4"), ":5:1: sampels", "Did you mean 'samples'"),
    "an unknown setting": (("core_points: 8", "core_point: 8"), ":2:", "has no such setting; it has: weights"),
    "a setting of another type": (("core_points: 8", "core_points: many"), ":2:", "valid integer"),
    "one number where a list belongs": (("widths: [4, 8]", "widths: 4"), ":2:", "widths"),
    "weights that it would not begin with": ((SETTINGS, "method_settings: {weights: nano}"), ":2:", "start_from"),
    "another grid for validation": ((VALIDATION, VALIDATION[:-1] + ", rows: 32}"), ":4:", "must be that of data, 16"),
    "another time axis for validation": ((VALIDATION, VALIDATION[:-1] + ", bins: 128}"), ":4:", "it is inherited"),
    "another wall for validation": ((VALIDATION, VALIDATION[:-1] + ", wall_width_m: 1.0}"), ":4:", "must be that of"),
    "a kind that does not exist": ((DATA, DATA[:-1] + ", kinds: [dragons]}"), ":3:", "no such kind"),
    "a kind that is held out": ((DATA, DATA[:-1] + ", kinds: [stars]}"), ":3:", "trained on"),
    "more scales than points": (("widths: [4, 8]", "widths: [4, 8, 8, 8, 8]"), ":2:", "take 16 or more"),
    "no scales": (("widths: [4, 8],", "widths: [],"), ":2:", "one at least"),
    "the scenes that are learned from": ((VALIDATION, "validation: {seed: 1, scenes: 2}"), ":4:", "learned from"),
    "those of the defaults": ((VALIDATION, "validation: {scenes: 2, degradations: 1}"), ":4:", "held_out: true"),
    "some kinds in common": (
        (DATA + "\n" + VALIDATION, DATA[:-1] + ", kinds: [letters, wires]}\nvalidation: {scenes: 2, kinds: [wires]}"),
        ":4:", "learned from",
    ),
    "no scenes": (("scenes: 4", "scenes: 0"), ":3:", "greater than or equal to 1"),
    "no rows": (("rows: 16", "rows: 0"), ":3:", "data.rows"),
    "bins below 0": (("bins: 64", "bins: -64"), ":3:", "data.bins"),
    "more than any machine holds": (("rows: 16, cols: 16, bins: 64", "rows: 1024, cols: 1024, bins: 65536"), ":3:",
                                    "GiB at the least"),
    "a bin of no width": (("bin_width_ps: 256.0", "bin_width_ps: 0.0"), ":3:", "data.bin_width_ps"),
    "a time axis before the scenes": (("bins: 64", "bins: 8"), ":3:", "bins are needed"),
    "a wall of no size": ((DATA, DATA[:-1] + ", wall_width_m: 0.0}"), ":3:", "data.wall_width_m"),
    "no samples": (("samples: 4", "samples: 0"), ":5:", "samples"),
    "an empty batch": (("samples: 4", "samples: 4\nbatch: 0"), ":6:", "batch"),
    "a rate below 0": (("samples: 4", "samples: 4\nlearning_rate: -0.1"), ":6:", "learning_rate"),
    "a rate written as text": (("samples: 4", "samples: 4\nlearning_rate: 1e-3"), ":6:", "write it with a dot"),
    "a last rate above the first": (("samples: 4", "samples: 4\nlast_rate: 0.1"), ":6:", "above learning_rate"),
    "a warm-up beyond the end": (("warm_up_steps: 1", "warm_up_steps: 100"), ":6:", "2 steps"),
    "a warm-up beyond one step": (
        ("samples: 4\nwarm_up_steps: 1", "samples: 2\nwarm_up_steps: 10"), ":6:", "1 step; no more must warm up"
    ),
    "an average of 1": (("samples: 4", "samples: 4\naverage: 1.0"), ":6:", "average"),
    "a share above 1": (("samples: 4", "samples: 4\npooled_share: 3.0"), ":6:", "pooled_share"),
    "pooling an odd grid": (("rows: 16, cols: 16", "rows: 15, cols: 15"), ":8:", "which 15 x 15 points are not"),
    "a schedule that does not exist": (("samples: 4", "samples: 4\nschedule: linear"), ":6:", "schedule"),
    "losses of nothing": (("samples: 4", "samples: 4\nloss: {picture: 0.0, depth: 0.0}"), ":6:", "all 0"),
    "a loss below 0": (("samples: 4", "samples: 4\nloss: {depth: -1.0}"), ":6:", "loss.depth"),
    "weights that are not there": (("samples: 4", "samples: 4\nstart_from: no.safetensors"), ":6:", "no w"),
    "weights of another network": (("samples: 4", "samples: 4\nstart_from: lfe"), ":6:", "of the method lfe"),
    "a response that is not there": ((DATA, DATA[:-1] + ", impulse_responses: [no.h5]}"), ":3:", "no.h5: no such file"),
    "a response that is none": ((DATA, DATA[:-1] + ", impulse_responses: [good.yaml]}"), ":3:", "cannot be used"),
    "shares above 1": ((DATA, DATA[:-1] + ", detector: {noiseless: 0.7, uniform: 0.7}}"), ":3:", "more than 1"),
    "counts upside down": ((DATA, DATA[:-1] + ", detector: {peak_counts_least: 900.0}}"), ":3:", "peak_counts_most"),
    "a cache in a file": (("cache: null", "cache: good.yaml/scenes"), ":7:", "not a writable folder"),
    "a key given twice": (("samples: 4", "samples: 4\nsamples: 8"), ":6:", "given twice"),
    "no YAML": (("samples: 4", "samples: [4"), ":", "not valid YAML"),
}  # fmt: skip


@pytest.mark.parametrize("fault", sorted(WRONG))
def test_a_wrong_training_file_is_refused_with_its_line(
    fault: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nlos.__main__ import run

    monkeypatch.chdir(tmp_path)
    (before, after), line, words = WRONG[fault]
    assert before in GOOD
    Path("good.yaml").write_text(GOOD)
    Path("wrong.yaml").write_text(
        GOOD.replace(before, after, 1) + ("pooled_share: 0.5\n" if fault == "pooling an odd grid" else "")
    )
    assert run(["train", "wrong.yaml", "-o", "run"]) == 2
    said = capsys.readouterr().err
    assert f"wrong.yaml{line}" in said, said
    assert words in said
    assert "Traceback" not in said
    assert not Path("run").exists()


@pytest.mark.parametrize(
    "validation",
    [{"seed": 2}, {"held_out": True}, {"kinds": ["tubes"]}, {"files": "mine/*.h5", "share": 1.0}],
    ids=["another seed", "kinds never learned from", "kinds of its own", "files alone"],
)
def test_validation_by_other_scenes_is_taken(validation: dict[str, object]) -> None:
    given = {"method": "unet", "data": {"kinds": ["wires"]}, "validation": validation}
    assert _shared_scenes(TrainSettings.model_validate_json(json.dumps(given))) is None


def test_a_training_larger_than_what_is_free_is_refused_before_anything_is_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.yaml").write_text(GOOD)
    settings = load("train", str(tmp_path / "a.yaml"), TrainSettings).settings
    monkeypatch.setattr("nlos.recon.training.memory.available_bytes", lambda: least_bytes(settings))
    assert too_large(settings) is None
    monkeypatch.setattr("nlos.recon.training.memory.available_bytes", lambda: least_bytes(settings) - 1)
    monkeypatch.setattr("nlos.recon.training.checks.sample", None)
    ((place, words),) = problems(settings)
    assert place == ("data",)
    assert "a batch of 2 of 16 x 16 points x 64 bins takes" in words


def test_an_allocator_that_gives_up_is_told_in_words(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(GOOD)
    settings = load("train", str(tmp_path / "a.yaml"), TrainSettings).settings
    with pytest.raises(ReconstructionFailed, match="memory ran out"), out_of_memory_in_words(settings):
        torch.empty(1 << 50)
    with pytest.raises(RuntimeError, match="another"), out_of_memory_in_words(settings):
        raise RuntimeError("another")


def test_a_batch_that_ranks_cannot_share_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.yaml").write_text(GOOD)
    loaded = load("train", str(tmp_path / "a.yaml"), TrainSettings)
    assert problems(loaded.settings) == []
    monkeypatch.setenv("WORLD_SIZE", "3")
    assert [place for place, _ in problems(loaded.settings)] == [("batch",)]


@pytest.mark.parametrize("name", names("train"))
def test_every_training_file_that_ships_is_found_right(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = load("train", name, TrainSettings).settings
    if settings.start_from is not None and "/" in settings.start_from:
        settings = settings.model_copy(update={"start_from": None})
    monkeypatch.setattr("nlos.recon.training.checks.TRIED", 1)
    if name == "faithful":  # 66 M parameters
        settings = settings.model_copy(update={"method_settings": {"noise_weights": "nano"}})
    assert problems(settings) == []


def test_methods_that_learn_are_told_from_those_that_do_not() -> None:
    assert {"nano", "unet", "lfe", "nlost"} <= set(trainable())
    assert not {"lct", "fk", "phasor"} & set(trainable())


def test_validation_inherits_the_grid_and_the_light_of_the_data() -> None:
    text = {"method": "unet", "data": {"rows": 8, "bins": 32, "retroreflective": True}, "validation": {"scenes": 3}}
    settings = TrainSettings.model_validate_json(json.dumps(text))
    assert (settings.validation.rows, settings.validation.bins, settings.validation.scenes) == (8, 32, 3)
    assert settings.validation.retroreflective
    assert settings.validation.seed == 1


def test_a_finished_run_is_extended_and_a_changed_one_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(GOOD)
    settings = load("train", str(tmp_path / "a.yaml"), TrainSettings).settings

    def quiet(line: str) -> None:
        del line

    folder = tmp_path / "run"
    assert train(settings, folder, quiet)["finished"]
    more = settings.model_copy(update={"samples": 8, "cache": str(tmp_path / "scenes"), "licence": "CC0-1.0"})
    assert train(more, folder, quiet)["step"] == 4
    assert read_about(folder / STATE)["samples"] == 8
    with pytest.raises(InvalidSettings, match="has seen 8 already"):
        train(settings, folder, quiet)
    changed = {"learning_rate": 1e-3, "loss": settings.loss.model_copy(update={"depth": 0.5})}
    with pytest.raises(InvalidSettings, match=r"learning_rate was 0\.002, now 0\.001; loss\.depth was 0\.3, now 0\.5"):
        train(more.model_copy(update=changed), folder, quiet)


def test_check_says_size_memory_and_hours_and_takes_no_step(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text(GOOD)
    words = [sys.executable, "-m", "nlos", "--json", "train", "a.yaml", "--check"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["parameters"] > 1000
    assert said["peak_rss_mb"] > 50
    assert said["seconds_per_sample"] > 0
    validations = len(validation_steps(2))
    assert said["hours_left"] == pytest.approx(
        (4 * said["seconds_per_sample"] + validations * said["seconds_of_validation"]) / 3600
    )
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.yaml"]
