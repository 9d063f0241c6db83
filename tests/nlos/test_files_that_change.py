"""Files that somebody writes, replaces, cuts or deletes while they are read: a named error or the right result, and
never a mixture of two files."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.__main__ import run
from nlos.acquisition.errors import StorageError
from nlos.acquisition.exporters.npz import write_npz
from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.importers.isolated import IsolatedReader
from nlos.acquisition.importers.unchanged import unchanged

Change = Callable[[Path], None]


def grown(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"more")


def cut(path: Path) -> None:
    os.truncate(path, path.stat().st_size // 2)


def replaced(path: Path) -> None:
    other = path.with_name("other")
    shutil.copy2(path, other)
    other.replace(path)


class Disturbed(IsolatedReader):
    """Of which somebody changes the file as soon as it was asked for."""

    def __init__(self, path: Path, change: Change, before: bool) -> None:
        super().__init__()
        self._path, self._change, self._before = path, change, before

    def _exchange(self, request: str, deadline_s: float) -> str:
        if self._before:
            self._change(self._path)
        line = super()._exchange(request, deadline_s)
        if not self._before:
            self._change(self._path)
        return line


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    path = tmp_path / "foreign.h5"
    with h5py.File(path, "w") as file:
        file["histograms"] = np.ones((2, 2, 64), np.uint16)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = 32e-12, 1.0
    return path


@pytest.mark.parametrize(("change", "before"), [(grown, False), (cut, True), (cut, False), (replaced, False)])
def test_a_file_of_another_program_that_changes_while_it_is_read_is_refused(
    foreign: Path, change: Change, before: bool
) -> None:
    with Disturbed(foreign, change, before) as reader, pytest.raises(StorageError, match="changed while it was read"):
        reader.read(foreign)


def test_one_that_is_deleted_once_it_was_read_was_read(foreign: Path) -> None:
    with Disturbed(foreign, Path.unlink, False) as reader:
        assert reader.read(foreign).held.counts.sum() == 256


def test_a_recording_may_grow_but_no_other_may_take_its_place(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(b"samples")
    with unchanged(path, grows=True):
        grown(path)
    with pytest.raises(StorageError, match="changed while it was read"), unchanged(path, grows=True):
        replaced(path)


def test_formats_of_two_scans_are_not_written_as_those_of_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from nlos.cli import export

    path = tmp_path / "run.h5"
    assert run(["scan", "five_by_five", "-o", str(path)]) == 0

    def write_while_another_scan_ends(arrays: ScanArrays, target: Path) -> list[str]:
        replaced(path)
        return write_npz(arrays, target)

    monkeypatch.setattr(export, "write_npz", write_while_another_scan_ends)
    assert run(["export", str(path), "--to", "npz,mat"]) == 6
    assert "changed while it was read" in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["run.h5"]
