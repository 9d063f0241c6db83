"""Python's own worker processes reconstruct, however they are begun."""

import multiprocessing
import os
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import multiprocessing, sys
import numpy as np, torch
import nlos

rng = np.random.default_rng(0)
COUNTS = rng.poisson(1.0, (32, 32, 128)) + 8 * (np.arange(128) // 4 == 15)

def picture(method):
    return nlos.reconstruct(COUNTS, method, wall=1.0, bin_width=64e-12, rectified=True).albedo

if __name__ == "__main__":
    torch.set_num_threads(2)  # as on any machine of several cores
    here = [picture(method) for method in ("lct", "nano")]
    with multiprocessing.get_context(sys.argv[1]).Pool(2) as pool:
        there = pool.map_async(picture, ["lct", "nano"]).get(timeout=100)
    print([float(np.abs(a - b).max() / a.max()) < 1e-4 for a, b in zip(here, there)])
"""


@pytest.mark.parametrize("begun", ["fork", "spawn"])
def test_workers_reconstruct_after_their_parent_has(tmp_path: Path, begun: str) -> None:
    """A forked one waited for ever for threads of OpenMP that only its parent has."""
    pytest.importorskip("torch", reason="the `recon` extra is not installed")
    if begun not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system does not {begun}")
    (tmp_path / "pool.py").write_text(SCRIPT)
    threads = {name: value for name, value in os.environ.items() if name != "OMP_NUM_THREADS"}
    done = subprocess.run(
        [sys.executable, "pool.py", begun], cwd=tmp_path, env=threads, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.strip() == "[True, True]"
