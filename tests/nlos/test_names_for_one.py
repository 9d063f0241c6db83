"""Names that differ for a person and not for the disk: nothing may be written in the place of something else."""

import os
import unicodedata
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.cli.archive_inputs import stamp
from nlos.cli.archive_record import ArchiveRecord
from nlos.cli.archive_task import Outcome, Task
from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import LONGEST_NAME, names_of, recording_target
from nlos.names_for_one import taken_for_one
from nlos.recipe import Recipe
from nlos.recon.results import NAMES
from nlos.results_folder import ResultsFolder

COMPOSED, APART = (unicodedata.normalize(form, "Sp\u00e4t") for form in ("NFC", "NFD"))


@pytest.fixture
def knows_no_case(monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk of a Mac, as far as folders are made and looked at: names are kept in lower case, decomposed."""

    def folding(call: Callable[..., object]) -> Callable[..., object]:
        def folded(path: os.PathLike[str] | str | int, *more: object, **named: object) -> object:
            if isinstance(path, int):
                return call(path, *more, **named)
            folder, name = os.path.split(os.fspath(path))
            return call(os.path.join(folder, unicodedata.normalize("NFD", name).lower()), *more, **named)

        return folded

    for name in ("mkdir", "stat"):
        monkeypatch.setattr(os, name, folding(getattr(os, name)))


def test_a_disk_says_itself_which_names_it_takes_for_one(tmp_path: Path, knows_no_case: None) -> None:
    assert taken_for_one(tmp_path / "to_come" / "out", ["Scan", "b", "scan"])
    assert taken_for_one(tmp_path, [COMPOSED, APART])
    assert not taken_for_one(tmp_path, ["a", "b", "scan-1", "Scan-2"])
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("knows_no_case")
def test_two_files_do_not_get_one_folder_where_case_is_not_known(tmp_path: Path) -> None:
    files = [tmp_path / "x" / "Scan.h5", tmp_path / "y" / "scan.h5"]
    with pytest.raises(UsageError, match=r"Scan\.h5, scan\.h5: two files of one name"):
        names_of(files, tmp_path)
    assert names_of([files[0], tmp_path / "scan.mat"], tmp_path) == ["Scan.h5", "scan.mat"]


@pytest.mark.skipif(os.name != "posix", reason="Windows knows no case")
def test_where_case_is_known_both_are_done(tmp_path: Path) -> None:
    (tmp_path / "probe").touch()
    if (tmp_path / "PROBE").exists():
        pytest.skip("this disk knows no case")
    assert names_of([tmp_path / "Scan.h5", tmp_path / "scan.h5"], tmp_path) == ["Scan", "scan"]


def task_of(folder: Path, run: Path) -> Task:
    return Task(str(run), run, Recipe("lct"), ResultsFolder(folder))


@pytest.mark.usefixtures("knows_no_case")
def test_a_result_of_another_file_is_not_taken_for_ones_own_under_another_name(tmp_path: Path) -> None:
    first, second = tmp_path / "x.h5", tmp_path / "y.h5"
    first.write_bytes(b"first")
    second.write_bytes(b"second")
    before, now = task_of(tmp_path / "Scan", first), task_of(tmp_path / "scan", second)
    record = ArchiveRecord(tmp_path)
    record.begin([before])
    record.add(before, Outcome(str(first), "done", "", 0, None, "", source=stamp(first)))
    os.mkdir(tmp_path / "scan")
    for name in NAMES:
        (tmp_path / "scan" / name).touch()
    with pytest.raises(FileExistsError, match=r"holds the result of another file, .*x\.h5"):
        record.has(now, overwrite=False, skip_existing=True)
    record.begin([now])  # with --overwrite
    assert [row["file"] for row in record.rows_of([before])] == [str(second)]


def test_a_recordings_name_leaves_room_for_those_beside_it(tmp_path: Path) -> None:
    assert recording_target(tmp_path / ("a" * (LONGEST_NAME - 3) + ".h5"))
    for name in ("a" * (LONGEST_NAME - 2) + ".h5", "\u65e5" * 73 + ".h5"):
        with pytest.raises(UsageError, match="220 at most"):
            recording_target(tmp_path / name)
    with pytest.raises(UsageError, match="no name before"):
        recording_target(tmp_path / "..h5")
    earlier = tmp_path / ("b" * (LONGEST_NAME + 5) + ".h5")
    earlier.touch()
    assert recording_target(earlier) == earlier
