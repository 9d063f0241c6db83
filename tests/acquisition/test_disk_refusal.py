"""What a disk does not give is no damage of the file; what is no file is called by what it is."""

import errno
import os
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from nlos.__main__ import run
from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers import isolated_child
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.untrusted_hdf5 import open_hdf5
from nlos.acquisition.recording.disk_refusal import disk_refusal, told_of
from nlos.acquisition.served.ticket import Ticket
from nlos.calibration.constants import load_response
from nlos.calibration_input import read_spots
from nlos.recon.whole_files import whole_files
from nlos.whole_file import whole_file

fcntl = pytest.importorskip("fcntl", reason="Windows has other locks, and no pipes among its files")


@pytest.fixture
def plain(tmp_path: Path) -> Path:
    path = tmp_path / "plain.h5"
    with h5py.File(path, "w") as file:
        file["histograms"], file["counts"] = np.ones((4, 4, 32)), np.exp(-((np.arange(32.0) - 9) ** 2))
        file.attrs.update({"bin_width_s": 32e-12, "wall_size_m": 0.7})
    return path


def test_files_on_a_file_system_without_locks_are_read(plain: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = h5py.File

    def without_locks(path: Path, mode: str, locking: object = None) -> h5py.File:
        if locking is not False:
            raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))
        return real(path, mode, locking=False)

    monkeypatch.setattr(h5py, "File", without_locks)
    assert read_any(plain).held.counts.size == 512
    assert load_response(plain).density.size


def test_a_file_that_another_program_writes_is_not_called_damaged(plain: Path) -> None:
    with plain.open("rb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(StorageError, match=r"plain\.h5: another program has it open"), open_hdf5(plain):
            pass
    with open_hdf5(plain):
        pass


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE, errno.ETIMEDOUT])
def test_what_the_disk_does_not_give_is_no_damage_whatever_a_reader_makes_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def reads(path: Path, *_: object) -> None:
        try:
            raise OSError(number, os.strerror(number))
        except OSError as error:
            raise InvalidData(f"{path}: is damaged") from error

    monkeypatch.setattr(isolated_child, "read_any", reads)
    given = dict.fromkeys(("wall_m", "bin_width_s", "axes", "rectified"))
    request: dict[str, Any] = {"path": "/far/a.ptu", "shown": "a.ptu", "reader": None, "given": given, "folder": "."}
    answer = isolated_child._answer(request | {"describe": True})
    assert list(answer) == ["storage"]
    assert os.strerror(number) in str(answer["storage"])
    assert "damaged" not in str(answer["storage"])
    assert disk_refusal("a.ptu", InvalidData("of its own accord")) is None


def test_a_pipe_is_called_one_and_never_waited_for(tmp_path: Path) -> None:
    pipe, link = tmp_path / "pipe.h5", tmp_path / "link.h5"
    os.mkfifo(pipe)
    link.symlink_to("nowhere.h5")
    for read in (read_any, read_spots_by_ruler, Ticket.load):
        with pytest.raises(FileNotFoundError, match=r"pipe\.h5: is a pipe"):
            read(pipe)
    with pytest.raises(FileNotFoundError, match=r"link\.h5: is a link to nowhere\.h5"):
        read_any(link)


def read_spots_by_ruler(path: Path) -> object:
    return read_spots(path, 1e-3)


@pytest.mark.parametrize(
    ("number", "cure"), [(errno.ENOSPC, "Free disk space"), (errno.EINVAL, "another place with -o")]
)
@pytest.mark.parametrize("named", [False, True])
def test_what_a_disk_does_not_take_is_told_of_the_result_that_was_asked_for(
    tmp_path: Path, number: int, cure: str, named: bool
) -> None:
    def refuse(partial: Path) -> None:
        raise OSError(number, os.strerror(number), *([str(partial)] if named else []))

    with pytest.raises(StorageError, match=cure) as of_one, whole_file(tmp_path / "new.npz") as partial:
        refuse(partial)
    with pytest.raises(StorageError, match=cure) as of_many, whole_files(tmp_path / "made") as folder:
        refuse(folder / "albedo.png")
    assert "new.npz: cannot be written" in str(of_one.value)
    assert f"made{'/albedo.png' if named else ''}: cannot be written" in str(of_many.value)
    assert ".part" not in str(of_one.value) + str(of_many.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [("report",), ("verify",), ("info",)])
def test_a_link_that_leads_back_to_itself_is_no_bug(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    loop = tmp_path / "loop.h5"
    loop.symlink_to("loop.h5")
    assert run([*words, str(loop)]) == 2
    assert "loop.h5: is a link to loop.h5, and nothing is there" in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_told_of_as_what_would_be_in_it(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = r"out: cannot be written \(Disk quota exceeded\)\. Free disk space"
    with pytest.raises(StorageError, match=words), told_of(out, out / ".part"):
        raise OSError(errno.EDQUOT, "Disk quota exceeded", str(out))
    with pytest.raises(FileExistsError), told_of(out, out / ".part"):
        raise FileExistsError(errno.EEXIST, "File exists", str(out))
