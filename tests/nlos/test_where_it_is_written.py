"""Where results cannot be written is said before they are made, and a link to nothing is not replaced."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from nlos.writable import check_writable
from tests.command import nlos

PROC = Path("/proc")
needs_proc = pytest.mark.skipif(not PROC.is_dir(), reason="no folder here that takes files from nobody")


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    counts = np.random.default_rng(0).poisson(2.0, (8, 8, 64)).astype(np.uint16)
    path = tmp_path / "scan.npz"
    np.savez(path, histograms=counts, bin_width_s=64e-12, wall_size_m=1.0, rectified=True)
    return path


def never(*_: object) -> None:
    raise AssertionError("read, though nothing can be written")


@needs_proc
def test_a_folder_that_takes_no_files_is_refused_before_anything_is_read(
    scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nlos.chain.load_scan", never)
    done = nlos(scan.parent, "reconstruct", scan.name, "-o", "/proc/nlos/out")
    assert done.returncode == 6, done.stderr
    assert "/proc/nlos/out: nothing can be written to /proc (" in done.stderr
    assert "Choose another place with -o" in done.stderr


@needs_proc
@pytest.mark.parametrize(("words", "computes"), [
    ("evaluate --data scene.h5 --methods lct -o /proc/nlos", "nlos.recon.evaluate.evaluate"),
    ("report run.h5 -o /proc/it.html", "nlos.report.page.load_scan"),
    ("calibrate run.h5 -o /proc/c.h5", "nlos.cli.calibrate.measure_constants"),
])  # fmt: skip
def test_so_is_one_of_verbs_that_compute_for_minutes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, computes: str
) -> None:
    nlos(tmp_path, "scan", "five_by_five", "--bench", "zero_latency", "-o", "run.h5", check=True)
    (tmp_path / "scene.h5").touch()
    monkeypatch.setattr(computes, never)
    done = nlos(tmp_path, *words.split())
    assert done.returncode == 6, done.stderr
    assert "nothing can be written to /proc (" in done.stderr
    assert "Choose another place with -o" in done.stderr


def test_a_file_where_a_folder_is_meant_is_refused_before_anything_is_read(
    scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nlos.chain.load_scan", never)
    done = nlos(scan.parent, "reconstruct", scan.name, "-o", "scan.npz/out", "--overwrite")
    assert (done.returncode, "scan.npz is a file, not a folder" in done.stderr) == (6, True)


@needs_proc
def test_an_export_says_where_nothing_can_be_written(scan: Path) -> None:
    nlos(scan.parent, "import", scan.name, "-o", "scan.h5", check=True)
    done = nlos(scan.parent, "export", "scan.h5", "--to", "mat", "-o", "/proc/scan.mat")
    assert (done.returncode, "/proc: nothing can be written to /proc (" in done.stderr) == (6, True)


def test_asking_leaves_nothing_behind(tmp_path: Path) -> None:
    check_writable(tmp_path / "a" / "b")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words", [
    "scan five_by_five --bench zero_latency -o link.h5", "import scan.npz -o link.h5", "recover scan.h5 -o link.h5",
    "replay scan.h5 --speed max -o link.h5", "export scan.h5 --to npz -o link.npz", "runs --page link.html",
    "plan five_by_five --bench zero_latency --picture link.png",
    "monitor --for 0.1 --bench zero_latency --log link.csv",
])  # fmt: skip
def test_every_verb_overwrites_what_a_link_leads_to_and_leaves_the_link(scan: Path, words: str) -> None:
    """As one that leads to another disk: who made it wants the file there."""
    here = scan.parent
    nlos(here, "import", scan.name, "-o", "scan.h5", check=True)
    link = here / words.split()[-1]
    (here / "disk").mkdir()
    (here / "disk" / "real").write_text("old")
    link.symlink_to(Path("disk") / "real")
    before = {path.name for path in here.iterdir()}
    done = nlos(here, *f"{words} --overwrite".split())
    assert done.returncode == 0, done.stderr
    assert link.is_symlink()
    assert (here / "disk" / "real").read_bytes() != b"old"
    assert {path.name for path in here.iterdir()} == before
    assert [path.name for path in (here / "disk").iterdir()] == ["real"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="lays a link as another user")
@pytest.mark.parametrize(
    ("mode", "folders_user", "follows"), [(0o1777, 0, False), (0o755, 0, True), (0o1777, 54321, True)]
)
def test_a_link_that_somebody_else_laid_in_a_folder_of_everybodys_is_not_followed(
    scan: Path, mode: int, folders_user: int, follows: bool
) -> None:
    """It may lead to any file of whoever writes."""
    here, shared = scan.parent, scan.parent / "shared"
    nlos(here, "import", scan.name, "-o", "scan.h5", check=True)
    shared.mkdir()
    (here / "mine").write_text("old")
    for name in ("x.h5", "x.npz", "y.npz"):
        (shared / name).symlink_to(here / "mine" if name[0] == "x" else "x.npz")
        os.chown(shared / name, 54321 if name[0] == "x" else 0, 0, follow_symlinks=False)
    os.chown(shared, folders_user, 0)
    shared.chmod(mode)
    for words in (
        "scan five_by_five --bench zero_latency --resume -o shared/x.h5",
        "scan five_by_five --bench zero_latency --overwrite -o shared/x.h5",
        "recover scan.h5 --overwrite -o shared/x.h5", "import scan.npz --overwrite -o shared/x.h5",
        "export scan.h5 --to npz --overwrite -o shared/y.npz",
    ):  # fmt: skip
        done = nlos(here, *words.split())
        assert done.returncode == (0 if follows else 6), done.stderr
        assert follows or "that somebody else laid in a folder of everybody's" in done.stderr
    assert ((here / "mine").read_bytes() == b"old") is not follows
    assert sorted(path.name for path in shared.iterdir()) == ["x.h5", "x.npz", "y.npz"]


@pytest.mark.parametrize("words", [
    "scan five_by_five --bench zero_latency -o link.h5", "import scan.npz -o link.h5", "recover scan.h5 -o link.h5",
    "replay scan.h5 --speed max -o link.h5", "export scan.h5 --to npz -o link.npz", "calibrate scan.h5 -o link.h5",
    "plan five_by_five --bench zero_latency -o link.h5", "new bench --simulated -o link.yaml",
])  # fmt: skip
@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no pipes with a file's name")
def test_neither_a_pipe_nor_a_circle_of_links_is_replaced_by_a_file(tmp_path: Path, scan: Path, words: str) -> None:
    """As /dev/null was, for root."""
    nlos(tmp_path, "scan", "five_by_five", "--bench", "zero_latency", "-o", "scan.h5", check=True)
    os.mkfifo(tmp_path / "pipe")
    link = tmp_path / words.split()[-1]
    for leads_to, said in (("pipe", "is a device or a pipe"), (link.name, "is a link that leads back to itself")):
        link.unlink(missing_ok=True)
        link.symlink_to(leads_to)
        done = nlos(tmp_path, *f"{words} --overwrite".split())
        assert done.returncode == 6, done.stderr
        assert f"{link.name}: {said}" in done.stderr
        assert link.is_symlink()
        assert (tmp_path / "pipe").is_fifo()


def test_room_is_looked_for_on_the_disk_that_a_link_leads_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the scan, and by its alarm while the recording grows."""
    asked, usage = set[Path](), shutil.disk_usage
    monkeypatch.setattr("shutil.disk_usage", lambda folder: asked.add(Path(folder)) or usage(folder))
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "real.h5").write_text("old")
    (tmp_path / "link.h5").symlink_to(Path("disk") / "real.h5")
    done = nlos(tmp_path, *["scan", "five_by_five", "--bench", "zero_latency", "-o", "link.h5", "--overwrite"])
    assert done.returncode == 0, done.stderr
    assert asked == {tmp_path / "disk"}


@pytest.mark.parametrize("words", ["import scan.npz", "export scan.h5 --to npz", "recover scan.h5"])
def test_a_link_to_nothing_is_not_replaced(scan: Path, words: str) -> None:
    nlos(scan.parent, "import", scan.name, "-o", "scan.h5", check=True)
    link = scan.parent / "link.h5"
    link.symlink_to("gone.h5")
    done = nlos(scan.parent, *words.split(), "-o", "link.h5")
    assert (done.returncode, "link.h5: exists" in done.stderr) == (6, True)
    assert link.is_symlink()


@pytest.mark.parametrize("words", [
    "plan five_by_five --picture link.png", "report run.h5 -o link.html", "runs --page link.html",
    "figure made -o link.png", "new bench -o link.yaml", "doctor --thorough -o link.html",
    "calibrate --first-light --light -o link.yaml",
])  # fmt: skip
def test_nor_is_one_in_the_place_of_a_page_or_a_picture_and_that_is_said_first(tmp_path: Path, words: str) -> None:
    link = tmp_path / words.split()[-1]
    link.symlink_to("gone")
    done = nlos(tmp_path, *words.split())
    assert (done.returncode, f"{link.name}: exists. Choose another" in done.stderr) == (6, True), done.stderr


def test_a_scan_refuses_a_link_to_nothing_before_any_device_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nlos.cli.benches.open_bench", never)
    (tmp_path / "link.h5").symlink_to("gone.h5")
    demo = Path(__file__).parents[2] / "configs" / "scan" / "demo.yaml"
    done = nlos(tmp_path, "scan", str(demo), "-o", "link.h5")
    assert (done.returncode, "link.h5: exists" in done.stderr) == (6, True)
    assert [path.name for path in tmp_path.iterdir()] == ["link.h5"]
