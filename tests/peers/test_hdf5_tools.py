"""HDF5's own command-line tools (Debian: hdf5-tools) on recordings: copied, packed and unpacked again."""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Recording
from tests.scan_texts import THREE_BY_FOUR, recorded

Tool = Callable[..., str]


@pytest.fixture
def tool() -> Tool:
    """tool("h5ls", ...): what it says; it must say nothing on stderr."""

    def call(name: str, *words: str | Path) -> str:
        if shutil.which(name) is None:
            pytest.skip(f"no {name} on this machine (Debian: hdf5-tools)")
        done = subprocess.run([name, *map(str, words)], capture_output=True, text=True, timeout=60)
        assert (done.returncode, done.stderr) == (0, ""), f"{name}: {done.returncode} {done.stderr}"
        return done.stdout

    return call


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return recorded(tmp_path, THREE_BY_FOUR)


def same_counts(one: Path, other: Path) -> bool:
    with Recording.open(one) as first, Recording.open(other) as second:
        return np.array_equal(first.transient().counts, second.transient().counts)


def test_every_part_is_copied_by_h5copy(recording: Path, tmp_path: Path, tool: Tool) -> None:
    copy = tmp_path / "copy.h5"
    with h5py.File(recording) as file:
        parts = list(file)
    for part in parts:
        tool("h5copy", "-i", recording, "-o", copy, "-s", f"/{part}", "-d", f"/{part}")
    with h5py.File(recording) as source, h5py.File(copy, "r+") as target:
        for name, value in source.attrs.items():  # the file's own, which h5copy leaves
            target.attrs[name] = value
    assert same_counts(recording, copy)
    assert run(["verify", str(copy)]) == 0


@pytest.mark.parametrize("how", [(), ("-L",), ("-S", "PAGE"), ("-l", "samples/counts:CHUNK=4x64")])
def test_what_h5repack_lays_out_anew_is_read(recording: Path, tmp_path: Path, tool: Tool, how: tuple[str, ...]) -> None:
    tool("h5repack", *how, recording, tmp_path / "new.h5")
    tool("h5diff", recording, tmp_path / "new.h5")
    assert same_counts(recording, tmp_path / "new.h5")


@pytest.mark.parametrize("how", [("-f", "GZIP=3"), ("-l", "CHUNK=2")])
def test_what_h5repack_packed_is_read_once_it_did_what_the_refusal_says(
    recording: Path, tmp_path: Path, tool: Tool, capfd: pytest.CaptureFixture[str], how: tuple[str, ...]
) -> None:
    packed, plain = tmp_path / "packed.h5", tmp_path / "NEW.h5"
    tool("h5repack", *how, recording, packed)
    capfd.readouterr()
    assert run(["verify", str(packed)]) == 7
    told = capfd.readouterr().err.split("`")[1]
    assert told.endswith(" NEW.h5")
    tool(*told.split()[:-1], plain)
    assert same_counts(recording, plain)
