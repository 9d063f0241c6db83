"""A training that one can trust: it ends when told, is alone in its folder, and does not continue with nonsense."""

import csv
import errno
import json
import math
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
import torch

from nlos.__main__ import run
from nlos.acquisition.errors import StorageError
from nlos.recon.errors import InvalidSettings, ReconstructionFailed
from nlos.recon.training import curves
from nlos.recon.training import train as training
from nlos.recon.training.advice import advice
from nlos.recon.training.curves import curves_of, last_rate_of, smoothed
from nlos.recon.training.log import Log
from nlos.recon.training.run_folder import LOG, STATE, WEIGHTS, alone_in
from nlos.recon.training.schedule import learning_rate, rate_rises, validation_steps
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights import described
from nlos.recon.weights.files import read_about, read_weights, save

TEXT = {
    "method": "unet", "method_settings": {"widths": [4, 8], "finish_widths": [8, 8], "core_points": 8},
    "data": {"scenes": 6, "degradations": 1, "rows": 16, "cols": 16, "bins": 64, "bin_width_ps": 256.0},
    "validation": {"seed": 2, "scenes": 2, "degradations": 1, "held_out": True}, "samples": 400, "warm_up_steps": 3,
}  # fmt: skip
ROUNDS = 100 if os.environ.get("NLOS_SOAK") else 1


def settings(cache: Path, **changes: object) -> TrainSettings:
    return TrainSettings.model_validate_json(json.dumps(TEXT | {"cache": str(cache)} | changes))


def quiet(line: str) -> None:
    del line


def written(folder: Path, cache: Path, **changes: object) -> None:
    (folder / "a.yaml").write_text(json.dumps(TEXT | {"cache": str(cache)} | changes))  # JSON is YAML


def started(folder: Path) -> "subprocess.Popen[str]":
    words = [sys.executable, "-m", "nlos", "train", "a.yaml", "-o", "run"]
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        words, cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )


def steps_logged(folder: Path) -> int:
    log = folder / "run" / LOG
    return len(log.read_text().splitlines()) if log.exists() else 0


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scenes")


@pytest.mark.sampled(2)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_saves_the_step_under_way_and_says_how_to_resume(number: int, tmp_path: Path, cache: Path) -> None:
    written(tmp_path, cache)
    chance = random.Random(number)
    for _ in range(ROUNDS):
        process, logged = started(tmp_path), steps_logged(tmp_path)
        deadline = time.monotonic() + 240
        while steps_logged(tmp_path) < logged + 2:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(chance.uniform(0, 0.3))
        process.send_signal(number)
        said = process.communicate(timeout=240)[1]
        assert process.returncode == 128 + number, said
        assert f"stopped by {signal.Signals(number).name} after step" in said
        assert "The same command resumes" in said
        state = read_about(tmp_path / "run" / STATE)
        lines = [json.loads(line) for line in (tmp_path / "run" / LOG).read_text().splitlines()]
        assert state["step"] == max(line["step"] for line in lines), "no step that was taken is lost"
        assert (tmp_path / "run" / WEIGHTS).exists()
    more = training.train(settings(cache, samples=2 * (state["step"] + 2)), tmp_path / "run", quiet)
    assert more["finished"]
    assert more["step"] == state["step"] + 2


def test_curves_are_redrawn_for_a_tenth_of_the_time_at_most(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s, drawn = [0.0], []

    def draw(log: Path) -> None:
        drawn.append((log, now_s[0]))
        now_s[0] += 0.5

    monkeypatch.setattr(curves, "draw", draw)
    monkeypatch.setattr(curves.time, "monotonic", lambda: now_s[0])
    picture = curves.Redrawn(tmp_path / LOG)
    for _ in range(200):
        picture.again()
        now_s[0] += 0.125
    assert drawn[0] == (tmp_path / LOG, 0.0)
    assert 0.05 < 0.5 * len(drawn) / now_s[0] <= 0.1 + 0.5 / now_s[0]


def test_a_folder_that_nothing_can_be_written_in_is_not_called_anothers(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "held" / "training.lock").mkdir(parents=True)
    for folder in (tmp_path / "file" / "run", tmp_path / "held"):
        with (
            pytest.raises(StorageError, match=r"nothing can be written there .* Choose another folder with -o"),
            alone_in(folder, 0),
        ):
            pass


def test_a_second_training_in_one_folder_is_refused(tmp_path: Path, cache: Path) -> None:
    written(tmp_path, cache)
    first = started(tmp_path)
    deadline = time.monotonic() + 240
    while steps_logged(tmp_path) < 2:
        assert first.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    second = started(tmp_path)
    said = second.communicate(timeout=240)[1]
    assert second.returncode == 2
    assert "another process trains there" in said
    first.kill()
    first.communicate()
    with alone_in(tmp_path / "run", 0):  # a lock goes with its process
        pass


def test_a_loss_that_is_not_finite_stops_with_the_last_good_weights(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chosen, real, calls = settings(cache, samples=40), training.objective, []

    def broken(*given: object) -> dict[str, torch.Tensor]:
        calls.append(1)
        terms = real(*given)  # type: ignore[arg-type]
        return terms if len(calls) < 8 else {name: value * float("nan") for name, value in terms.items()}

    monkeypatch.setattr(training, "objective", broken)
    with pytest.raises(ReconstructionFailed, match=r"the loss is nan at step 8 of 20.*holds the last good weights"):
        training.train(chosen, tmp_path, quiet)
    held = read_weights(tmp_path / WEIGHTS)
    assert all(tensor.isfinite().all() for tensor in held.tensors.values())
    assert 0 < held.about["step"] < 8
    from nlos.cli.exit_codes import exit_code

    assert exit_code(ReconstructionFailed("")) == 8


def test_the_best_weights_are_kept_and_the_last_state(tmp_path: Path, cache: Path) -> None:
    chosen = settings(cache, samples=60, learning_rate=0.02, last_rate=0.02)
    training.train(chosen, tmp_path, quiet)
    lines = [json.loads(line) for line in (tmp_path / LOG).read_text().splitlines()]
    checked = {line["step"]: line["validation"]["psnr"] for line in lines if "validation" in line}
    assert set(checked) == validation_steps(30) | {30}
    about = read_about(tmp_path / WEIGHTS)
    assert about["step"] == max(checked, key=lambda step: checked[step])
    assert about["validation"]["psnr"] == max(checked.values())
    assert "lct_psnr" in about["validation"]
    assert read_about(tmp_path / STATE)["step"] == 30


def test_validation_comes_early_and_often_at_first() -> None:
    steps = sorted(validation_steps(1000))
    assert steps[0] == 20
    assert sum(step <= 200 for step in steps) > sum(step > 200 for step in steps)
    assert validation_steps(1) == {1}


def test_the_log_is_a_table_and_every_curve_is_seen(tmp_path: Path, cache: Path) -> None:
    training.train(settings(cache, samples=40, loss={"log_picture": 0.1}), tmp_path, quiet)
    with (tmp_path / "log.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["step"] for row in rows if row["loss"]] == [str(step) for step in range(1, 21)]
    assert {"loss", "rate", "gradient_norm", "validation psnr", "validation depth_mad_m"} <= rows[0].keys()
    curves = curves_of(tmp_path / LOG)
    assert {"loss", "rate", "gradient_norm", "validation psnr"} <= curves.keys()
    assert not {"data_wait", "validation lct_psnr"} & curves.keys(), "known once, they are no curves"
    assert [row["step"] for row in rows] == [str(step) for step in range(1, 21)], "a row a step, whatever it says"
    assert rows[-1]["validation lct_psnr"]
    picture = matplotlib.image.imread(tmp_path / "loss.png")[..., :3]
    blue = np.abs(picture - np.array([0x1F, 0x77, 0xB4]) / 255).max(axis=2) < 0.02
    columns, rows_of_panels = 3, -(-len(curves) // 3)
    high, wide = picture.shape[0] // rows_of_panels, picture.shape[1] // columns
    for number in range(len(curves)):
        row, col = divmod(number, columns)
        assert blue[row * high : (row + 1) * high, col * wide : (col + 1) * wide].sum() > 15, list(curves)[number]


def test_the_table_is_as_new_as_the_log(tmp_path: Path) -> None:
    log = Log(tmp_path / LOG, 0, active=True)
    for step in (1, 2):
        log.terms(step, {"loss": 1 / step}, 1e-3, 1.0, 0.1 * step, every=1)
        with (tmp_path / "log.csv").open(newline="") as file:
            assert [row["step"] for row in csv.DictReader(file)] == [str(k) for k in range(1, step + 1)]


def test_what_a_killed_training_left_half_saved_is_removed_by_the_next(tmp_path: Path) -> None:
    left = [tmp_path / "state.4711.partial", tmp_path / "weights.4711.partial"]
    for path in (*left, tmp_path / "mine.partial"):
        path.write_bytes(b"half")
    with alone_in(tmp_path, 0):
        assert [path.name for path in tmp_path.glob("*.partial")] == ["mine.partial"]


def test_a_disk_that_fills_up_leaves_the_last_state_and_it_is_said_how_to_go_on(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    state, tensors = tmp_path / "run" / STATE, {"average/a": torch.ones(3)}
    save(state, tensors, {"step": 3})
    before = state.read_bytes()
    written(tmp_path, cache)

    def trains(*_: object, **__: object) -> None:
        save(state, tensors, {"step": 4})

    def full(path: Path, data: bytes) -> None:
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(training, "train", trains)
    monkeypatch.setattr(Path, "write_bytes", full)
    assert run(["train", str(tmp_path / "a.yaml"), "-o", str(tmp_path / "run")]) == 6
    said = capsys.readouterr().err
    assert f"{STATE}: cannot be written (No space left on device). Free disk space" in said
    assert "the same command goes on from there" in said
    assert [path.name for path in state.parent.iterdir()] == [STATE]
    assert state.read_bytes() == before


@pytest.mark.parametrize(
    ("method", "changes", "warned"),
    [
        ("nano", {}, True),
        ("nano", {"method_settings": {"noise_weights": "nano"}}, False),
        ("nano", {"method_settings": {"stage": "noise"}}, False),
        ("nano", {"start_from": "nano"}, False),
        ("unet", {}, False),
    ],
)
def test_a_noise_estimate_that_nobody_trains_is_warned_of(method: str, changes: dict[str, Any], warned: bool) -> None:
    assert bool(advice(TrainSettings.model_validate({"method": method, "samples": 2, **changes}))) == warned


def test_off_a_terminal_progress_is_a_line_with_rate_loss_and_time_left(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nlos.__main__ import run
    from nlos.cli import train as command

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "LINE_S", 0.0)
    written(tmp_path, cache, samples=8)
    assert run(["train", "a.yaml", "-o", "run"]) == 0
    said = capsys.readouterr().err
    assert "2 of 4 steps" in said
    assert re.search(r"steps/(s|min), loss \d", said)
    assert "s left" in said
    with pytest.raises(InvalidSettings, match="has seen 8 already"):
        training.train(settings(cache, samples=2), tmp_path / "run", quiet)


def test_a_finished_run_is_left_as_it_is_and_says_its_best(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nlos.__main__ import run

    monkeypatch.chdir(tmp_path)
    written(tmp_path, cache, samples=13, batch=4)
    assert run(["train", "a.yaml", "-o", "run"]) == 0
    first = capsys.readouterr()
    assert "13 samples are no whole batches of 4: 16 are seen" in first.err
    best = read_about(tmp_path / "run" / WEIGHTS)
    assert f"run/weights.safetensors: the best on validation, of step {best['step']} of 4: psnr" in first.out
    assert best["last"]["samples"] == 16
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "run").iterdir() if path.name != LOG}
    assert run(["train", "a.yaml", "-o", "run"]) == 0
    assert capsys.readouterr().out == first.out
    after = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "run").iterdir() if path.name != LOG}
    assert {name: at for name, at in after.items() if name in before} == before


def test_what_it_begins_with_is_judged_first_and_named(tmp_path: Path, cache: Path) -> None:
    training.train(settings(cache, samples=4, licence="CC0-1.0"), tmp_path / "a", quiet)
    start = str(tmp_path / "a" / WEIGHTS)
    told: list[str] = []
    wrecked = settings(cache, samples=8, start_from=start, learning_rate=0.1, last_rate=0.1)
    summary = training.train(wrecked, tmp_path / "b", told.append)
    assert any(line.startswith(f"before the first step, {start}: psnr") for line in told)
    lines = [json.loads(line) for line in (tmp_path / "b" / LOG).read_text().splitlines()]
    assert lines[0]["step"] == 0
    about = read_about(tmp_path / "b" / WEIGHTS)
    assert (about["step"], about["validation"]["psnr"]) == (0, lines[0]["validation"]["psnr"]), "it began best"
    assert summary["best"]["step"] == 0
    assert about["parent"]["licence"] == "CC0-1.0"
    assert described.summary(str(tmp_path / "b" / WEIGHTS))["begun with"].startswith(f"{start}, licence CC0-1.0")


def test_a_noisy_curve_has_a_smoothed_one_of_its_length_and_mean() -> None:
    noisy = [2.0 + (-1.0) ** number for number in range(400)]
    calm = smoothed(noisy)
    assert len(calm) == 400
    assert max(calm) - min(calm) < 0.1
    assert smoothed([math.nan, 1.0, 3.0])[:2] == [1.0, 2.0]


def test_who_extends_a_run_is_told_that_its_rate_rises(tmp_path: Path) -> None:
    short = TrainSettings(method="unet", samples=400, warm_up_steps=10)
    longer = short.model_copy(update={"samples": 4000})
    log = Log(tmp_path / LOG, 0, active=True)
    log.terms(200, {"loss": 1.0}, learning_rate(short, 199), 1.0, 1.0, every=1)
    before = last_rate_of(tmp_path / LOG)
    assert rate_rises(short, 200, before) == ""
    assert "rises again, from 4e-05 to 0.002" in rate_rises(longer, 200, before)
    assert rate_rises(longer, 200, last_rate_of(tmp_path / "none.jsonl")) == ""
