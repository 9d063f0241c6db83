"""Samples are the same whoever makes them; processes that make them end with the training, whatever ends it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import torch

from nlos.recon.errors import ReconstructionFailed
from nlos.recon.training import feed
from nlos.recon.training.batches import batch_at
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.feed import Feed, workers_for
from nlos.recon.training.run_folder import STATE
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import read_about, read_weights

GRID: dict[str, Any] = {"rows": 8, "cols": 8, "bins": 64, "bin_width_ps": 256.0}
SOAK = bool(os.environ.get("NLOS_SOAK"))
SCRIPT = """
import sys
from pathlib import Path
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings

if __name__ == "__main__":
    train(TrainSettings.model_validate_json(sys.argv[2]), Path(sys.argv[1]), lambda line: None)
"""


def settings(**changes: Any) -> TrainSettings:
    given: dict[str, Any] = {
        "method": "unet",
        "method_settings": {"widths": (4, 8), "finish_widths": (8, 8), "core_points": 8},
        "data": DatasetSettings(scenes=6, **GRID),
        "validation": DatasetSettings(seed=2, scenes=1, degradations=1, held_out=True, **GRID),
        "samples": 12, "warm_up_steps": 1, "cache": None,
    }  # fmt: skip
    return TrainSettings(**(given | changes))


def children(pid: int) -> list[int]:
    """Living processes that descend from this one and hold PyTorch."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(stat.read_text().rpartition(")")[2].split()[1])
            if parent == pid and b"spawn_main" in (stat.parent / "cmdline").read_bytes():
                found.append(int(stat.parent.name))
        except (OSError, ValueError, IndexError):
            continue
    return found


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] in "ZX"
    except OSError:
        return True


def waits(until: Any, seconds: float = 60) -> None:
    deadline = time.monotonic() + seconds
    while not until():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_batches_are_bit_equal_however_many_processes_make_them() -> None:
    chosen = settings()
    for workers, part in ((0, slice(None)), (2, slice(1, 2)), *([(3, slice(None))] if SOAK else [])):
        with Feed(chosen, part, 2, workers) as fed:
            for step in range(2, 6):
                wanted = batch_at(chosen.data, None, chosen.seed, step, chosen.batch, part)
                got = fed.batch()
                assert got.keys() == wanted.keys()
                assert all(torch.equal(got[name], wanted[name]) for name in wanted), (workers, step)


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="two trainings with processes: make soak")
def test_a_training_is_bit_equal_with_and_without_processes(tmp_path: Path) -> None:
    for workers in (0, 2):
        done = train(settings(workers=workers), tmp_path / f"{workers}", lambda line: None)
        assert 0 <= done["data_wait"] <= 1
    first, second = (read_weights(tmp_path / name / STATE).tensors for name in ("0", "2"))
    assert all(torch.equal(first[name], second[name]) for name in first)


def test_short_runs_start_no_processes() -> None:
    assert workers_for(settings(), 12, 1, "cpu") == 0
    assert workers_for(settings(), feed.WORTH_SAMPLES, 1, "cpu") == 1
    assert workers_for(settings(workers=3), 12, 1, "cpu") == 3


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, *([signal.SIGINT] if SOAK else [])])
def test_processes_end_with_their_training(number: int, tmp_path: Path) -> None:
    """Killed from outside, and told from the terminal, which tells the whole group."""
    chosen = settings(samples=4000, workers=1)
    (tmp_path / "run.py").write_text(SCRIPT)
    words = [
        sys.executable,
        str(tmp_path / "run.py"),
        str(tmp_path / "run"),
        json.dumps(chosen.model_dump(mode="json")),
    ]
    trainer = subprocess.Popen(words, env=os.environ | {"OMP_NUM_THREADS": "1"}, start_new_session=True)
    log = tmp_path / "run" / "log.jsonl"
    try:
        waits(lambda: (log.exists() and log.stat().st_size > 0) or trainer.poll() is not None)
        assert trainer.poll() is None
        workers = children(trainer.pid)
        assert len(workers) == 1
        if number == signal.SIGKILL:
            trainer.kill()
        else:
            os.killpg(trainer.pid, number)
        trainer.wait(240)
        waits(lambda: all(gone(pid) for pid in workers))
        assert number == signal.SIGKILL or trainer.returncode == 0
    finally:
        if trainer.poll() is None:
            os.killpg(trainer.pid, signal.SIGKILL)
            trainer.wait()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="needs /proc")
def test_a_process_that_is_killed_is_said_and_what_was_learned_is_saved(tmp_path: Path) -> None:
    def kill_one(step: int, steps: int, loss: float) -> None:
        if step == 3:
            os.kill(children(os.getpid())[0], signal.SIGKILL)

    chosen = settings(samples=400, workers=1)
    with pytest.raises(ReconstructionFailed, match="a process that makes samples was killed"):
        train(chosen, tmp_path, lambda line: None, progress=kill_one)
    assert read_about(tmp_path / STATE)["step"] >= 3
