"""What a stranger types by mistake, or asks of the wrong file, is answered with what to do instead."""

import json
from pathlib import Path

import numpy as np
import pytest

from nlos.__main__ import run
from nlos.acquisition.recording.open_file import open_scan_file
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.training.scene_files import write_scene
from tests import scan_texts
from tests.command import nlos
from tests.nlos.test_archives import scan


def said(words: list[str], capsys: pytest.CaptureFixture[str], code: int) -> str:
    assert run(words) == code
    captured = capsys.readouterr()
    return captured.out + captured.err


def test_weights_are_no_method(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(tmp_path / "s.h5", "stars", 0, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    words = ["evaluate", "--data", str(tmp_path), "--methods", "lct,mine.safetensors", "-o", str(tmp_path / "out")]
    told = said(words, capsys, 2)
    assert "'mine.safetensors' are weights, no method" in told
    assert "NAME=mine.safetensors" in told
    told = said(["reconstruct", str(tmp_path / "s.h5"), "--method", "mine.safetensors"], capsys, 2)
    assert "--weights mine.safetensors" in told


def test_info_knows_scenes_with_truth_and_weights_that_ship(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_scene(tmp_path / "s.h5", "stars", 0, WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12))
    told = said(["info", str(tmp_path / "s.h5")], capsys, 0)
    assert "scene with its truth" in told
    assert "counts_p1, counts_p20, counts_p5, transient" in told
    assert "nlos evaluate --data" in told
    assert "not a scan" not in told
    assert "method" in said(["info", "lfe"], capsys, 0)
    assert "no such file" in said(["info", "neither"], capsys, 2)


def test_a_damaged_recording_is_not_called_complete_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded = scan_texts.recorded(tmp_path, scan_texts.EIGHT_BY_EIGHT)
    file = open_scan_file(recorded, writable=True)
    with file.handle:
        file.counts.write(3, file.counts.read(3, 4)[0] + 1)
    assert "damaged since: `nlos verify` says where" in said(["info", str(recorded)], capsys, 0)


def test_a_file_of_no_bytes_is_called_empty(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "a.h5").touch()
    told = said(["reconstruct", str(tmp_path / "a.h5"), "-o", str(tmp_path / "out")], capsys, 7)
    assert "a.h5: is empty, 0 bytes" in told
    assert "b''" not in told


def test_a_training_file_that_is_not_there_is_called_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert "no training file of that name. Did you mean 'smoke'?" in said(["train", "smokee"], capsys, 2)


def test_lines_about_a_file_of_an_archive_name_it_and_seconds_are_the_methods(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    one = scan_texts.recorded(tmp_path, scan_texts.EIGHT_BY_EIGHT)
    scan(tmp_path / "other.h5", 1)
    told = said(["reconstruct", one.name, "other.h5", "-o", "out", "-v"], capsys, 0)
    about = [line for line in told.splitlines() if "response: " in line or "calibrated: " in line]
    assert about
    assert all(line.partition(": ")[0] in (one.name, "other.h5") for line in about), about
    for row in json.loads(Path("out/archive.json").read_text()):
        assert 0 < row["method_seconds"] < row["seconds"]
        assert f"out/{row['folder']}: reconstruction.h5" in told
        assert f"({row['method']}, {row['method_seconds']:.2f} s)" in told


@pytest.mark.parametrize(
    "words",
    [
        "info RUN", "verify RUN", "recover RUN -o new.h5", "report RUN", "export RUN --to npz", "replay RUN",
        "serve RUN", "reconstruct RUN -o out", "calibrate RUN", "import RUN -o new.h5",
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    ("given", "there"), [("run", "run.h5"), ("Run.h5", "run.h5"), ("ru.h5", "run.h5"), ("d", "d.h5")]
)
def test_a_run_that_is_not_there_is_told_with_the_one_that_is(
    words: str, given: str, there: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("d").mkdir()  # as results lie beside their recording
    Path(there).touch()
    assert f"Did you mean {there}?" in said(words.replace("RUN", given).split(), capsys, 2)


def test_nothing_is_offered_that_is_not_alike(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "run.h5").touch()
    (tmp_path / "other.h5").mkdir()
    assert "Did you mean" not in said(["info", str(tmp_path / "other")], capsys, 2)
    assert "Did you mean" not in said(["info", str(tmp_path / "gone" / "run")], capsys, 2)


@pytest.mark.parametrize("name", ["new", "new.txt", "new.npz"])
def test_what_recover_writes_is_called_a_recording(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = scan_texts.recorded(tmp_path, scan_texts.EIGHT_BY_EIGHT)
    told = said(["recover", str(recorded), "-o", str(tmp_path / name)], capsys, 2)
    assert "a recording is written as .h5, .hdf5" in told
    assert not (tmp_path / name).exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["shutter", "close", "--bench", ""], "--bench is empty"),  # the simulated one was closed, and nothing said so
        (["scan", "five_by_five", "--bench=", "-o", "run.h5"], "--bench is empty"),
        (["reconstruct", ""], "one word of this command is empty"),  # every file of the folder was reconstructed
        (["reconstruct", "scan.npz", "-o", ""], "-o is empty"),
        (["evaluate", "--data", "scan.npz", "--output="], "--output is empty"),
    ],
)
def test_a_variable_that_is_not_set_names_no_file_and_no_bench(tmp_path: Path, words: list[str], said: str) -> None:
    np.savez(tmp_path / "scan.npz", histograms=np.ones((4, 4, 16)), bin_width_s=64e-12, wall_size_m=1.0)
    done = nlos(tmp_path, *words)
    assert (done.returncode, f"{said}. Is a variable of the shell not set?" in done.stderr) == (2, True), done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["scan.npz"]


def test_what_is_said_of_a_scan_may_be_nothing(tmp_path: Path) -> None:
    words = ["scan", "five_by_five", "--bench", "zero_latency", "-o", "run.h5", "--sample", "", "--note=a="]
    nlos(tmp_path, *words, check=True)
