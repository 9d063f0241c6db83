"""No verb writes over what it reads, and a folder is no file: refused in a sentence, with --overwrite, too."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import nlos
from nlos.recon.errors import InvalidSettings
from tests.command import nlos as command


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("taken")
    command(folder, "scan", "five_by_five", "-o", "run.h5", check=True)
    command(folder, "export", "run.h5", "--to", "npz", "-o", "data.npz", check=True)
    return folder


@pytest.fixture
def folder(taken: Path, tmp_path: Path) -> Path:
    for name in ("run.h5", "data.npz"):
        shutil.copy(taken / name, tmp_path / name)
    shutil.copy(taken / "run.h5", tmp_path / "other.h5")
    shutil.copy(taken / "run.h5", tmp_path / "page.html")
    os.link(tmp_path / "run.h5", tmp_path / "linked.h5")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("report run.h5 -o run.h5", "a page is written as .html"),
        ("report run.h5 other.h5 -o third.h5", "a page is written as .html"),
        ("report page.html -o page.html", "page.html: is a recording that is reported on"),
        ("report page.html", "page.html: is a recording that is reported on"),
        ("calibrate run.h5 -o run.h5", "run.h5: is a file that is calibrated from"),
        ("calibrate other.h5 run.h5 -o linked.h5", "linked.h5: is a file that is calibrated from"),
        ("scan five_by_five --scene run.h5 -o run.h5", "run.h5: is the recorded scan whose light is replayed"),
        ("scan five_by_five --constants run.h5 -o ./run.h5", "run.h5: is the file of the constants"),
        ("import data.npz -o data.npz", "a recording is written as .h5"),
        ("import data.npz other.h5 -o .", "other.h5: is a file that is imported"),
        ("replay run.h5 --speed max -o linked.h5", "linked.h5: is the recording that is replayed"),
        ("export run.h5 --to npz -o linked.h5", "linked.h5: is the file that is exported"),
    ],
)
def test_no_verb_writes_over_what_it_reads(folder: Path, words: str, sentence: str) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    done = command(folder, *words.split(), "--overwrite")
    assert (done.returncode, sentence in done.stderr) == (2, True), done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_of_several_imports_none_takes_the_place_of_another(folder: Path) -> None:
    """Two files of one stem are two recordings, two of one name are refused; with --overwrite, too."""
    (folder / "far").mkdir()
    for place, light in (("near.npz", 1), ("near.npy.npz", 2), ("far/near.npz", 3)):
        counts = np.full((3, 3, 16), light, np.uint32)
        np.savez(folder / place, histograms=counts, bin_width_s=32e-12, wall_size_m=1.0)
    (folder / "near.npy.npz").rename(folder / "near.NPZ")
    done = command(folder, "import", "near.npz", "far/near.npz", "-o", "made", "--overwrite")
    assert (done.returncode, "near.npz: two files of one name" in done.stderr) == (2, True), done.stderr
    assert not (folder / "made").exists()
    command(folder, "import", "near.npz", "near.NPZ", "-o", "made", check=True)
    held = {path.name: nlos.load(path).counts.sum() for path in (folder / "made").iterdir()}
    assert held == {"near.npz.h5": 144, "near.NPZ.h5": 288}


@pytest.mark.parametrize("where", [".", "./", "/"])
@pytest.mark.parametrize("verb", ["report", "export --to npz", "replay", "live", "serve", "info", "verify"])
def test_a_folder_is_called_one(tmp_path: Path, verb: str, where: str) -> None:
    done = command(tmp_path, *verb.split(), where)
    assert (done.returncode, "is a folder. Name a" in done.stderr) == (2, True), done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    ["report run.h5 -o .", "export run.h5 --to npz -o .", "export run.h5 --to npz -o made", "recover run.h5 -o ."],
)
def test_a_folder_is_not_replaced_by_a_file(folder: Path, words: str) -> None:
    (folder / "made").mkdir()
    before = sorted(folder.iterdir())
    done = command(folder, *words.split(), "--overwrite")
    assert (done.returncode, "Traceback" in done.stderr) == (2, False), done.stderr
    assert sorted(folder.iterdir()) == before


def test_a_picture_where_a_replays_would_go_is_told_before_anything_is_written(folder: Path) -> None:
    words = ("replay", "run.h5", "--speed", "max", "--reconstruct", "lct")
    for recording, more in (("again", ("-o", "again.h5")), ("run", ())):
        (folder / recording).mkdir()
        (folder / recording / "reconstruction.h5").write_bytes(b"of yesterday")
        done = command(folder, *words, *more)
        assert (done.returncode, f"{recording}: holds a picture" in done.stderr) == (6, True), done.stderr
        assert (folder / recording / "reconstruction.h5").read_bytes() == b"of yesterday"
    assert not (folder / "again.h5").exists()
    done = command(folder, *words, "-o", "third.h5", check=True)  # which the picture of run.h5 does not hinder
    assert "third.h5: 25 samples" in done.stdout
    assert (folder / "third" / "reconstruction.h5").exists()
    kept = (folder / "third.h5").read_bytes()
    assert command(folder, *words[:4], "-o", "third.h5").returncode == 6
    assert (folder / "third.h5").read_bytes() == kept


def test_marks_that_are_no_text_are_refused(folder: Path) -> None:
    done = command(folder, "jog", "--marks", "run.h5")
    assert (done.returncode, "run.h5: is no text, so no table of spots" in done.stderr) == (2, True), done.stderr


def test_a_device_that_does_not_exist_is_refused_everywhere_before_anything_is_read(folder: Path) -> None:
    done = command(folder, "evaluate", "--data", "run.h5", "--device", "foo")
    assert (done.returncode, "--device foo: cpu or cuda" in done.stderr) == (2, True), done.stderr
    with pytest.raises(InvalidSettings, match="device='foo': cpu or cuda"):
        nlos.reconstruct(np.zeros((4, 4, 64)), wall=1.0, bin_width=32e-12, device="foo")


def test_no_run_is_calibrated_from_twice(folder: Path) -> None:
    """Every error came out smaller by the root of two, and nothing was said."""
    for words in ("run.h5 run.h5", "run.h5 linked.h5", "run.h5 other.h5", "data.npz ./data.npz"):
        done = command(folder, "calibrate", *words.split(), "-o", "constants.h5")
        assert (done.returncode, "is the same run as" in done.stderr) == (7, True), done.stderr
    assert not (folder / "constants.h5").exists()
