"""Memory that a method is said to take, against what a process really grew by while it ran."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import parse_settings, torch_is_installed

WALL, TIME = WallGrid(1.0, 1.0, 64, 64), TimeAxis(512, 32e-12)
SETTINGS: dict[str, dict[str, object]] = {
    "lct": {"bin_width_ps": 32.0}, "gram": {"bin_width_ps": 32.0},
    "gradient_descent": {"bin_width_ps": 32.0, "iterations": 2},
}  # fmt: skip
CHILD = """
import json, sys
import numpy as np
import torch
from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.reconstruct import reconstruct

torch.set_num_threads(1)

def scene(points, bins, response):
    counts = np.random.default_rng(0).poisson(0.05, (bins, points, points)).astype(np.float32)
    counts[bins // 3] += 2
    wall, time = WallGrid(1.0, 1.0, points, points), TimeAxis(bins, 32e-12)
    return Transient(counts, np.ones((points, points)), wall, time, response)

def status(key):
    return next(int(line.split()[1]) * 1024 for line in open("/proc/self/status") if line.startswith(key))

grown = {}
for method, settings in json.loads(sys.argv[1]).items():
    for told in (False, True):
        response = gaussian(300e-12, "a test") if told else None
        reconstruct(scene(8, 64, response), method, settings, explain=False)
        large = scene(64, 512, response)
        before = status("VmRSS")
        open("/proc/self/clear_refs", "w").write("5")
        reconstruct(large, method, settings, explain=False)
        grown[f"{method} {told}"] = status("VmHWM") - before
print(json.dumps(grown))
"""


@pytest.fixture(scope="module")
def grown() -> dict[str, int]:
    """Bytes by "METHOD told?"; blocks of a megabyte are given back at once, so that none is counted twice."""
    if not Path("/proc/self/clear_refs").exists():
        pytest.skip("only Linux says how much memory a process once had")
    if not torch_is_installed():
        pytest.skip("these methods need torch")
    done = subprocess.run(
        [sys.executable, "-c", CHILD, json.dumps(SETTINGS)], capture_output=True, text=True, timeout=300, check=True,
        env={"MALLOC_MMAP_THRESHOLD_": "500000", "OMP_NUM_THREADS": "1", "PATH": ""},
    )  # fmt: skip
    found: dict[str, int] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("method", SETTINGS)
def test_a_response_takes_as_much_more_as_is_said(method: str, grown: dict[str, int]) -> None:
    """What is said is near what is taken; and told is as much above untold as said, within a volume and a half."""
    chosen = parse_settings(method, SETTINGS[method])
    said = [chosen.bytes_needed(WALL, TIME, told) for told in (False, True)]  # type: ignore[attr-defined]
    took = [grown[f"{method} {told}"] for told in (False, True)]
    cube = 4 * TIME.bins * WALL.rows * WALL.cols
    for one, other in zip(said, took, strict=True):
        assert 0.75 * one < other < 1.15 * one
    assert abs((took[1] - took[0]) - (said[1] - said[0])) < 1.5 * cube
    assert said[1] - said[0] > cube
