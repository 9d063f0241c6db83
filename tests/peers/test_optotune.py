"""Optotune's SDK for the MR-E-2 as host of the simulated controller: modes, positions, flags, refusals, frames."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).parent


def test_the_vendors_sdk_and_our_driver_agree_about_one_controller(checkout: Callable[..., Path]) -> None:
    sdk = checkout("coPylot", "copylot/hardware/mirrors/optotune/optoMDC")
    done = subprocess.run(
        [sys.executable, HERE / "optotune" / "talk.py", sdk.parents[4]],
        capture_output=True,
        text=True,
        timeout=300,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1] / "src")},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1] == "connections 4 places 50 flags 14 refusals 2 frames 2000"
