"""Drivers of PicoQuant's instruments that labs use, in front of the stand-in for their libraries."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

HERE = Path(__file__).parent
ForeignPython = Callable[..., Path]


def measured(foreign_python: ForeignPython, device: str, mode: str) -> dict[str, Any]:
    """By QMI, in an interpreter of ours that finds it behind our own packages."""
    where = "import qmi; print(list(qmi.__path__)[0])"
    package = subprocess.run([foreign_python("qmi"), "-c", where], capture_output=True, text=True, check=True).stdout
    done = subprocess.run(
        [sys.executable, HERE / "picoquant" / "run_qmi.py", Path(package.strip()).parent, device, mode],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(HERE.parents[1] / "src"), str(HERE.parents[1])))},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    seen: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    assert seen["refused"] == []
    assert seen["rates"][0] == 10_000_000
    return seen


@pytest.mark.parametrize(("device", "width_ps"), [("multiharp150", 40.0), ("hydraharp400", 8.0), ("picoharp300", 32.0)])
def test_a_histogram_is_read_as_it_was_counted(foreign_python: ForeignPython, device: str, width_ps: float) -> None:
    seen = measured(foreign_python, device, "HIST")
    assert seen["counts"] == seen["ours"]
    assert sum(seen["counts"]) == pytest.approx(20_000, rel=0.05)
    assert abs(int(np.argmax(seen["counts"])) * width_ps - 12_000) < 500
    assert (seen["resolution_ps"], seen["elapsed_ms"], seen["flags"]) == (width_ps, 500.0, [])


@pytest.mark.parametrize(("device", "steps"), [("multiharp150", 24), ("hydraharp400", 0)])
def test_photons_and_marks_have_the_times_that_we_tell(foreign_python: ForeignPython, device: str, steps: int) -> None:
    seen = measured(foreign_python, device, "T3")
    assert len(seen["photons"]) == pytest.approx(20_000, rel=0.05)
    assert sorted(seen["photons"]) == pytest.approx(sorted(seen["our_photons"]), abs=1)
    assert seen["marks"] == pytest.approx(seen["our_marks"], abs=1)
    assert seen["bits"] == seen["our_bits"]
    assert steps <= len(seen["marks"]) <= steps + 2
