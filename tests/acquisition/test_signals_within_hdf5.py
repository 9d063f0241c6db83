"""A signal that comes while HDF5 calls back into Python is answered when HDF5 is done, not within: HDF5 would take the
exception for a failure of the disk, and crash the process at its end."""

import contextlib
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5

AT_EVERY_CALL = """
import signal, sys
from pathlib import Path

import h5py
import numpy as np

from nlos.acquisition.recording.file_bytes import HdfBytes
from nlos.acquisition.recording.shown_to_hdf5 import shown_to_hdf5, written_hdf5

number = signal.Signals[sys.argv[1]]
calls, signalled = 0, 0


class Ended(Exception):
    pass


def end(number, frame):
    raise Ended


def counted(method):
    def call(self, *given):
        global calls
        calls += 1
        if calls == signalled:
            signal.raise_signal(number)
        return method(self, *given)

    return call


def written(path):
    with written_hdf5(path) as file:
        file["a"] = np.arange(1000)
        file.create_dataset("g/b", data=np.ones((100, 100)), compression="gzip")


def read(path):
    with path.open("rb") as raw, shown_to_hdf5(HdfBytes(raw.fileno(), "b.h5"), "r") as file:
        assert file["g/b"][3, 4] == 1


def calls_of(what, path, at):
    global calls, signalled
    calls, signalled = 0, at
    what(path)
    return calls


for name in ("seek", "tell", "write", "readinto", "truncate", "flush"):
    setattr(HdfBytes, name, counted(getattr(HdfBytes, name)))
signal.signal(number, end)
Path("b.h5").write_bytes(b"")
for what in (written, read):
    whole = calls_of(what, Path("b.h5"), 0)
    assert whole > 5
    errors = []  # whoever keeps an error keeps what it came through
    for at in range(1, whole + 1):
        try:
            calls_of(what, Path("b.h5"), at)
            raise SystemExit(f"{what.__name__}: nothing was raised at call {at}")
        except Ended as error:
            errors.append(error)
        assert signal.getsignal(number) is end
        with h5py.File("b.h5") as file:
            assert file["a"][999] == 999
"""


@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_signal_at_every_call_back_is_raised_once_and_the_file_is_whole(tmp_path: Path, number: str) -> None:
    command = [sys.executable, "-c", AT_EVERY_CALL, number]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("raises", [False, True])
def test_a_handler_that_shuts_the_light_of_another_threads_bench_does_so_at_once(tmp_path: Path, raises: bool) -> None:
    """The bench hears no signal itself then: the program's own handler is what shuts it."""
    done: list[str] = []

    def shut(number: int, frame: object) -> None:
        done.append("dark")
        if raises:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, shut)
    try:
        expected = pytest.raises(KeyboardInterrupt) if raises else contextlib.nullcontext()
        with expected, written_hdf5(tmp_path / "a.h5") as file:
            file["a"] = 1
            signal.raise_signal(signal.SIGTERM)
            assert done == ["dark"]
            file["b"] = 2
            done.append("written")
        assert done == ["dark", "written"]
        assert signal.getsignal(signal.SIGTERM) is shut
    finally:
        signal.signal(signal.SIGTERM, before)
    with h5py.File(tmp_path / "a.h5") as file:
        assert (file["a"][()], file["b"][()]) == (1, 2)
