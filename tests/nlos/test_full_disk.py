"""A disk that is full ends what was to be written there, in words and by exit code 6, and never the process."""

import errno
import shutil
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.live.scan import LiveScan
from nlos.recon.live import LivePicture, LiveReconstruction
from tests.command import nlos

resource = pytest.importorskip("resource", reason="Windows limits no process's files")
ROOM = 50_000
"""No file becomes longer; results do."""

PYTHON = """
from pathlib import Path
import nlos, numpy as np
from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5

def taken(what):
    try:
        what()
    except OSError as error:
        print("refused:", error)

def some_file():
    with written_hdf5(Path("some.h5")) as file:
        file["light"] = np.random.default_rng(0).random(40_000)

picture = nlos.reconstruct("run.h5")
taken(lambda: picture.save("made"))
taken(some_file)
taken(lambda: picture.save("made"))
print("goes on:", picture.albedo.shape)
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run")
    nlos(folder, "scan", "five_by_five", "--bench", "zero_latency", "-o", "run.h5", check=True)
    return folder / "run.h5"


def limited(folder: Path, *command: str) -> "subprocess.CompletedProcess[str]":
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, resource.RLIM_INFINITY))

    return subprocess.run(
        [sys.executable, *command], cwd=folder, capture_output=True, text=True, timeout=240, preexec_fn=limit
    )


def test_python_goes_on_where_the_disk_took_no_picture(tmp_path: Path, run: Path) -> None:
    shutil.copy(run, tmp_path)
    done = limited(tmp_path, "-c", PYTHON)
    assert done.returncode == 0, done.stderr
    refused = [line for line in done.stdout.splitlines() if line.startswith("refused:")]
    assert len(refused) == 3, done.stdout
    assert all("File too large" in line and ".h5" in line for line in refused), refused
    assert "goes on: (64, 64)" in done.stdout
    assert not (tmp_path / "made").exists()


def test_reconstruct_says_that_the_disk_is_full(tmp_path: Path, run: Path) -> None:
    done = limited(tmp_path, "-m", "nlos", "reconstruct", str(run), "-o", "made")
    assert done.returncode == 6, done.stderr
    assert "reconstruction.h5" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "made").exists()


def test_a_follower_says_that_the_disk_is_full(tmp_path: Path, run: Path) -> None:
    done = limited(tmp_path, "-m", "nlos", "reconstruct", str(run), "--follow", "-o", "made")
    assert done.returncode == 6, done.stderr
    assert done.stderr.splitlines()[-1].startswith("nlos: made/reconstruction.h5: cannot be written (File too large)")
    assert "bug" not in done.stderr


def test_a_disk_that_takes_one_picture_again_ends_no_page_and_no_follower(run: Path) -> None:
    """Pictures go on; what is said at the end is of the newest."""
    full = OSError(errno.ENOSPC, "No space left on device")

    def refuse(picture: LivePicture) -> None:
        raise full

    watched = LiveScan(run, [LiveReconstruction("lct")], on_picture=refuse, on_explained=lambda picture: None)
    watched.start()
    watched.wait()
    assert (watched.over, watched.broke_off, watched.pictures) == (True, False, 1)
    watched = LiveScan(run, [LiveReconstruction("lct")], on_picture=lambda picture: None, on_explained=refuse)
    watched.start()
    with pytest.raises(OSError, match="No space left"):
        watched.wait()
    assert (watched.over, watched.broke_off, watched.pictures) == (True, False, 1)
    assert "No space left" in watched.message


def test_an_archive_says_for_which_files_the_disk_was_full(tmp_path: Path, run: Path) -> None:
    (tmp_path / "scans").mkdir()
    for name in "ab":
        shutil.copy(run, tmp_path / "scans" / f"{name}.h5")
    done = limited(tmp_path, "-m", "nlos", "reconstruct", "scans", "-o", "made")
    assert done.returncode == 6, done.stderr
    assert "File too large" in done.stderr
    assert "2 of 2 files without a result" in done.stderr


def test_a_full_temporary_folder_is_not_called_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with h5py.File(tmp_path / "scan.h5", "w") as file:
        file["histograms"] = np.ones((8, 8, 64))
        file.attrs.update({"bin_width_s": 64e-12, "wall_size_m": 1.0})
    full = tmp_path / "full"
    full.mkdir()
    (full / "sitecustomize.py").write_text(
        "import numpy\ndef save(*_):\n    raise OSError(28, 'No space left on device')\nnumpy.save = save\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(full), prepend=":")
    done = nlos(tmp_path, "info", "scan.h5")
    assert done.returncode == 6, done.stderr
    assert "No space left on device" in done.stderr
    assert "scan.h5" in done.stderr
    assert "TMPDIR" in done.stderr
    assert "damaged" not in done.stderr
