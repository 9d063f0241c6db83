"""What cannot end well, or means nothing, is refused before any light, file or minute is spent; errors name whose."""

import shutil
from pathlib import Path

import h5py
import pytest

from tests.command import nlos as command
from tests.nlos.conftest import Nlos


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("taken")
    command(folder, "scan", "five_by_five", "-o", "run.h5", check=True)
    return folder / "run.h5"


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        ("scan five_by_five -o new.h5 --reconstruct lct", "use --overwrite"),
        ("replay run.h5 --speed max -o new.h5 --reconstruct lct", "use --overwrite"),
        ("scan five_by_five -o new.h5 --reconstruct lct --resume", "Move it away"),
    ],
)
def test_a_picture_in_the_way_is_said_before_a_scan(
    nlos: Nlos, taken: Path, tmp_path: Path, words: str, remedy: str
) -> None:
    shutil.copy(taken, tmp_path / "run.h5")
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "reconstruction.h5").write_bytes(b"mine")
    done = nlos(*words.split())
    assert done.returncode == 6, done.stderr
    assert "new: holds a picture, where that of new.h5 would go" in done.stderr
    assert remedy in done.stderr
    assert not (tmp_path / "new.h5").exists()
    assert (tmp_path / "new" / "reconstruction.h5").read_bytes() == b"mine"


def test_an_archive_names_those_without_a_result(nlos: Nlos, taken: Path, tmp_path: Path) -> None:
    for name in ("a b.h5", "h.h5"):
        shutil.copy(taken, tmp_path / name)
    (tmp_path / "empty.h5").touch()
    done = nlos("reconstruct", "a b.h5", "h.h5", "nothere.h5", "empty.h5", "-o", "many")
    assert done.returncode == 7, done.stderr
    assert "nlos: 2 of 4 files without a result (nothere.h5, empty.h5); the others are done" in done.stderr


@pytest.mark.parametrize(
    "words",
    ["monitor --for -1", "monitor --for 0", "monitor --for nan", "point 0 0 --hold -1", "point 0 0 --hold nan",
     "live run.h5 --idle-s nan", "live run.h5 --idle-s -1", "serve run.h5 --idle-s -1", "serve run.h5 --idle-s nan"],
)  # fmt: skip
def test_a_time_that_is_none_is_refused(nlos: Nlos, taken: Path, tmp_path: Path, words: str) -> None:
    shutil.copy(taken, tmp_path / "run.h5")
    done = nlos(*words.split())
    option, value = words.split()[-2:]
    assert (done.returncode, f"{option} {value}: seconds are expected" in done.stderr) == (2, True), done.stderr


def test_a_recording_is_not_imported(nlos: Nlos, taken: Path, tmp_path: Path) -> None:
    done = nlos("import", str(taken), "-o", "again.h5")
    assert (done.returncode, "run.h5: is a recording already" in done.stderr) == (2, True), done.stderr
    assert list(tmp_path.iterdir()) == []


def test_no_format_is_answered_by_those_there_are(nlos: Nlos, taken: Path) -> None:
    done = nlos("export", str(taken), "--to", ",")
    assert (done.returncode, "--to: name one format, or several with commas between them: npz, mat" in done.stderr) == (
        2, True,
    )  # fmt: skip


def test_mistakes_of_a_first_day_are_called_what_they_are(nlos: Nlos, taken: Path, tmp_path: Path) -> None:
    (tmp_path / "result").mkdir()
    with h5py.File(tmp_path / "result" / "reconstruction.h5", "w") as file:
        file["albedo"] = file["depth_m"] = [[0.0]]
    for words, code, said in (
        (("plan", "result"), 2, "result: is a folder, not a scan file"),
        (("recon", str(taken)), 2, "did you mean 'reconstruct'?"),
        (("status", str(taken)), 2, "run.h5: is a file; name the folder"),
        (("runs", "--folder", str(taken)), 2, "run.h5: is a file; name the folder"),
        (("reconstruct", "result/reconstruction.h5"), 7, "is a reconstruction, not a scan. Name the recording"),
        (("reconstruct", str(taken), "--depth-m", "0,5:2"), 2, "decimals after a dot"),
        (
            ("import", str(taken), "-o", "i.h5", "--bin-width-ps", "3e-11"),
            2,
            "--bin-width-ps 3e-11: picoseconds are expected, 0.1",
        ),
        (("schema", "demo"), 2, "train': 'demo' is not one of 'scan', "),
        (("plan", 300 * "a"), 2, "File name too long. Choose a shorter one."),
    ):
        done = nlos(*words)
        assert (done.returncode, said in done.stderr) == (code, True), done.stderr


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("words", "code"), [("0.5:", 0), (":0.5", 0), ("0.5", 2), (":", 2), ("1:0.5", 2)])
def test_depths_are_open_at_either_end(nlos: Nlos, taken: Path, tmp_path: Path, words: str, code: int) -> None:
    done = nlos("reconstruct", str(taken), "--depth-m", words, "-o", "out")
    assert done.returncode == code, done.stderr
    if not code:
        with h5py.File(tmp_path / "out" / "reconstruction.h5") as file:
            depths_m = file["depths_m"][:]
        assert depths_m.min() >= 0.5 if words == "0.5:" else depths_m.max() <= 0.5
