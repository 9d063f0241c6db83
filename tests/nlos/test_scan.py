"""`nlos scan` as a user meets it: what it writes, what it refuses, and with which exit code."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]


def test_a_scan_is_recorded_exported_and_not_taken_twice(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    done = nlos("scan", str(small), "-o", "run.h5", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert (answer["points"], answer["planned"], answer["status"]) == (16, 16, "complete")
    before = (tmp_path / "run.h5").read_bytes()
    assert nlos("scan", str(small), "-o", "run.h5").returncode == 6
    again = nlos("scan", str(small), "-o", "run.h5", "--resume", "--json")
    assert (again.returncode, json.loads(again.stdout)["taken"]) == (0, 0)
    assert (tmp_path / "run.h5").read_bytes() == before
    assert nlos("verify", "run.h5").returncode == 0
    assert nlos("export", "run.h5", "--to", "npz", "-o", "run.npz").returncode == 0
    refused = nlos("export", "run.h5", "--to", "mat,ply")
    assert refused.returncode == 7
    assert "run.h5: is a recording, and ply is a format of pictures" in refused.stderr
    assert not (tmp_path / "run.mat").exists()
    exported = np.load(tmp_path / "run.npz")
    assert exported["histograms"].shape == (4, 4, 1024)
    assert np.allclose(exported["exposure_s"], 2e-3)


def test_a_picture_that_lies_where_the_scans_would_go_is_told_before_any_light(
    nlos: Nlos, small: Path, tmp_path: Path
) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "reconstruction.h5").write_bytes(b"of yesterday")
    refused = nlos("scan", str(small), "-o", "run.h5", "--reconstruct", "lct")
    assert (refused.returncode, "run: holds a picture" in refused.stderr) == (6, True), refused.stderr
    assert not (tmp_path / "run.h5").exists()
    assert nlos("scan", str(small), "-o", "run.h5").returncode == 0  # which makes none
    assert (tmp_path / "run" / "reconstruction.h5").read_bytes() == b"of yesterday"
    assert nlos("scan", str(small), "-o", "other.h5", "--reconstruct", "lct").returncode == 0
    assert (tmp_path / "other" / "reconstruction.h5").exists()


def test_a_resumed_scan_says_what_it_could_not_read(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    (tmp_path / "run.h5").write_bytes(b"no recording")
    done = nlos("scan", str(small), "-o", "run.h5", "--resume")
    assert done.returncode == 0, done.stderr
    assert "cannot be read as a recording, so the scan begins anew; it is kept as" in done.stderr
    assert (tmp_path / "run.h5.unreadable").read_bytes() == b"no recording"


def test_notes_that_are_not_utf_8_are_refused_before_anything_moves(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    done = nlos("scan", str(small), "-o", "run.h5", "--note", "\udce4rger")
    assert done.returncode == 2
    assert "is not UTF-8 text" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "run.h5").exists()


def test_a_complete_scan_that_is_resumed_still_gets_its_picture(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    assert nlos("scan", str(small), "-o", "run.h5").returncode == 0
    for _ in range(2):  # the second time it is there
        again = nlos("scan", str(small), "-o", "run.h5", "--resume", "--reconstruct", "lct")
        assert again.returncode == 0, again.stderr
        assert "nothing was left to take" in again.stdout
        assert "was made" not in again.stderr
    assert (tmp_path / "run" / "albedo.png").exists()
    other = nlos("scan", str(small), "-o", "run.h5", "--resume", "--reconstruct", "fk")
    assert other.returncode == 0
    assert "run: is there and holds a picture by lct, so none by fk was made" in other.stderr


@pytest.mark.parametrize(
    ("change", "place", "words"),
    [
        ("dwell_ms: -2", "bad.yaml:3:1: dwell_ms", "greater than"),
        ("dwell_ms: 1e-3", "bad.yaml:3:1: dwell_ms", "1.0e-3"),
        ("dwell_ms: 1:30", "bad.yaml:3:11: dwell_ms", "YAML reads 1:30 as 90"),
        ("dwell_ms: 010", "bad.yaml:3:11: dwell_ms", "YAML reads 010 as 8"),
        ("dwell_ms: 2\ndwell_ms: 3", "bad.yaml:4:1: dwell_ms", "given twice"),
        ("dwell_ms: 2\npatern: raster", "bad.yaml:4:1: patern", "Did you mean 'pattern'"),
    ],
)
def test_bad_yaml_is_refused_by_line_before_anything_moves(
    nlos: Nlos, small: Path, tmp_path: Path, change: str, place: str, words: str
) -> None:
    (tmp_path / "bad.yaml").write_text(small.read_text().replace("dwell_ms: 2", change))
    done = nlos("scan", "bad.yaml", "-o", "run.h5", "--wire-log", "wire.log")
    assert done.returncode == 2
    assert place in done.stderr
    assert words in done.stderr
    assert not (tmp_path / "run.h5").exists()
    assert not (tmp_path / "wire.log").exists()


def test_a_wall_beyond_the_mirrors_reach_is_refused_with_4(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    (tmp_path / "wide.yaml").write_text(small.read_text().replace("width_m: 0.5", "width_m: 12"))
    done = nlos("scan", "wide.yaml", "-o", "run.h5")
    assert done.returncode == 4
    assert "wall point x = " in done.stderr
    assert not (tmp_path / "run.h5").exists()


def test_a_bench_without_a_shutter_wants_to_be_agreed_to(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    bench = Path(__file__).parents[2] / "configs" / "bench" / "simulated.yaml"
    own = tmp_path / "bench.yaml"
    own.write_text(bench.read_text().replace("model: tcspc488\ngeometry", "model: none\ngeometry"))
    assert "model: none" in own.read_text()
    assert nlos("scan", str(small), "--bench", str(own), "-o", "run.h5").returncode == 2
    done = nlos("scan", str(small), "--bench", str(own), "-o", "run.h5", "--no-shutter")
    assert done.returncode == 0, done.stderr
    assert "no shutter" in done.stderr
    assert "no shutter" in nlos("info", "run.h5").stdout


def test_the_wire_log_holds_every_byte(nlos: Nlos, small: Path, tmp_path: Path) -> None:
    assert nlos("scan", str(small), "-o", "run.h5", "--wire-log", "wire.log").returncode == 0
    lines = (tmp_path / "wire.log").read_text().splitlines()
    assert any("SAO1-" in line for line in lines)
    assert any("OUTP:SHUT OPEN" in line for line in lines)
    shut = [line for line in lines if "OUTP:SHUT" in line and ">" in line]
    assert "CLOS" in shut[-1] or "?" in shut[-1]


def test_a_scan_is_aimed_by_measured_constants_and_refuses_those_of_another_bench(
    nlos: Nlos, small: Path, tmp_path: Path
) -> None:
    small.write_text(small.read_text().replace("rows: 4, cols: 4", "rows: 12, cols: 12").replace("0.5", "1.0"))
    assert nlos("scan", str(small), "-o", "run.h5").returncode == 0
    assert nlos("calibrate", "run.h5", "-o", "mine.h5").returncode == 0
    done = nlos("scan", str(small), "-o", "again.h5", "--constants", "mine.h5")
    assert done.returncode == 0, done.stderr
    assert "constants: mine.h5" in done.stderr
    with Recording.open(tmp_path / "again.h5") as recording:
        assert json.loads(recording.header.constants_json)["sources"] == ["run.h5"]
    other = nlos("scan", str(small), "--bench", "optotune", "-o", "other.h5", "--constants", "mine.h5")
    assert other.returncode == 7
    assert "Calibrate with a recording of this bench" in other.stderr
    assert not (tmp_path / "other.h5").exists()
