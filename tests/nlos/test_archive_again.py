"""An archive from one call to the next: damaged, changed, moved, stopped or removed files are never taken for done."""

import json
import os
import shutil
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.recording.open_file import open_scan_file
from nlos.cli import archive_crew as archives
from nlos.cli.archive import ended, reconstruct_archive
from nlos.cli.archive_page import page
from nlos.cli.archive_task import Task, attempt
from nlos.cli.exit_codes import Stopped
from nlos.recipe import Recipe
from nlos.response import response_wanted
from nlos.results_folder import ResultsFolder
from tests import scan_texts
from tests.nlos.test_archives import scan

pytestmark = pytest.mark.usefixtures("one_child_reads")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 8 x 8 points."""
    return scan_texts.recorded(tmp_path_factory.mktemp("recorded"), scan_texts.EIGHT_BY_EIGHT)


@pytest.fixture
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    for number in range(3):
        scan(tmp_path / "in" / f"{number}.h5", number)
    return tmp_path


def tasks(
    output: str = "out", method: str = "lct", response: str = "auto", depth_m: tuple[float, float] | None = None
) -> list[Task]:
    recipe = Recipe(method, response=response_wanted(response))
    results = [ResultsFolder(Path(output) / file.stem, depth_m=depth_m) for file in sorted(Path("in").iterdir())]
    files = sorted(Path("in").iterdir())
    return [Task(str(file), file, recipe, each) for file, each in zip(files, results, strict=True)]


def again(output: str = "out", **options: Any) -> list[str]:
    """What a call with --skip-existing does now."""
    return [row["folder"] for row in reconstruct_archive(tasks(output, **options), Path(output), None,
                                                         skip_existing=True).now]  # fmt: skip


def rows(output: str = "out") -> dict[str, dict[str, Any]]:
    return {row["folder"]: row for row in json.loads((Path(output) / "archive.json").read_text())}


def test_a_damaged_recording_is_partial_in_record_page_and_end(inside: Path, recorded: Path) -> None:
    whole = recorded.read_bytes()
    Path("in/cut.h5").write_bytes(whole)
    file = open_scan_file(Path("in/cut.h5"), writable=True)
    with file.handle:
        for row in range(3, 6):
            file.counts.write(row, file.counts.read(row, row + 1)[0] + np.uint32(1))
    done = reconstruct_archive(tasks(), Path("out"), None)
    row = rows()["cut"]
    assert (row["outcome"], row["code"]) == ("partial", 7)
    assert row["reason"].startswith("3 samples are damaged or unreadable and are skipped")
    assert {name: one["outcome"] for name, one in rows().items() if name != "cut"} == dict.fromkeys("012", "done")
    shown = Path("out/index.html").read_text()
    assert "4 of 4 files, 1 of them partial" in shown
    assert "<figure class=partial>" in shown
    assert "3 samples are damaged" in shown
    stopped = ended(done.rows, Path("out"))
    assert stopped is not None
    assert stopped.code == 7
    assert "1 of 4 partial" in str(stopped)
    assert again() == [], "it would not become better"
    assert ended(reconstruct_archive(tasks(), Path("out"), None, skip_existing=True).rows, Path("out")) is not None
    Path("in/cut.h5").write_bytes(whole)
    assert again() == ["cut"]
    assert rows()["cut"]["outcome"] == "done"


def test_a_changed_file_is_done_again_and_a_copy_is_not(inside: Path) -> None:
    reconstruct_archive(tasks(), Path("out"), None)
    os.utime("in/0.h5")
    assert again() == []
    size = Path("in/1.h5").stat().st_size
    scan(Path("in/1.h5"), 77)
    assert Path("in/1.h5").stat().st_size == size, "told by what it holds, not by its length"
    assert again() == ["1"]
    scan(Path("in/2.h5"), 2, bins=128)
    assert again() == ["2"]
    assert again() == []


def test_results_of_an_earlier_version_are_kept_unless_their_file_is_newer(inside: Path) -> None:
    reconstruct_archive(tasks(), Path("out"), None)
    old = [
        {key: value for key, value in row.items() if key not in ("input", "options")}
        | {"folder": f"out/{row['folder']}"}
        for row in rows().values()
    ]
    Path("out/archive.json").write_text(json.dumps(old))
    assert again() == []
    shutil.rmtree("out/2")
    os.utime("in/1.h5", (time.time() + 5, time.time() + 5))
    assert again() == ["1", "2"]
    Path("out/archive.json").unlink()
    assert again() == ["1"], "newer than its result"


def test_results_that_were_made_otherwise_are_refused_by_what_differs(inside: Path) -> None:
    reconstruct_archive(tasks(), Path("out"), None)
    with pytest.raises(FileExistsError, match=r"holds a result of lct by other settings: method was lct, now fk\."):
        again(method="fk")
    with pytest.raises(FileExistsError, match=r"response was None, now 300 ps, a Gaussian, as given\."):
        again(response="300")
    with pytest.raises(FileExistsError, match=r"depth_m was None, now \[0\.2, 1\.0\]\."):
        again(depth_m=(0.2, 1.0))


def test_another_file_of_the_same_name_does_not_take_a_results_place(inside: Path) -> None:
    reconstruct_archive(tasks(), Path("out"), None)
    Path("other").mkdir()
    one = Task("other/1.h5", scan(Path("other/1.h5"), 50), Recipe("lct"), ResultsFolder(Path("out/1")))
    with pytest.raises(FileExistsError, match=f"holds the result of another file, {inside}/in/1.h5"):
        reconstruct_archive([one], Path("out"), None, skip_existing=True)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("how", [shutil.copytree, shutil.move], ids=["copied", "moved"])
def test_results_that_were_moved_or_copied_work_where_they_are(inside: Path, how: Any) -> None:
    reconstruct_archive(tasks(), Path("out"), None)
    shutil.rmtree("out/2")
    how("out", "elsewhere")
    assert again("elsewhere") == ["2"]
    for row in rows("elsewhere").values():
        assert (Path("elsewhere") / row["folder"] / "albedo.png").is_file()
        assert f'src="{row["folder"]}/albedo.png"' in Path("elsewhere/index.html").read_text()
    assert (Path("out") / "2").exists() is False


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("number", "code", "word"), [(signal.SIGINT, 130, "interrupted"),
                                                      (signal.SIGTERM, 143, "terminated")])  # fmt: skip
def test_a_signal_ends_it_with_what_is_done_and_how_to_resume(
    inside: Path, monkeypatch: pytest.MonkeyPatch, number: int, code: int, word: str
) -> None:
    def stopped_in_the_second(task: Task) -> Any:
        if task.file == "in/1.h5":
            signal.raise_signal(number)
        return attempt(task)

    monkeypatch.setattr(archives, "attempt", stopped_in_the_second)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(Stopped, match=f"{word}: 1 of 3 files have results in out.*--skip-existing takes the rest") as e:
        reconstruct_archive(tasks(), Path("out"), None)
    assert e.value.code == code
    assert signal.getsignal(signal.SIGTERM) == before
    assert {name: row["outcome"] for name, row in rows().items()} == {"0": "done", "1": "unfinished", "2": "unfinished"}
    monkeypatch.setattr(archives, "attempt", attempt)
    assert again() == ["1", "2"]


def test_killed_without_a_word_its_record_says_what_is_not_done(inside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[list[str]] = []

    def looked_at(task: Task) -> Any:
        seen.append([row["outcome"] for row in rows().values()])
        return attempt(task)

    monkeypatch.setattr(archives, "attempt", looked_at)
    reconstruct_archive(tasks(), Path("out"), None)
    assert seen[0] == ["unfinished"] * 3


def test_a_removed_file_that_had_failed_is_forgotten_and_said(inside: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("in/torn.h5").write_bytes(b"not a scan")
    reconstruct_archive(tasks(), Path("out"), None)
    assert rows()["torn"]["outcome"] == "failed"
    Path("in/torn.h5").unlink()
    Path("in/0.h5").unlink()
    again()
    assert "in/torn.h5: is no longer there; archive.json forgets it (failed)" in capsys.readouterr().err
    assert sorted(rows()) == ["0", "1", "2"], "results stay, whatever became of their file"


def test_what_was_there_is_not_said_again(inside: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from nlos.__main__ import run

    words = ["reconstruct", "in", "-o", "out", "--skip-existing"]
    assert run(words) == 0
    assert capsys.readouterr().out.count("albedo.png") == 3
    scan(Path("in/3.h5"), 3)
    assert run(words) == 0
    said = capsys.readouterr().out
    assert said.count("albedo.png") == 1
    assert "out/3" in said
    assert run([*words, "-v"]) == 0
    assert capsys.readouterr().out.count("albedo.png") == 4


def test_more_words_are_no_traceback_of_what_was_said(inside: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from nlos.__main__ import run

    Path("in/torn.h5").write_bytes(b"not a scan")
    assert run(["reconstruct", "in", "-o", "out", "-v"]) != 0
    said = capsys.readouterr().err
    assert "in/torn.h5" in said
    assert "Traceback" not in said


def test_names_and_reasons_are_escaped_in_the_page() -> None:
    row = {
        "file": "<a>",
        "outcome": "partial",
        "reason": "<b>",
        "code": 7,
        "seconds": None,
        "folder": "<c>",
        "method": "lct",
    }
    shown = page([row, row | {"outcome": "failed"}])
    assert "1 of 2 files, 1 of them partial" in shown
    assert all(word not in shown for word in ("<a>", '"<c>', "<td><b>"))
