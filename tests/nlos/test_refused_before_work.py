"""What could refuse a result at the end is asked before any light and before any work: a folder or a link to nothing
where the file would go, a folder that is missing or takes no files; and the remedy that is named is one."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.command import nlos

PROC = Path("/proc")
needs_proc = pytest.mark.skipif(not PROC.is_dir(), reason="no folder here that takes files from nobody")

# Verb and where its file goes; what it does first of what may take long, or may light up.
WORK = [
    ("calibrate --first-light --bench simulated -o", ".yaml", "nlos.cli.first_light.opened"),
    ("doctor --thorough --light --move -o", ".html", "nlos.cli.doctor.examine"),
    ("monitor --light 1 --for 1 --log", ".csv", "nlos.cli.monitor.in_hand"),
    ("plan five_by_five --picture", ".png", "nlos.cli.plan.opened"),
    ("report run.h5 -o", ".html", "nlos.cli.report.write_report"),
    ("calibrate run.h5 -o", ".h5", "nlos.cli.calibrate.measure_constants"),
    ("figure out -o", ".png", "nlos.cli.figure.read_reconstruction"),
    ("export run.h5 --to npz -o", ".npz", "nlos.cli.export.open_checked"),
    ("runs --page", ".html", "nlos.cli.runs.RunsIndex"),
    ("import data.npz -o", ".h5", "nlos.cli.import_.one_reader"),
    ("recover run.h5 -o", ".h5", "nlos.cli.recover.check_recording"),
    ("replay run.h5 -o", ".h5", "nlos.cli.replay.open_checked"),
    ("new bench --simulated --no-check -o", ".yaml", "nlos.cli.new.detect"),
]
AT_ONCE = [row for row in WORK if not row[0].startswith("calibrate run.h5")]
"""`calibrate` reads its runs first, for the bench that constants are kept with: see test_where_it_is_written.py."""


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("taken")
    nlos(folder, "scan", "five_by_five", "--bench", "zero_latency", "-o", "run.h5", check=True)
    nlos(folder, "export", "run.h5", "--to", "npz", "-o", "data.npz", check=True)
    return folder


@pytest.fixture
def folder(taken: Path, tmp_path: Path) -> Iterator[Path]:
    for name in ("run.h5", "data.npz"):
        shutil.copy(taken / name, tmp_path / name)
    yield tmp_path
    assert not list(tmp_path.rglob("*.part"))


def never(*_: object, **__: object) -> None:
    raise AssertionError("begun, though the result has no place")


def ids(rows: list[tuple[str, str, str]]) -> list[str]:
    return [" ".join(words.split()[:2]) for words, _, _ in rows]


@needs_proc
@pytest.mark.parametrize(("words", "kind", "work"), AT_ONCE, ids=ids(AT_ONCE))
def test_a_folder_that_takes_no_files(
    folder: Path, monkeypatch: pytest.MonkeyPatch, words: str, kind: str, work: str
) -> None:
    monkeypatch.setattr(work, never)
    option = words.split()[-1]
    done = nlos(folder, *words.split(), f"/proc/it{kind}", "--overwrite")
    assert done.returncode == 6, done.stderr
    assert "nothing can be written to /proc (" in done.stderr
    assert f"Choose another place with {option}." in done.stderr


@pytest.mark.parametrize(("words", "kind", "work"), WORK, ids=ids(WORK))
def test_a_folder_at_the_name(folder: Path, monkeypatch: pytest.MonkeyPatch, words: str, kind: str, work: str) -> None:
    (folder / f"it{kind}").mkdir()
    (folder / f"other{kind}").symlink_to(f"it{kind}")
    monkeypatch.setattr(work, never)
    for name in (f"it{kind}", f"other{kind}"):
        for asked in ([], ["--overwrite"]):
            done = nlos(folder, *words.split(), name, *asked)
            assert (done.returncode, f"{name}: is a folder. Name the file in it." in done.stderr) == (2, True), done
    assert (folder / f"other{kind}").is_symlink()


@pytest.mark.parametrize(("words", "kind", "work"), WORK, ids=ids(WORK))
def test_a_file_at_the_name(folder: Path, monkeypatch: pytest.MonkeyPatch, words: str, kind: str, work: str) -> None:
    (folder / f"it{kind}").write_text("another's")
    (folder / f"link{kind}").symlink_to(f"nowhere{kind}")
    monkeypatch.setattr(work, never)
    option = words.split()[-1]
    for name in (f"it{kind}", f"link{kind}"):
        done = nlos(folder, *words.split(), name)
        assert done.returncode == 6, done.stderr
        assert f"{name}: exists. Choose another name with {option}, or use --overwrite." in done.stderr
    assert (folder / f"it{kind}").read_text() == "another's"


@pytest.mark.parametrize("words", [row[0] for row in AT_ONCE if "first" not in row[0] and "new" not in row[0]])
def test_more_than_a_folder_missing(folder: Path, words: str) -> None:
    """`calibrate` makes all of it: constants are kept far down."""
    kind = {row[0]: row[1] for row in WORK}[words]
    done = nlos(folder, *words.split(), f"no/way/it{kind}")
    assert (done.returncode, "is not a folder. Make it first" in done.stderr) == (2, True), done.stderr


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        ("report run.h5 --methods lct -o", ".html"),
        ("plan five_by_five --bench zero_latency --picture", ".png"),
        ("runs --page", ".html"),
        ("calibrate --first-light -o", ".yaml"),
        ("recover run.h5 -o", ".h5"),
    ],
)
def test_one_missing_folder_is_made(folder: Path, words: str, kind: str) -> None:
    done = nlos(folder, *words.split(), f"new/it{kind}")
    assert done.returncode == 0, done.stderr
    assert (folder / "new" / f"it{kind}").stat().st_size > 0


def test_a_link_to_a_disk_that_is_not_mounted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every picture was computed, and then the folder could not be made."""
    (folder / "out").symlink_to("disk/out")
    monkeypatch.setattr("nlos.chain.load_scan", never)
    for words in ("reconstruct data.npz", "reconstruct data.npz -o out/a/b", "evaluate --data data.npz"):
        done = nlos(folder, *words.split(), "--overwrite")
        assert done.returncode == 6, done.stderr
        assert "out is a link to disk/out, which is not there. Mount or make that, or choose another" in done.stderr
    done = nlos(folder, "scan", "five_by_five", "--bench", "zero_latency", "-o", "out/run.h5")
    assert (done.returncode, "out is not a folder. Make it first" in done.stderr) == (2, True), done.stderr


@pytest.mark.parametrize("name", ["albedo.png", "slices.png", "confidence.png", "uncertainty.png"])
def test_what_lies_among_results(folder: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr("nlos.chain.load_scan", never)
    (folder / "out").mkdir()
    (folder / "out" / name).symlink_to("nowhere.png")
    done = nlos(folder, "reconstruct", "data.npz")
    assert (done.returncode, f"out/{name}: exists. Choose another folder" in done.stderr) == (6, True), done.stderr


def test_of_several_imports_none_is_written_where_one_has_no_place(folder: Path) -> None:
    np.savez(folder / "second.npz", **np.load(folder / "data.npz"))
    (folder / "made").mkdir()
    (folder / "made" / "second.h5").write_text("another's")
    done = nlos(folder, "import", "data.npz", "second.npz", "-o", "made")
    assert (done.returncode, "made/second.h5: exists." in done.stderr) == (6, True), done.stderr
    assert [path.name for path in (folder / "made").iterdir()] == ["second.h5"]


def test_a_recording_is_not_recovered_over_itself(folder: Path) -> None:
    before = (folder / "run.h5").read_bytes()
    done = nlos(folder, "recover", "run.h5", "-o", "run.h5", "--overwrite")
    assert (done.returncode, "run.h5: is the recording that is read" in done.stderr) == (2, True), done.stderr
    assert (folder / "run.h5").read_bytes() == before


def test_plan_says_that_scan_would_refuse_the_name(folder: Path) -> None:
    """A warning, not an error: the scan may be resumed."""
    words = ["plan", "five_by_five", "--bench", "zero_latency", "-o", "run.h5"]
    assert "run.h5: exists. `nlos scan` will ask" in nlos(folder, *words, check=True).stderr
    assert "exists" not in nlos(folder, *words, "--overwrite", check=True).stderr
