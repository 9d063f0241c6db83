"""A hundred kills and signals at random times in one training: it resumes from its last state, and ends bit-equal."""

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from nlos.recon.training.run_folder import STATE
from nlos.recon.training.train import train
from nlos.recon.training.train_settings import TrainSettings
from nlos.recon.weights.files import read_about, read_weights

SOAK = bool(os.environ.get("NLOS_SOAK"))
ROUNDS = 100
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)
TEXT = {
    "method": "unet", "method_settings": {"widths": [4, 8], "finish_widths": [8, 8], "core_points": 8},
    "data": {"scenes": 60, "degradations": 1, "rows": 16, "cols": 16, "bins": 64, "bin_width_ps": 256.0},
    "validation": {"seed": 2, "scenes": 2, "degradations": 1, "held_out": True}, "warm_up_steps": 3,
    "checkpoint_minutes": 0.02, "workers": 0,
}  # fmt: skip
MOTHER = """
import os, sys
import nlos.cli.train, nlos.recon.training.train, nlos.recon.training.checks, nlos.recon.methods.unet
from nlos.__main__ import main
for line in sys.stdin:
    pid = os.fork()
    if not pid:
        out = os.open(line.strip(), os.O_WRONLY | os.O_CREAT)
        for number in (1, 2):
            os.dup2(out, number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.argv = ["nlos", "train", "a.yaml", "-o", "run"]
        main()
    print(pid, flush=True)
    sys.stdin.readline()
    print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
"""


class Starts:
    """`nlos train` again and again without loading PyTorch each time: every start is a fork of a process that has."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._mother = subprocess.Popen(
            [sys.executable, "-c", MOTHER], cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        )  # fmt: skip

    def ended(self, number: int, after_s: float) -> tuple[int, str, float]:
        """One start, ended by this signal so long after its first words: exit code, words, seconds since its state."""
        said = self.folder / "said.txt"
        said.unlink(missing_ok=True)
        pid = int(self._exchange(str(said)))
        deadline = time.monotonic() + 120
        while not (said.exists() and "from step" in said.read_text()):
            assert time.monotonic() < deadline
            time.sleep(0.005)
        began = time.time()
        time.sleep(after_s)
        state = self.folder / "run" / STATE
        lost_s = time.time() - max(began, state.stat().st_mtime if state.exists() else 0)
        os.kill(pid, number)
        return int(self._exchange("")), said.read_text(), lost_s

    def _exchange(self, line: str) -> str:
        assert self._mother.stdin is not None
        assert self._mother.stdout is not None
        self._mother.stdin.write(line + "\n")
        self._mother.stdin.flush()
        return self._mother.stdout.readline()

    def close(self) -> None:
        self._mother.communicate()


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="a campaign of ten minutes: make soak")
def test_a_hundred_kills_lose_nothing_that_was_saved(tmp_path: Path) -> None:
    chance, most_lost_s, steps = random.Random(5), 0.0, [0]
    text = TEXT | {"cache": str(tmp_path / "scenes"), "samples": 1_000_000}
    (tmp_path / "a.yaml").write_text(json.dumps(text))
    starts = Starts(tmp_path)
    for number in (SIGNALS * ROUNDS)[:ROUNDS]:
        before = read_about(tmp_path / "run" / STATE)["step"] if (tmp_path / "run" / STATE).exists() else 0
        code, said, lost_s = starts.ended(number, chance.uniform(0, 4))
        assert "Traceback" not in said, said
        found = re.search(r"from step (\d+) of", said)
        assert found is not None, said
        assert int(found[1]) == before, "it resumes from the state that was saved"
        assert code in (128 + number, -number), said
        if number != signal.SIGKILL and "stopped by" in said:
            assert int(re.search(r"after step (\d+) of", said)[1]) == read_about(tmp_path / "run" / STATE)["step"]  # type: ignore[index]
        most_lost_s = max(most_lost_s, lost_s)
        steps.append(before)
    starts.close()
    assert steps == sorted(steps)
    last = read_about(tmp_path / "run" / STATE)["step"]
    print(json.dumps({"figure": "most_lost", "value": round(most_lost_s, 2), "unit": "s", "steps": last}))
    assert most_lost_s < 30
    chosen = TrainSettings.model_validate_json(json.dumps(text))
    for name in ("run", "whole"):
        taken_to(last + 5, tmp_path / name, chosen)
    first, second = (read_weights(tmp_path / name / STATE) for name in ("run", "whole"))
    assert first.about["step"] == second.about["step"] > last
    assert all(torch.equal(first.tensors[name], second.tensors[name]) for name in first.tensors)


def taken_to(step: int, folder: Path, chosen: TrainSettings) -> None:
    """A training until this step, without a fault."""

    def until(at: int, steps: int, loss: float) -> None:
        if at == step:
            signal.raise_signal(signal.SIGINT)

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        train(chosen, folder, lambda line: None, progress=until)
    finally:
        torch.set_num_threads(threads)
