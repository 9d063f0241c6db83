"""A method of one's own beside ours: what it breaks is its own result alone, and what it changes is put back."""

import json
import os
import re
import signal
import threading
import warnings
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.put_back import _say_changed, put_back
from nlos.recon.reconstruct import reconstruct
from tests.command import nlos as command_nlos
from tests.scan_texts import EIGHT_BY_EIGHT, recorded

TEXT = Path(__file__).with_name("method_of_ones_own.py").read_text(encoding="utf-8")


@pytest.fixture
def scan() -> Transient:
    counts = np.zeros((32, 4, 8), np.float32)
    counts[20, 1, 5] = 9
    return Transient(counts, np.ones((4, 8)), WallGrid(1.0, 0.5, 4, 8), TimeAxis(32, 100e-12))


def test_one_that_fails_takes_no_other_methods_results_along(tmp_path: Path) -> None:
    """Hours of theirs may be behind."""
    counts = np.random.default_rng(0).poisson(1.0, (8, 8, 32))
    for name in ("a", "b"):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file.attrs.update({"bin_width_s": 1e-10, "wall_size_m": 1.0})
            file["transient"] = counts
            file["gt_intensity"], file["gt_depth"] = counts[..., 20], np.full((8, 8), 0.3)
            file["gt_mask"] = np.ones((8, 8))
        counts[0, 0, 0] = 77
    fails = "assert counts.max() < 77, 'too bright'; brightest = counts"
    (tmp_path / "mine.py").write_text(TEXT.replace("brightest = counts", fails), encoding="utf-8")
    words = ("evaluate", "--data", "a.h5", "b.h5", "--conditions", "transient", "-o", "out", "--json")
    done = command_nlos(tmp_path, *words, "--methods", "./mine.py,lct", "--fixed")
    told = json.loads(done.stdout)
    assert done.returncode == told["error"]["exit_code"] == 8
    assert "out: 1 of 4 results are missing: b, transient, mine.py: no result: " in told["error"]["message"]
    assert [(row["scene"], row["method"]) for row in json.loads((tmp_path / "out" / "results.json").read_text())] == [
        ("a", "mine.py"), ("a", "lct"), ("b", "lct"),
    ]  # fmt: skip
    assert told["without"][0]["reason"].endswith("AssertionError: too bright. The method mine.py raised this, the scan "
                                                 "is as it was.")  # fmt: skip
    table = (tmp_path / "out" / "results.md").read_text(encoding="utf-8")
    assert "mine.py:25: AssertionError: too bright" in table
    assert "| mine.py (1 of 2 scenes) | " in table  # what it failed on may be what others are bad at
    assert "| lct | " in table
    (tmp_path / "mine.py").write_text(TEXT.replace("brightest = counts", "1 / 0; brightest = counts"), "utf-8")
    alone = command_nlos(tmp_path, *words, "--methods", "./mine.py", "--overwrite")
    assert alone.returncode == 8
    assert len(json.loads((tmp_path / "out" / "results.json").read_text())) == 3


CHANGES = {
    "the current folder": "import os; os.chdir('/')",
    "what SIGINT does": "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)",
    "PyTorch's default type": "torch.set_default_dtype(torch.float64)",
    "PyTorch's default device": "torch.set_default_device('meta')",
    "warnings to errors": "import warnings; warnings.simplefilter('error', RuntimeWarning)",
    "": "import numpy; numpy.seterr(all='raise'); torch.set_grad_enabled(False); torch.set_num_threads(3)",
}


@pytest.mark.parametrize("when", ["import", "call"])
@pytest.mark.parametrize("what", CHANGES)
def test_what_it_changes_of_the_whole_program_is_put_back(
    what: str, when: str, scan: Transient, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Or it decides where a scan is recorded, and whether Ctrl-C ends it."""
    said: list[str] = []
    _say_changed.cache_clear()
    monkeypatch.setattr("nlos.recon.put_back._log.warning", lambda form, *words: said.append(form % words))

    def shared() -> list[object]:
        of_torch = torch.get_default_dtype(), torch.get_default_device(), torch.is_grad_enabled()
        return [
            os.getcwd(), signal.getsignal(signal.SIGINT), np.geterr(), torch.get_num_threads(), of_torch,
            list(warnings.filters),
        ]  # fmt: skip

    monkeypatch.chdir(tmp_path)
    before, change = shared(), CHANGES[what]
    at_import = TEXT.replace("class Settings(", f"{change}\n\n\nclass Settings(", 1)
    in_a_call = TEXT.replace("        return MethodResult", f"        {change}\n        return MethodResult", 1)
    Path("mine.py").write_text(at_import if when == "import" else in_a_call, encoding="utf-8")
    assert reconstruct(scan, "mine.py").albedo[1, 5] == 9
    assert shared() == before
    assert [f" changed {what} for the whole program" in line for line in said] == [True] * len(said)
    assert bool(said) == bool(what)


def test_ctrl_c_is_put_back_while_another_thread_still_makes_a_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """That one, which left last, could not: the scan was deaf from then on."""
    monkeypatch.setattr("nlos.recon.put_back._say_changed", lambda whose, changed: None)
    before, inside, release = signal.getsignal(signal.SIGINT), threading.Event(), threading.Event()

    def picture() -> None:
        with put_back("theirs"):
            inside.set()
            release.wait(60)

    other = threading.Thread(target=picture)
    try:
        with put_back("mine"):
            other.start()
            assert inside.wait(60)
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        assert signal.getsignal(signal.SIGINT) is before
    finally:
        signal.signal(signal.SIGINT, before)
        release.set()
        other.join(60)


def test_a_followed_scan_without_its_picture_ends_with_the_methods_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And not with that of invalid data: the scan is as it was."""
    monkeypatch.setattr("nlos.cli.reconstruct.prepare_process", lambda: None)  # this one is not its own
    recorded(tmp_path, EIGHT_BY_EIGHT)
    (tmp_path / "mine.py").write_text(TEXT.replace("brightest = counts", "1 / 0; brightest = counts"), "utf-8")
    done = command_nlos(tmp_path, "reconstruct", "run.h5", "--follow", "--method", "./mine.py", "-o", "out")
    assert done.returncode == 8, done.stderr
    assert re.search(r"ended without a picture.*mine\.py:25: ZeroDivisionError", done.stderr)
