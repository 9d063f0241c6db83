"""Names, places and sizes that cannot work are refused in a sentence, before anything is opened or moved."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording
from nlos.recon.memory import available_bytes
from tests.command import nlos

SCAN = """\
wall: {width_m: %s, height_m: 0.5, rows: %d, cols: %d}
pattern: serpentine
dwell_ms: 2
histogram: {bins: %d, bin_width_ps: 16, offset_ns: 10}
"""
LONG = "a" * 300


def nlos_(*arguments: str, cwd: Path) -> tuple[int, str, str]:
    done = nlos(cwd, *arguments)
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout, done.stderr


def as_a_process(*arguments: str | bytes, cwd: Path, **variables: str) -> tuple[int, str, str]:
    command = [sys.executable, "-P", "-m", "nlos", *arguments]
    done = subprocess.run(command, cwd=cwd, capture_output=True, env={**os.environ, **variables}, timeout=240)
    err = done.stderr.decode("utf-8", "replace")
    assert "Traceback" not in err
    return done.returncode, done.stdout.decode("utf-8", "replace"), err


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "small.yaml").write_text(SCAN % ("0.5", 4, 4, 256))
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "code", "sentence"),
    [
        (("plan", "small.yaml", "--picture", "p.xyz"), 2, r"a picture is written as \.png"),
        (("plan", "small.yaml", "--picture", "missing/way/p.png"), 2, "is not a folder"),
        (("scan", "small.yaml", "-o", "x.txt"), 2, r"a recording is written as \.h5"),
        (("scan", "small.yaml", "-o", "missing/way/x.h5"), 2, "is not a folder"),
        (("scan", "small.yaml", "-o", "small.yaml/x.h5"), 2, "is not a folder"),
        (("scan", "small.yaml", "-o", f"{LONG}.h5"), 2, "name too long"),
        (("plan", f"{LONG}.yaml"), 2, "name too long"),
        (("info", f"{LONG}.h5"), 2, "name too long"),
        (("reconstruct", f"{LONG}.h5"), 2, "name too long"),
    ],
)
def test_a_name_that_cannot_work_is_refused(folder: Path, arguments: tuple[str, ...], code: int, sentence: str) -> None:
    before = sorted(folder.rglob("*"))
    got, _, err = nlos_(*arguments, cwd=folder)
    assert (got, bool(re.search(sentence, err, re.I))) == (code, True), err
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize(
    ("scan", "sentence"),
    [
        (SCAN % ("0.5", 2000, 2000, 65536), "1048.6 GB of counts"),
        (SCAN % ("500", 8, 8, 256), "metres, not millimetres"),
    ],
)
def test_a_plan_beyond_all_measure_is_answered_at_once(folder: Path, scan: str, sentence: str) -> None:
    (folder / "large.yaml").write_text(scan)
    code, _, err = nlos_("plan", "large.yaml", cwd=folder)
    assert code == 2
    assert sentence in err


def test_names_that_are_no_text_and_a_terminal_of_ascii_work(folder: Path) -> None:
    name = b"na\xffme.h5"
    for variables in ({}, {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"}):
        code, _, err = as_a_process("scan", "small.yaml", "-o", name, "--overwrite", cwd=folder, **variables)
        assert code == 0, err
        for options in ((), ("--json",)):
            code, out, err = as_a_process("info", name, *options, cwd=folder, **variables)
            assert code == 0, err
            assert "complete" in out


def test_a_disk_without_room_for_scan_and_alarm_is_refused_before_the_first_point(folder: Path) -> None:
    much = shutil.disk_usage(folder).free / 1e6 + 1e6
    (folder / "full.yaml").write_text(SCAN % ("0.5", 4, 4, 256) + f"alarms: {{min_free_mb: {much:.1f}}}\n")
    code, _, err = nlos_("scan", "full.yaml", "-o", "x.h5", cwd=folder)
    assert code == 6
    assert "alarms.min_free_mb" in err
    assert not (folder / "x.h5").exists()


def test_other_peoples_files_are_sent_to_import_and_hdf5_keeps_its_sentences(folder: Path) -> None:
    import h5py

    with h5py.File(folder / "plain.h5", "w") as file:
        file["histograms"] = np.ones((4, 4, 64), np.uint16)
        file.attrs["bin_width_s"], file.attrs["wall_size_m"] = 16e-12, 0.5
    assert nlos_("scan", "small.yaml", "-o", "cut.h5", cwd=folder)[0] == 0
    whole = (folder / "cut.h5").read_bytes()
    (folder / "cut.h5").write_bytes(whole[:30_000])
    for verb in (("report",), ("replay", "--speed", "max")):
        code, _, err = nlos_(verb[0], "plain.h5", *verb[1:], cwd=folder)
        assert (code, "nlos import" in err) == (7, True), err
        code, _, err = nlos_(verb[0], "cut.h5", *verb[1:], cwd=folder)
        assert code == 7 or "skipped" in err, err  # a report says what is gone
        assert not re.search(r"unable to|truncated file|errno|object header", err, re.I), err


def test_a_replayed_file_says_that_it_is_one(folder: Path) -> None:
    assert nlos_("scan", "small.yaml", "-o", "run.h5", cwd=folder)[0] == 0
    assert nlos_("replay", "run.h5", "--speed", "max", "-o", "again.h5", cwd=folder)[0] == 0
    with Recording.open(folder / "again.h5") as recording:
        assert any("replayed from run.h5" in warning for warning in recording.header.warnings)
        assert any(event.kind == "replayed" for event in recording.events())
    assert "replayed from run.h5" in nlos_("info", "again.h5", cwd=folder)[1]


def test_memory_is_asked_for_without_the_module_that_windows_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    monkeypatch.setattr(sys, "platform", "win32")
    assert available_bytes() > 0


def test_an_old_python_is_told_so_in_one_line(tmp_path: Path) -> None:
    top = Path(__file__).parents[2]
    for name in ("Makefile", "pyproject.toml", "constraints.txt"):
        shutil.copy(top / name, tmp_path)
    old = tmp_path / "python3"
    old.write_text('#!/bin/sh\n[ "$1" = -V ] && echo Python 3.10.12\n[ "$1" = -c ] && exit 1\nexit 0\n')
    old.chmod(0o755)
    done = subprocess.run(["make", f"PYTHON={old}", "demo"], cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert done.returncode != 0
    said = [line for line in done.stderr.splitlines() if not line.startswith("make")]
    assert len(said) == 1
    assert "Python 3.11 or newer" in said[0]
    assert "3.10.12" in said[0]
    assert not (tmp_path / ".venv").exists()


def test_offsets_of_another_shape_than_the_scan_are_refused(folder: Path) -> None:
    import json

    import h5py

    assert nlos_("scan", "small.yaml", "-o", "run.h5", cwd=folder)[0] == 0
    with h5py.File(folder / "run.h5", "r+") as file:
        said = json.loads(file["header/scan_json"][()])
        said["imported"] = {"time_offset_bins": [[1.0], [1.0, 2.0]]}
        del file["header/scan_json"]
        file["header"].create_dataset("scan_json", data=np.bytes_(json.dumps(said)))
    code, _, err = nlos_("reconstruct", "run.h5", "-o", "out", cwd=folder)
    assert (code, "Traceback" in err) == (7, False), err
    assert "time_offset_bins" in err
