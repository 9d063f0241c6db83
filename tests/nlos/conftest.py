"""The command line as a user calls it: in a process of its own."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]

SMALL = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 4, cols: 4}
pattern: serpentine
dwell_ms: 2
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""


@pytest.fixture
def nlos(tmp_path: Path) -> Nlos:
    """Runs `nlos ARGUMENTS` in a fresh folder."""

    def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "nlos", *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=120, cwd=tmp_path)

    return run


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A scan of 4 x 4 points."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    return path


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    """A plain HDF5 scan of 3 x 4 points."""
    path = tmp_path / "plain.h5"
    with h5py.File(path, "w") as file:
        file["histograms"] = np.random.default_rng(0).poisson(1.0, (3, 4, 64)).astype(np.uint16)
        file.attrs.update({"bin_width_s": 4e-12, "wall_size_m": [0.7, 0.5], "direct_cut_bins": 3})
    return path
