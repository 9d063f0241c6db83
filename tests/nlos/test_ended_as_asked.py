"""A scan that ended because its picture was good enough reads so; one that somebody broke off does not."""

import json
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from nlos.__main__ import run
from nlos.acquisition.recording.ended_as_asked import AS_ASKED, NOTHING_LEFT, status_word, word_of
from nlos.acquisition.recording.layout import Status
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.replay import replay as played
from nlos.acquisition.sample import Sample
from nlos.runs.index import RunsIndex
from tests import command
from tests.nlos.conftest import Nlos

TWO_PASSES = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: coarse_to_fine, batch: 16}
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
exposure: {kind: two_pass, counts: 400, again_ms: 4}
"""


@pytest.fixture(scope="module")
def stable(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A scan until its picture stood still, and the document that the command printed."""
    there = tmp_path_factory.mktemp("stable")
    words = ("--json", "scan", "anytime", "-o", "run.h5", "--until", "stable")
    return there / "run.h5", command.nlos(there, *words, check=True).stdout


@pytest.fixture
def run_h5(stable: tuple[Path, str], tmp_path: Path) -> str:
    """What was printed of it; a copy of the recording is `run.h5`."""
    shutil.copy(stable[0], tmp_path)
    return stable[1]


def test_a_scan_until_its_picture_stands_still_reads_as_ended_as_asked(nlos: Nlos, tmp_path: Path, run_h5: str) -> None:
    said = json.loads(run_h5)
    assert (said["status"], said["until"]["reached"]) == (AS_ASKED, True)
    assert said["points"] < said["planned"]
    verified = nlos("--json", "verify", "run.h5", check=True)
    found = json.loads(verified.stdout)
    assert (found["status"], found["complete"], found["intact"]) == (AS_ASKED, False, True)
    assert "ended as asked" in nlos("verify", "run.h5", check=True).stdout
    assert json.loads(nlos("--json", "info", "run.h5", check=True).stdout)["status"] == AS_ASKED
    assert "  ended as asked  " in nlos("runs", "--folder", ".", check=True).stdout
    nlos("recover", "run.h5", "-o", "copy.h5", check=True)
    nlos("verify", "copy.h5", check=True)
    with Recording.open(tmp_path / "run.h5") as recording:
        assert recording.status is Status.INTERRUPTED


def test_a_scan_of_two_passes_that_ended_as_asked_reads_so_everywhere(
    nlos: Nlos, tmp_path: Path, viewing: Callable[..., AbstractContextManager[Any]]
) -> None:
    """The second pass, of what the first came to and found dim, runs out: nobody ends it."""
    (tmp_path / "two.yaml").write_text(TWO_PASSES)
    done = nlos(
        "--json", "scan", "two.yaml", "-o", "run.h5", "--until", "stable:0.5", "--reconstruct", "lct", check=True
    )
    said = json.loads(done.stdout)
    assert (said["status"], said["until"]["reached"]) == (AS_ASKED, True)
    assert said["points"] < said["planned"]
    assert json.loads(nlos("--json", "verify", "run.h5", check=True).stdout)["status"] == AS_ASKED
    assert json.loads(nlos("--json", "runs", "--folder", ".", check=True).stdout)["runs"][0]["status"] == AS_ASKED
    with RunsIndex(tmp_path) as index, closing(sqlite3.connect(index.place)) as older:
        older.execute("PRAGMA user_version = 4")  # of when such a scan was called interrupted
    with RunsIndex(tmp_path) as index:
        assert (index.update().read, index.search()[0].status) == (1, AS_ASKED)
    nlos("report", "run.h5", "--methods", "lct", check=True)
    page = (tmp_path / "run.html").read_text()
    assert "points were measured, and the scan ended as asked." in page
    assert f"<td>ended as asked, {said['points']} of {said['planned']} points</td>" in page
    with viewing("run.h5", "--method", "lct") as there:
        assert there.waits(lambda state: state["over"])["status"] == AS_ASKED


def test_a_scan_that_replaces_another_looks_at_none_of_its_points(nlos: Nlos, run_h5: str) -> None:
    words = ("--json", "scan", "anytime", "-o", "run.h5", "--until", "stable", "--overwrite")
    first, again = json.loads(run_h5), json.loads(nlos(*words, check=True).stdout)
    assert (again["taken"], again["points"]) == (first["points"], first["points"])


@pytest.mark.usefixtures("run_h5")
def test_what_is_replayed_says_how_the_scan_had_ended(nlos: Nlos) -> None:
    nlos("replay", "run.h5", "--speed", "max", "-o", "again.h5", check=True)
    found = json.loads(nlos("--json", "verify", "again.h5", check=True).stdout)
    assert (found["status"], found["intact"]) == (AS_ASKED, True)
    assert json.loads(nlos("--json", "info", "again.h5", check=True).stdout)["status"] == AS_ASKED


@pytest.mark.usefixtures("run_h5")
def test_a_replay_that_is_broken_off_is_interrupted(
    nlos: Nlos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever the scan that it replays had come to."""

    def broken_off(recording: Recording, pace: float | None) -> Iterator[Sample]:
        yield from islice(played(recording, pace), 5)
        raise KeyboardInterrupt

    nlos("scan", "five_by_five", "-o", "whole.h5", check=True)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nlos.cli.replay.play", broken_off)
    for name in ("run", "whole"):
        assert run(["replay", f"{name}.h5", "--speed", "max", "-o", f"{name}-again.h5"]) == 130
        with Recording.open(tmp_path / f"{name}-again.h5") as recording:
            assert (len(recording), status_word(recording)) == (5, "interrupted")


@pytest.mark.usefixtures("run_h5")
def test_damage_to_a_scan_that_ended_as_asked_is_damage(nlos: Nlos, tmp_path: Path) -> None:
    with Recording.open(tmp_path / "run.h5") as recording:
        counts = recording.counts_of(0, 1).astype("<u4").tobytes()
    whole = (tmp_path / "run.h5").read_bytes()
    at = whole.index(counts) + len(counts) // 2
    (tmp_path / "run.h5").write_bytes(whole[:at] + bytes(each ^ 255 for each in whole[at : at + 4]) + whole[at + 4 :])
    done = nlos("verify", "run.h5")
    assert (done.returncode, "not every sample is what was measured" in done.stderr) == (7, True), done.stdout


@pytest.mark.parametrize(
    ("status", "said", "word"),
    [
        (Status.INTERRUPTED, [NOTHING_LEFT, "interrupted"], AS_ASKED),
        (Status.INTERRUPTED, ["interrupted"], "interrupted"),
        (Status.INTERRUPTED, [NOTHING_LEFT, "interrupted", "interrupted"], "interrupted"),
        (Status.INTERRUPTED, ["interrupted", NOTHING_LEFT, "interrupted"], AS_ASKED),
        (Status.STOPPED, [NOTHING_LEFT, "stopped"], "stopped"),
        (Status.COMPLETE, [NOTHING_LEFT, "interrupted", "complete"], "complete"),
        (Status.RUNNING, [NOTHING_LEFT, "interrupted"], "running"),
    ],
)
def test_only_its_last_words_tell(status: Status, said: list[str], word: str) -> None:
    events = [("shutter", "opened"), *(("scan", each) for each in said), ("shutter", "closed")]
    assert word_of(status, events) == word
