"""pyvisa-py as host of the simulated counter: every length of answer, records, and questions that were never asked."""

import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).parent


@pytest.mark.parametrize("packet_bytes", [64, 512, 1024])
def test_pyvisa_py_gets_every_answer_whole(foreign_python: Callable[..., Path], packet_bytes: int) -> None:
    done = subprocess.run(
        [foreign_python("pyvisa_py", "usb"), HERE / "pyvisa" / "talk.py", str(packet_bytes)],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1] / "src")},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip() == f"answers {4 * (3 * packet_bytes // 4 - 1)}"
