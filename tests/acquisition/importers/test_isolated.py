"""A damaged file can crash, exhaust or hang only the child that reads it."""

import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator
from multiprocessing import spawn
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.exporters.matlab import write_matlab
from nlos.acquisition.exporters.npz import write_npz
from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import arrays_of_import
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.isolated import IsolatedReader, read_isolated

Damage = Callable[[Path, Path, int], Iterator[Path]]
WRITERS = {".npz": write_npz, ".mat": write_matlab, ".hdf5": write_ytal, ".ptu": write_ptu}


def write(path: Path) -> Path:
    with h5py.File(path, "w") as file:
        file["histograms"] = np.random.default_rng(0).poisson(1.0, (3, 4, 64)).astype(np.uint16)
        file["time_offset_bins"] = np.ones((3, 4))
        file.attrs.update({"bin_width_s": 4e-12, "wall_size_m": [0.7, 0.5], "direct_cut_bins": 3})
    return path


def test_it_reads_what_the_importers_read(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.h5")
    here, there = read_any(path), read_isolated(path)
    assert np.array_equal(here.transient.counts, there.transient.counts)
    assert (here.transient.wall, here.transient.time) == (there.transient.wall, there.transient.time)
    assert (here.notes, here.direct_cut_bins, here.falloff) == (there.notes, there.direct_cut_bins, there.falloff)
    assert np.array_equal(here.time_offset_bins, there.time_offset_bins)


def test_a_program_with_a_python_of_its_own_is_not_begun_again_to_read_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As PyInstaller makes them: the child was the whole program, and the file was called damaged."""
    path, began, python = write(tmp_path / "scan.h5"), tmp_path / "began", sys.executable
    program = tmp_path / "lab_program"
    program.write_text(f"#!/bin/sh\ntouch {began}\necho hello\n", encoding="utf-8")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "frozen", True, raising=False)
    monkeypatch.setattr(sys, "executable", str(program))
    monkeypatch.setattr(spawn, "_python_exe", os.fsencode(program))
    with pytest.raises(StorageError, match=r"lab_program\).*set_executable"):
        read_isolated(path)
    assert not began.exists()
    multiprocessing.set_executable(python)
    assert read_isolated(path).direct_cut_bins == 3


def test_a_dead_child_is_an_error_and_the_next_file_is_read(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.h5")
    with IsolatedReader() as reader:
        reader.read(path)
        child = reader._child
        assert child is not None
        os.kill(child.pid, 9)
        child.wait()
        assert reader.read(path).direct_cut_bins == 3


def test_a_child_that_hangs_is_killed_at_the_deadline(tmp_path: Path) -> None:
    path = write(tmp_path / "scan.h5")
    with IsolatedReader(deadline_s=0.001) as reader, pytest.raises(InvalidData, match="did not survive"):
        reader.read(path)


@pytest.mark.soak
@pytest.mark.parametrize("suffix", [".h5", ".hdf5", ".ptu", ".mat", ".npz"])
def test_damaged_files_give_a_message_that_names_them(suffix: str, tmp_path: Path, damage: Damage) -> None:
    campaign = 4000 if os.environ.get("NLOS_SOAK") else 20
    whole = write(tmp_path / "scan.h5")
    if suffix != ".h5":
        scan = arrays_of_import(read_any(whole), whole)
        whole = tmp_path / f"scan{suffix}"
        WRITERS[suffix](scan, whole)
    messages = []
    with IsolatedReader(memory_bytes=3 << 30, deadline_s=20.0) as reader:
        for path in damage(whole, tmp_path / f"damaged{suffix}", campaign):
            try:
                reader.read(path)
            except InvalidData as error:
                messages.append(str(error))
    assert messages
    assert all(f"damaged{suffix}" in message for message in messages)


@pytest.mark.parametrize("python", ["/nowhere/python", "/bin/false"])
def test_a_child_that_does_not_start_says_nothing_about_the_file(
    python: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "scan.h5")
    with IsolatedReader() as reader:
        with monkeypatch.context() as patched:
            patched.setattr(sys, "executable", python)
            with pytest.raises(StorageError, match="no process could be started"):
                reader.read(path)
        assert reader.read(path).direct_cut_bins == 3
