"""A series of scans: every outcome is there whatever went wrong, and the index says what the files say."""

import errno
import json
import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import pytest
import yaml

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Recording, Status
from nlos.cli.exit_codes import UsageError
from nlos.configs.load import ConfigError
from nlos.runs.index import RunsIndex
from nlos.series.carry_out import Series, carry_out, forecast
from nlos.series.journal import Journal
from nlos.series.sweep import load_queue
from tests.acquisition.bad_disk_server import Run, bad_disks

SOAK = os.environ.get("NLOS_SOAK") == "1"
SCANS = 12 if SOAK else 4
ALARM, KILLED, FULL = (3, 6, 9) if SOAK else (2, 3, 4)
SCAN = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 16, cols: 16}
pattern: serpentine
dwell_ms: 1
histogram: {bins: 256, bin_width_ps: 32, offset_ns: 10}
"""
POINTS = 256


def queue_file(folder: Path, **more: object) -> Path:
    """SCANS scans; that of number ALARM meets more light than it allows."""
    (folder / "scan.yaml").write_text(SCAN)
    scans = [
        {"scan": "scan.yaml", "sample": f"object-{number:02d}", "note": f"taken as number {number}",
         "set": {"alarms.pile_up": 1e-6} if number == ALARM else {"dwell_ms": 1 + number % 3}}
        for number in range(1, SCANS + 1)
    ]  # fmt: skip
    content = {"folder": "series", "operator": "Ada", "tags": ["night"], "on_alarm": "skip", "runs": scans, **more}
    path = folder / "queue.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.fixture(scope="module")
def nlos(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    with bad_disks(tmp_path_factory.mktemp("shim")) as bad_disk:
        yield bad_disk


def held(path: Path) -> dict[int, bytes]:
    with Recording.open(path) as recording:
        assert not recording.left_aside()
        return {s.point.number: s.histogram.counts.tobytes() for s in recording.samples()}


@pytest.mark.soak
def test_an_alarm_a_kill_and_a_full_disk_leave_an_outcome_for_every_scan(nlos: Run, tmp_path: Path) -> None:
    queue = queue_file(tmp_path, reconstruct="lct" if SOAK else None)
    killed, full = (f"{number:0{len(str(SCANS))}d}-scan" for number in (KILLED, FULL))
    assert nlos(tmp_path, f"{killed}|kill|0|85|85", "queue", "queue.yaml") == -9
    journal = Journal(tmp_path / "series")
    assert [line.what for line in journal.lines][-1] == "begun"
    assert nlos(tmp_path, f"{full}|write|{errno.ENOSPC}|80|1000000", "queue", "queue.yaml") == 6
    assert "resumes it" in (tmp_path / "stderr").read_text()
    assert nlos(tmp_path, "", "queue", "queue.yaml") == 5, (tmp_path / "stderr").read_text()

    series = Series.of(load_queue(queue))
    journal = Journal(series.folder)
    outcomes = [journal.outcome(each.name) for each in series.runs]
    assert outcomes == ["alarm" if number == ALARM else "done" for number in range(1, SCANS + 1)]
    for number, each in enumerate(series.runs, start=1):
        if number == ALARM:
            continue
        with Recording.open(series.recording(each)) as recording:
            assert recording.status is Status.COMPLETE
            assert recording.header.notes.sample == f"object-{number:02d}"
        assert (series.folder / each.name / "albedo.png").exists() == SOAK
    for number in (KILLED, FULL) if SOAK else (FULL,):  # what a disturbed scan holds is what an undisturbed one holds
        each = series.runs[number - 1]
        (tmp_path / "alone.yaml").write_text(each.scan.text)
        assert nlos(tmp_path, "", "scan", "alone.yaml", "-o", "alone.h5", "--overwrite") == 0
        assert held(series.recording(each)) == held(tmp_path / "alone.h5")

    with RunsIndex(series.folder) as index:
        index.update()
        assert index.count() == SCANS
        for found in index.search():
            with Recording.open(series.folder / found.path) as recording:
                header, records = recording.header, recording.records
                assert found.status == recording.status.name.lower()
                assert (found.summary["points"], found.summary["planned"]) == (len(records), len(recording.plan))
                assert found.summary["photons"] == int(records["total_count"].sum())
                assert found.summary["identity"] == header.identity
                assert (found.summary["sample"], found.summary["note"]) == (header.notes.sample, header.notes.note)
        for number in range(1, SCANS + 1):
            path = f"{series.runs[number - 1].name}.h5"
            assert [each.path for each in index.search([f"sample:object-{number:02d}"])] == [path]
            assert [each.path for each in index.search([f"number {number}", f"object-{number:02d}"])] == [path]
        today = f"{datetime.now():%Y-%m-%d}"
        assert len(index.search([today, "operator:ada", "tag:night"])) == SCANS
        assert [each.status for each in index.search(["status:stopped"])] == ["stopped"]
        before = index.search()
        index.update(afresh=True)
        assert index.search() == before


def quick(folder: Path, **more: object) -> Path:
    """Two scans of a moment, one of them an alarm's."""
    path = queue_file(folder, **more)
    content = yaml.safe_load(path.read_text())
    small = {"wall.rows": 2, "wall.cols": 2}
    content["runs"] = [
        {"scan": "scan.yaml", "set": {**small, "alarms.pile_up": 1e-6}},
        {"scan": "scan.yaml", "set": small},
    ]
    path.write_text(yaml.safe_dump(content))
    return path


def test_an_alarm_ends_a_series_unless_it_is_to_be_skipped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    queue = quick(tmp_path, on_alarm="stop")
    assert run(["queue", str(queue)]) == 5
    assert "the series ended in run 1-scan" in capsys.readouterr().err
    series = Series.of(load_queue(queue))
    journal = Journal(series.folder)
    assert [journal.outcome(each.name) for each in series.runs] == ["alarm", "waiting"]
    assert run(["queue", str(queue)]) == 5  # it is taken up again, unasked
    assert [line.run for line in Journal(series.folder).lines] == ["1-scan"] * 4
    queue.write_text(queue.read_text().replace("on_alarm: stop", "on_alarm: skip"))
    assert run(["queue", str(queue)]) == 5
    assert "1 of 2 scans done, 1 ended by an alarm" in capsys.readouterr().out
    journal = Journal(series.folder)
    assert [journal.outcome(each.name) for each in series.runs] == ["alarm", "done"]
    lines = len(journal.lines)
    assert run(["queue", str(queue)]) == 5
    assert len(Journal(series.folder).lines) == lines  # nothing is taken again
    capsys.readouterr()
    for retry, taken in (([], "0 of 2 scans to take"), (["--retry"], "1 of 2 scans to take")):
        assert run(["queue", str(queue), "--plan", *retry]) == 0
        assert taken in capsys.readouterr().out
    assert run(["queue", str(queue), "--retry"]) == 5
    assert len(Journal(series.folder).lines) == lines + 2
    # Another limit for the alarm is no other measurement: the same run resumes with it.
    queue.write_text(queue.read_text().replace("alarms.pile_up: 1.0e-06", "alarms.pile_up: 0.05"))
    assert run(["queue", str(queue), "--retry"]) == 0
    journal = Journal(series.folder)
    assert [journal.outcome(each.name) for each in series.runs] == ["done", "done"]


@pytest.mark.skipif(os.name == "nt", reason="the hook is a POSIX shell's")
def test_the_end_of_a_series_tells_what_is_true_of_all_its_scans(tmp_path: Path) -> None:
    scan = {"scan": "scan.yaml", "set": {"wall.rows": 4, "wall.cols": 4}}
    (tmp_path / "scan.yaml").write_text(SCAN)
    said = tmp_path / "said"
    queue = {
        "folder": "series", "operator": "Ada", "tags": ["night"],
        "runs": [{**scan, "sample": "hat", "note": "one"}, {**scan, "sample": "cap", "note": "two", "tags": ["red"]}],
        "hooks": {"done": f'echo "$NLOS_OPERATOR|$NLOS_SAMPLE|$NLOS_NOTE|$NLOS_TAGS" > {said}'},
    }  # fmt: skip
    (tmp_path / "queue.yaml").write_text(yaml.safe_dump(queue))
    assert run(["queue", str(tmp_path / "queue.yaml")]) == 0
    assert said.read_text() == "Ada|||night\n"


def test_recordings_have_the_last_word(tmp_path: Path) -> None:
    queue = quick(tmp_path)
    assert run(["queue", str(queue)]) == 5
    series = Series.of(load_queue(queue))
    second = series.runs[1]
    text = Journal(series.folder).path.read_text().splitlines()
    # The program was killed between its last sample and its line; the line before that was cut short.
    Journal(series.folder).path.write_text("\n".join(text[:-1]) + '\n{"at": "2026')
    taken = series.recording(second).stat().st_mtime_ns
    assert Journal(series.folder).outcome(second.name) == "cut off"
    assert run(["queue", str(queue)]) == 5
    assert Journal(series.folder).outcome(second.name) == "done"
    assert series.recording(second).stat().st_mtime_ns == taken
    Journal(series.folder).path.unlink()  # nor does a journal that is lost cost a scan
    assert run(["queue", str(queue)]) == 5
    assert Journal(series.folder).outcome(second.name) == "done"
    assert series.recording(second).stat().st_mtime_ns == taken
    series.recording(second).unlink()  # a recording that is gone is taken again, whatever the journal says
    assert run(["queue", str(queue)]) == 5
    assert series.recording(second).exists()


def test_what_another_series_holds_is_not_touched(tmp_path: Path) -> None:
    queue = quick(tmp_path)
    assert run(["queue", str(queue)]) == 5
    changed = queue.read_text().replace("wall.rows: 2", "wall.rows: 3")
    queue.write_text(changed)
    series = Series.of(load_queue(queue))
    for go in (forecast, carry_out):
        with pytest.raises(UsageError, match="begun with other settings"):
            go(series)
    (tmp_path / "other").mkdir()
    stranger = tmp_path / "other" / "1-scan.h5"
    stranger.write_bytes(b"mine")
    queue.write_text(changed.replace("folder: series", "folder: other"))
    for more in (["--plan"], []):
        assert run(["queue", str(queue), *more]) == 6
        assert stranger.read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"runs": []}, "at least 1"),
        ({"runs": [{"scan": "gone"}]}, "gone: no such file"),
        ({"runs": [{"scan": "scan.yaml", "set": {"dwel_ms": 1}}]}, "Did you mean 'dwell_ms'"),
        ({"runs": [{"scan": "scan.yaml", "sweep": {"dwell_ms": [1, -1]}}]}, "dwell_ms=-1"),
        ({"runs": [{"scan": "scan.yaml", "sweep": {"dwell_ms": []}}]}, "sweep.dwell_ms has no values"),
        ({"runs": [{"scan": "scan.yaml", "set": {"dwell_ms": 1}, "sweep": {"dwell_ms": [1, 2]}}]}, "in both set and"),
        ({"runs": [{"scan": "scan.yaml", "repeat": 1000, "sweep": {"dwell_ms": list(range(1, 12))}}]}, "10000 at most"),
        ({"runs": [{"scan": "scan.yaml", "set": {"wall.width_m": 40.0}}]}, "outside"),
        ({"bench": "simulatd"}, "Did you mean 'simulated'"),
        ({"reconstruct": "lctt"}, "lctt"),
        ({"on_alarm": "ignore"}, "on_alarm"),
    ],
)
def test_a_queue_that_cannot_be_carried_out_is_refused_before_the_first_scan(
    tmp_path: Path, change: dict[str, object], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    queue = quick(tmp_path)
    queue.write_text(yaml.safe_dump({**yaml.safe_load(queue.read_text()), **change}))
    assert run(["queue", str(queue)]) in (2, 4)
    assert words in capsys.readouterr().err
    assert not list(tmp_path.glob("series/*.h5"))


def test_runs_are_called_what_a_disk_takes(tmp_path: Path) -> None:
    """Letters of many languages take several bytes each, and disks count those."""
    scan = "\u65e5" * 60 + ".yaml"
    (tmp_path / scan).write_text(SCAN)
    queue = queue_file(tmp_path, runs=[{"scan": scan, "sample": "\u672c" * 60, "repeat": 2}])
    series = Series.of(load_queue(queue))
    for each in series.runs:
        series.folder.mkdir(exist_ok=True)
        series.recording(each).with_name(f"{each.name}.h5.rescued.0123456789abcdef.new").touch()
    assert len({each.name for each in series.runs}) == 2


def test_a_sweep_is_a_series_that_can_be_resumed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    quick(tmp_path)
    (tmp_path / "scan.yaml").write_text(SCAN.replace("rows: 16, cols: 16", "rows: 2, cols: 2"))
    words = ["scan", str(tmp_path / "scan.yaml"), "--sweep", "dwell_ms=1,2", "--sweep", "wall.rows=2,3", "-o",
             str(tmp_path / "sweep"), "--sample", "hat"]  # fmt: skip
    assert run(words) == 0
    assert "4 of 4 scans to take" in capsys.readouterr().out
    taken = sorted(path.stem for path in (tmp_path / "sweep").glob("*.h5"))
    assert taken == ["1-scan-dwell_ms-1-rows-2-hat", "2-scan-dwell_ms-1-rows-3-hat", "3-scan-dwell_ms-2-rows-2-hat",
                     "4-scan-dwell_ms-2-rows-3-hat"]  # fmt: skip
    with Recording.open(tmp_path / "sweep" / f"{taken[3]}.h5") as recording:
        assert recording.plan.wall.rows == 3
        assert recording.plan.dwell_s[0] == 2e-3
        assert "dwell_ms=2" in recording.header.scan_text
    assert run(["queue", str(tmp_path / "sweep" / "queue.yaml")]) == 0
    assert run([*words, "--resume"]) == 2
    assert run([*words[:2], "--sweep", "dwell_ms"]) == 2


def test_a_forecast_takes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    queue = quick(tmp_path)
    assert run(["--json", "queue", str(queue), "--plan"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["to_take"] == said["scans"] == 2
    assert said["expected_s"] > 0
    assert said["expected_disk_bytes"] > 5e5
    assert not (tmp_path / "series").exists()


def test_a_queue_file_is_checked_by_line(tmp_path: Path) -> None:
    queue = quick(tmp_path)
    queue.write_text("runs:\n  - {scn: demo}\n")
    with pytest.raises(ConfigError, match=r"queue\.yaml:2:\d+: runs\[0\]\.scn: no such key. Did you mean 'scan'"):
        load_queue(queue)
