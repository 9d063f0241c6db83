"""A series that is taken up again: what names it is there, what is forecast is taken, pictures are of their scans."""

import errno
import os
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Recording
from nlos.cli.benches import load_bench
from nlos.configs.load import find
from nlos.drivers.trip_latch import TripLatch
from nlos.recon.errors import ReconstructionFailed
from nlos.series.expand import expand
from nlos.series.journal import Journal
from nlos.series.sweep import load_queue
from tests.nlos.conftest import Nlos


def test_a_sweep_whose_bench_is_not_there_can_be_resumed_by_what_it_names(nlos: Nlos, tmp_path: Path) -> None:
    done = nlos("scan", "five_by_five", "--bench", "lab", "--sweep", "dwell_ms=1,2", "-o", "swept")
    assert done.returncode == 3, done.stderr
    assert "`nlos queue swept/queue.yaml` resumes it" in done.stderr
    queue = tmp_path / "swept" / "queue.yaml"
    content = yaml.safe_load(queue.read_text())
    assert content["runs"][0]["sweep"] == {"dwell_ms": [1, 2]}
    assert nlos("queue", "swept/queue.yaml").returncode == 3


def test_a_sweep_that_is_refused_before_its_first_scan_leaves_nothing_and_says_so(nlos: Nlos, tmp_path: Path) -> None:
    done = nlos("scan", "five_by_five", "--sweep", "wall.width_m=1,40", "-o", "swept")
    assert done.returncode in (2, 4), done.stderr
    assert "nothing was begun, so it is gone again" in done.stderr
    assert not (tmp_path / "swept").exists()


def test_a_key_that_is_swept_twice_is_refused(nlos: Nlos, tmp_path: Path) -> None:
    done = nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,2", "--sweep", "dwell_ms=3", "-o", "swept")
    assert (done.returncode, "--sweep dwell_ms: given twice" in done.stderr) == (2, True), done.stderr
    assert not (tmp_path / "swept").exists()


def test_what_is_wrong_with_a_scan_file_itself_is_said_at_its_line(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("wall: {width_m: 1, height_m: 1, rows: 4, cols: 4}\npatern: serpentine\n")
    (tmp_path / "queue.yaml").write_text("runs: [{scan: mine.yaml, set: {dwell_ms: 1}}]\n")
    said = nlos("queue", "queue.yaml").stderr
    assert "mine.yaml:2:1: patern: no such key. Did you mean 'pattern'" in said
    assert "with dwell_ms=1" not in said


FEW = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 2, cols: 2}
pattern: serpentine
dwell_ms: 1
histogram: {bins: 256, bin_width_ps: 32, offset_ns: 10}
"""


def series_of_two(here: Path, **more: object) -> Path:
    (here / "few.yaml").write_text(FEW)
    path = here / "queue.yaml"
    path.write_text(yaml.safe_dump({"runs": [{"scan": "few.yaml"}, {"scan": "few.yaml"}], **more}))
    return path


def test_a_series_that_the_disk_does_not_hold_is_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    queue = series_of_two(tmp_path, folder="a/b")
    free = [1000]
    monkeypatch.setattr("nlos.series.room.shutil.disk_usage", lambda folder: SimpleNamespace(free=free[0]))
    for asked in (["--plan"], []):
        assert run(["queue", str(queue), *asked]) == 6
        said = capsys.readouterr().err
        assert "the series needs" in said
        assert "needs 0 MB" not in said
        assert "there are 0 MB" in said
    assert not list(tmp_path.rglob("*.h5"))
    free[0] = 1 << 40
    assert run(["queue", str(queue)]) == 0
    free[0] = 0  # what is there needs no more
    assert run(["queue", str(queue)]) == 0


def test_a_series_whose_bench_may_have_no_light_is_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its second scan alone is on that bench; `--plan` says so, too."""
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    (tmp_path / "other.yaml").write_text(find("bench", "zero_latency").read_text())
    queue = series_of_two(tmp_path)
    content = yaml.safe_load(queue.read_text())
    content["runs"][1]["bench"], content["folder"] = "other.yaml", "nights/first"
    queue.write_text(yaml.safe_dump(content))
    TripLatch.of_bench(load_bench(str(tmp_path / "other.yaml")).settings).trip("too bright")
    held = sorted(tmp_path.iterdir())
    for asked in (["--plan"], []):
        assert run(["queue", str(queue), *asked]) == 4
        said = capsys.readouterr().err
        assert "--clear-trip" in said
        assert "in run 2-few; no scan was begun" in said
        assert sorted(tmp_path.iterdir()) == held, "not even the folder that was asked for"


@pytest.mark.parametrize("failure", [ReconstructionFailed("not finite"), MemoryError("not finite")])
def test_a_scan_whose_picture_fails_is_done_and_the_series_says_that_it_has_none(
    tmp_path: Path, failure: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    queue = series_of_two(tmp_path, reconstruct="lct", folder="s")
    asked: list[str] = []

    def failing(path: Path, *given: object) -> None:
        asked.append(path.stem)
        raise failure

    monkeypatch.setattr("nlos.series.carry_out.reconstruct_file", failing)
    assert run(["queue", str(queue)]) == 8
    said = capsys.readouterr()
    assert "2 of 2 scans done, 2 without a picture" in said.out
    assert "1-few.h5: no picture: not finite" in said.err
    assert [line.what for line in Journal(tmp_path / "s").lines][-2:] == ["no picture", "no picture"]
    assert run(["queue", str(queue)]) == 8  # asked for again, without another scan
    assert asked == ["1-few", "2-few"] * 2


@pytest.mark.skipif(os.name == "nt", reason="the hook is a POSIX shell's")
def test_an_alarm_tells_of_its_recording_and_the_end_of_the_folder(tmp_path: Path) -> None:
    said = tmp_path / "said"
    write = f'echo "$NLOS_STATUS|$NLOS_RUN|$NLOS_EXIT_CODE" >> {said}'
    queue = series_of_two(tmp_path, folder="s", on_alarm="skip", hooks={"alarm": write, "done": write})
    content = yaml.safe_load(queue.read_text())
    content["runs"][0]["set"] = {"alarms.pile_up": 1e-6}
    queue.write_text(yaml.safe_dump(content))
    assert run(["queue", str(queue)]) == 5
    folder = tmp_path / "s"
    assert said.read_text().splitlines() == [f"alarm|{folder / '1-few.h5'}|5", f"done|{folder}|5"]


def test_a_scan_of_a_series_may_name_another_bench_and_notes_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "few.yaml").write_text(FEW)
    own = {"scan": "few.yaml", "bench": "zero_latency", "sample": "", "tags": ["own"], "repeat": 2}
    said = {"runs": [{"scan": "few.yaml"}, own], "sample": "hat", "operator": "Ada", "tags": ["all"], "folder": "s"}
    (tmp_path / "queue.yaml").write_text(yaml.safe_dump(said))
    found = expand(load_queue(tmp_path / "queue.yaml"))
    assert [each.name for each in found] == ["1-few-hat", "2-few", "3-few-again-2"]
    assert [each.bench.path.stem for each in found] == ["simulated", "zero_latency", "zero_latency"]
    assert [(each.notes.sample, each.notes.operator, each.notes.tags) for each in found] == [
        ("hat", "Ada", ("all",)), ("", "Ada", ("all", "own")), ("", "Ada", ("all", "own"))
    ]  # fmt: skip


def test_a_sweep_that_no_bench_could_begin_is_refused_by_its_reason(nlos: Nlos, tmp_path: Path) -> None:
    done = nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,-1", "-o", "swept")
    assert (done.returncode, "dwell_ms=-1" in done.stderr) == (2, True), done.stderr
    assert not (tmp_path / "swept").exists()


@pytest.mark.parametrize("said", ["dwell_ms", "=1,2", "dwell_ms="])
def test_a_sweep_without_a_key_or_values_is_told_how_it_is_written(nlos: Nlos, said: str) -> None:
    done = nlos("scan", "five_by_five", "--sweep", said, "-o", "swept")
    assert (done.returncode, f"--sweep {said}: write KEY=A,B,C" in done.stderr) == (2, True), done.stderr


@pytest.mark.parametrize("values", ["[1", "{a", "1,@x", "[1]", "2026-01-01", ""])
def test_a_sweep_over_what_is_no_value_is_refused(nlos: Nlos, tmp_path: Path, values: str) -> None:
    done = nlos("scan", "five_by_five", "--sweep", f"dwell_ms={values}", "-o", "swept")
    assert (done.returncode, f"--sweep dwell_ms={values}: " in done.stderr) == (2, True), done.stderr
    assert not (tmp_path / "swept").exists()


@pytest.mark.parametrize("held", [b"\xff\xfe", b"", b"# Written by `nlos scan --sweep`"])
def test_a_sweep_goes_into_no_folder_of_another(nlos: Nlos, tmp_path: Path, held: bytes) -> None:
    (tmp_path / "swept").mkdir()
    (tmp_path / "swept" / "queue.yaml").write_bytes(held)
    done = nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,2", "-o", "swept")
    assert (done.returncode, "swept/queue.yaml: is another series" in done.stderr) == (6, True), done.stderr
    assert [each.read_bytes() for each in (tmp_path / "swept").iterdir()] == [held]


def test_a_sweep_is_put_into_no_file(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "run.h5").write_bytes(b"mine")
    done = nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,2", "-o", "run.h5")
    assert (done.returncode, "is a file, not a folder. Choose another place" in done.stderr) == (6, True), done.stderr
    assert (tmp_path / "run.h5").read_bytes() == b"mine"


def test_a_refused_sweep_leaves_the_folder_that_was_there(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    assert nlos("scan", "five_by_five", "--sweep", "wall.width_m=1,40", "-o", "mine").returncode in (2, 4)
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_sweep_whose_file_the_disk_does_not_take_leaves_none_in_the_way(
    nlos: Nlos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as full:

        def refused(path: Path, *data: object, **words: str) -> int:
            path.touch()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

        full.setattr(Path, "write_bytes", refused)
        full.setattr(Path, "write_text", refused)
        done = nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,2", "-o", "swept")
        assert (done.returncode, "No space left" in done.stderr) == (6, True), done.stderr
    assert not (tmp_path / "swept" / "queue.yaml").exists()
    assert "2 of 2 scans done" in nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,2", "-o", "swept").stdout


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["lct", None])
def test_a_recording_that_is_gone_is_forecast_taken_and_seen_anew(
    nlos: Nlos, tmp_path: Path, method: str | None
) -> None:
    asked = [] if method is None else ["--reconstruct", method]
    nlos("scan", "five_by_five", "--sweep", "dwell_ms=1,2", "-o", "swept", *asked, check=True)
    recording = sorted((tmp_path / "swept").glob("*.h5"))[0]
    picture = recording.with_suffix("") / "reconstruction.h5"
    if method is None:
        nlos("reconstruct", str(recording), "-o", str(picture.parent), check=True)
    recording.unlink()
    if method is not None:  # the clock was an hour ahead then, and is right since
        os.utime(picture, (time.time() + 3600,) * 2)
    before = picture.stat()
    assert "1 of 2 scans to take" in nlos("queue", "swept/queue.yaml", "--plan", check=True).stdout
    done = nlos("queue", "swept/queue.yaml", check=True)
    assert "1 of 2 scans to take" in done.stdout
    with Recording.open(recording) as taken:
        assert len(taken) == 25
    if method is None:
        assert f"holds a picture that is older than {recording.name}" in done.stderr
        assert picture.stat() == before
    else:
        assert before.st_mtime_ns > picture.stat().st_mtime_ns > recording.stat().st_mtime_ns
        os.utime(recording, (time.time() + 3600,) * 2)  # or it was ahead while the scan was taken
        assert picture.name not in nlos("queue", "swept/queue.yaml", check=True).stderr
        assert picture.stat().st_mtime_ns < recording.stat().st_mtime_ns
    assert "0 of 2 scans to take" in nlos("queue", "swept/queue.yaml", "--plan", check=True).stdout
