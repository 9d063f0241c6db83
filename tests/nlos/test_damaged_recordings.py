"""Every verb that reads a recording leaves damaged samples aside, says how many, and marks what it made."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.recording.open_file import open_scan_file
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify
from tests.scan_texts import EIGHT_BY_EIGHT, recorded

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]
DAMAGED = 3
VERBS = {
    "info": ("info", "run.h5"),
    "reconstruct": ("reconstruct", "run.h5", "-o", "out"),
    "reconstruct --follow": ("reconstruct", "run.h5", "--follow", "-o", "out"),
    "replay": ("replay", "run.h5", "--speed", "max", "-o", "again.h5"),
    "export": ("export", "run.h5", "--to", "npz", "-o", "run.npz"),
    "report": ("report", "run.h5", "-o", "run.html"),
    "calibrate": ("calibrate", "run.h5", "-o", "constants.h5"),
    "plan --like": ("plan", "scan.yaml", "--like", "run.h5"),
}


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scan of 8 x 8 points, three rows of it damaged."""
    folder = tmp_path_factory.mktemp("scanned")
    file = open_scan_file(recorded(folder, EIGHT_BY_EIGHT), writable=True)
    with file.handle:
        for row in range(10, 10 + DAMAGED):
            file.counts.write(row, file.counts.read(row, row + 1)[0] + np.uint32(1))
    return folder


ENV = {**os.environ, "PATH": f"{Path(os.sys.executable).parent}:{os.environ['PATH']}"}  # type: ignore[attr-defined]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("verb", VERBS)
def test_what_is_damaged_is_left_aside_by_name(nlos: Nlos, scanned: Path, tmp_path: Path, verb: str) -> None:
    for name in ("run.h5", "scan.yaml"):
        shutil.copy(scanned / name, tmp_path)
    before = (tmp_path / "run.h5").read_bytes()
    done = nlos(*VERBS[verb])
    assert done.returncode == 0, done.stderr
    assert "3 of 64 samples are skipped (damaged: rows 10-12)" in " ".join(done.stderr.split())
    assert (tmp_path / "run.h5").read_bytes() == before
    if verb.startswith("reconstruct"):
        with h5py.File(tmp_path / "out" / "reconstruction.h5") as file:
            assert file.attrs["samples_left_aside"] == DAMAGED
    if verb == "replay":
        found = verify(tmp_path / "again.h5")
        assert (found.intact, len(found.missing), found.status.name) == (True, DAMAGED, "INTERRUPTED")
        with Recording.open(tmp_path / "again.h5") as again, Recording.open(tmp_path / "run.h5") as run:
            assert any(event.kind == "left_aside" for event in again.events())
            assert again.header.identity != run.header.identity
    if verb == "export":
        with np.load(tmp_path / "run.npz") as arrays:
            assert arrays["samples_left_aside"] == DAMAGED
            assert (arrays["exposure_s"] == 0).sum() == DAMAGED
    if verb == "report":
        assert "3 of 64 samples are skipped" in (tmp_path / "run.html").read_text()


def test_a_damaged_scene_is_refused_before_anything_runs_and_its_sound_points_serve(
    nlos: Nlos, scanned: Path, tmp_path: Path
) -> None:
    for name in ("run.h5", "scan.yaml"):
        shutil.copy(scanned / name, tmp_path)
    scan = ("scan", "scan.yaml", "--scene", "run.h5", "-o", "other.h5")
    done = nlos(*scan)
    said = " ".join(done.stderr.split())
    assert done.returncode == 7, said
    assert "3 of 64 samples are skipped (damaged: rows 10-12)" in said
    assert "3 of the plan's 64 points are damaged or were never measured there: points 10-12" in said
    assert not list(tmp_path.glob("other.h5*"))
    plan = (tmp_path / "scan.yaml").read_text()
    (tmp_path / "sound.csv").write_text("row,col\n" + "".join(f"{row},{col}\n" for row in (0, 4) for col in range(8)))
    (tmp_path / "scan.yaml").write_text(plan.replace("serpentine", "{kind: list, file: sound.csv}"))
    done = nlos(*scan)
    assert done.returncode == 0, done.stderr
    assert verify(tmp_path / "other.h5").complete


@pytest.mark.parametrize(("share", "code"), [(1.0, 7), (0.5, 7), (0.0, 7)])
def test_verify_ends_with_0_only_where_every_planned_sample_is_what_was_measured(
    nlos: Nlos, scanned: Path, tmp_path: Path, share: float, code: int
) -> None:
    """The damaged file, one cut in half, and one of which only the beginning is left."""
    shutil.copy(scanned / "run.h5", tmp_path)
    file = open_scan_file(tmp_path / "run.h5")
    begin, size = file.records.place, (tmp_path / "run.h5").stat().st_size
    file.handle.close()
    os.truncate(tmp_path / "run.h5", begin + int(share * (size - begin)))
    done = nlos("verify", "run.h5", "--json")
    assert done.returncode == code
    found = json.loads(done.stdout)
    assert found["missing"] == found["corrupt"]
    assert len(found["missing"]) == {1.0: 3, 0.5: len(found["missing"]), 0.0: 64}[share]
    assert found["intact_samples"] == 64 - len(found["missing"]) < 64
    assert "missing points: " in nlos("verify", "run.h5").stdout


def test_verify_names_the_missing_points_of_a_scan_that_was_ended(nlos: Nlos, scanned: Path, tmp_path: Path) -> None:
    shutil.copy(scanned / "run.h5", tmp_path)
    assert nlos("recover", "run.h5", "-o", "saved.h5").returncode == 0
    done = nlos("verify", "saved.h5")
    assert (done.returncode, "missing points: 10-12" in done.stdout) == (7, True), done.stdout
