"""Ctrl-C at any moment of any verb that writes: what it was to write is there whole, as it was before, or not at all;
nothing else is left, and nothing is printed that only a programmer understands."""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from nlos.__main__ import report
from nlos.acquisition.importers.magic import is_recording
from nlos.acquisition.recording import salvage
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.cli import interrupts
from nlos.drivers.exit_paths import tell_to_end
from tests.recon.test_evaluate import make_scene

SOAK = os.environ.get("NLOS_SOAK") == "1"
SCAN = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 4
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""
RESULTS = ("reconstruction.h5", "albedo.png", "depth.png", "slices.png", "view3d.html")
CORRECTED = tuple(f"c/{name}.png" for name in ("time_offset", "background", "direct_light", "wall"))
VERBS: dict[str, tuple[str, tuple[tuple[str, ...], ...]]] = {
    "reconstruct": ("reconstruct run.h5 -o out --html", (tuple(f"out/{name}" for name in RESULTS),)),
    "film": ("reconstruct film.h5 --film -o out", (tuple(f"out/film.{end}" for end in ("npz", "gif")),)),
    "evaluate": (
        "evaluate --data scene.h5 --methods lct --conditions transient --fixed -o out",
        (("out/results.json", "out/results.csv", "out/results.md", "out/gallery.png"),),
    ),
    "import": ("import run.npz -o new.h5", (("new.h5",),)),
    "calibrate": ("calibrate run.h5 -o c.h5", (("c.h5",), CORRECTED)),
    "export": ("export run.h5 --to mat -o new.mat", (("new.mat",),)),
    "vti": ("export seen/reconstruction.h5 --to vti -o new.vti", (("new.vti",),)),
    "report": ("report run.h5 -o new.html --methods lct", (("new.html",),)),
    "figure": ("figure seen -o new.pdf", (("new.pdf",),)),
    "replay": ("replay run.h5 --speed max -o new.h5", (("new.h5",),)),
    "plan": ("plan scan.yaml --picture new.png", (("new.png",),)),
    "recover": ("recover run.h5 -o new.h5", (("new.h5",),)),
    "glb": ("export seen/reconstruction.h5 --to glb -o new.glb", (("new.glb",),)),
    "runs": ("runs --page new.html", (("new.html",),)),
    "first light": ("calibrate --first-light -o new.yaml", (("new.yaml",),)),
    "doctor": ("doctor --thorough --light -o new.html", (("new.html",),)),
    "live": ("live run.h5", ()),
}
"""Name -> the command, and its files in groups: of a group all are new, or all are old."""
CASES = [pytest.param(verb, k, marks=pytest.mark.soak) for verb in VERBS for k in range(1, 61 if SOAK else 2)]
NEEDS = {
    "film": ("film.h5", "scan film.yaml -o film.h5"),
    "vti": ("seen", "reconstruct run.h5 -o seen"),
    "glb": ("seen", "reconstruct run.h5 -o seen"),
    "figure": ("seen", "reconstruct run.h5 -o seen"),
}
"""What some verbs work on, and how it is made."""
OLD = b"what was there before"


@pytest.fixture(scope="module")
def inputs() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        there = Path(name)
        (there / "scan.yaml").write_text(SCAN)
        (there / "film.yaml").write_text(SCAN + "frames: 2\n")
        make_scene(there / "scene.h5")
        nlos(there, "scan scan.yaml -o run.h5")
        nlos(there, "export run.h5 --to npz -o run.npz")
        yield there


def nlos(folder: Path, words: str) -> None:
    command = [sys.executable, "-m", "nlos", "-q", *words.split()]
    subprocess.run(command, cwd=folder, check=True, timeout=240, stdout=subprocess.DEVNULL)


def is_whole(path: Path) -> bool:
    """Whether somebody can use the file."""
    match path.suffix:
        case ".png" | ".gif":
            with Image.open(path) as image:
                image.load()
        case ".json":
            json.loads(path.read_text())
        case ".html":
            return path.read_text().rstrip().endswith("</html>")
        case ".pdf":
            return path.read_bytes().rstrip().endswith(b"%%EOF")
        case ".npz":
            with np.load(path) as arrays:
                return all(arrays[name].size for name in arrays)
        case ".h5":
            if is_recording(path):
                with Recording.open(path):
                    return verify(path).intact
            with h5py.File(path) as file:
                return len(file) > 0
    return path.stat().st_size > 0


def ready(inputs: Path, folder: Path, groups: tuple[tuple[str, ...], ...], there_before: bool) -> set[str]:
    """Puts inputs into place, and older outputs where asked for. Returns the names of all that is there."""
    for path in inputs.iterdir():
        (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)
    for name in (name for group in groups for name in group if there_before):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(OLD)
    return names_in(folder)


def names_in(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def wait(
    folder: Path, child: "subprocess.Popen[str]", before: set[str], draw: random.Random, longest_s: float, writes: bool
) -> None:
    """Until a moment of the drawing's choice: any, or shortly after the command began to write, where it writes."""
    began_s = time.monotonic()
    if not writes or draw.random() < 0.4:
        time.sleep(draw.uniform(0.3, longest_s))
        return
    while child.poll() is None and names_in(folder) == before and time.monotonic() - began_s < 60:
        time.sleep(0.001)
    time.sleep(draw.choice((0.0, 0.003, 0.03, 0.1, 0.3)))


def ended(child: "subprocess.Popen[str]") -> str:
    """What a child said until it ended; of one that does not, where its threads stand. One that computes may take
    longer, on a machine that has other things to do."""
    for _ in range(5):
        before_s = computed_s(child.pid)
        try:
            return child.communicate(timeout=240)[1]
        except subprocess.TimeoutExpired:
            if computed_s(child.pid) - before_s < 0.1:
                break
    child.send_signal(signal.SIGABRT)
    pytest.fail(f"did not end: {child.communicate(timeout=10)[1]}")


def computed_s(pid: int) -> float:
    """Processor time of a process so far; 0 where nobody says."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("verb", "seed"), CASES)
def test_ctrl_c_leaves_nothing_half_written(tmp_path: Path, inputs: Path, verb: str, seed: int) -> None:
    words, groups = VERBS[verb]
    draw = random.Random(f"{verb} {seed}")
    if verb in NEEDS and not (inputs / NEEDS[verb][0]).exists():
        nlos(inputs, NEEDS[verb][1])
    there_before = verb not in ("plan", "live") and draw.random() < 0.5
    before = ready(inputs, tmp_path, groups, there_before)
    command = [sys.executable, "-m", "nlos", *words.split(), *(["--overwrite"] if there_before else [])]
    child = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                             stdin=subprocess.DEVNULL, env={**os.environ, "PYTHONFAULTHANDLER": "1"})  # fmt: skip
    try:
        wait(tmp_path, child, before, draw, 4.0, bool(groups))
        if child.poll() is None:
            child.send_signal(signal.SIGINT)
        said = ended(child)
    finally:
        child.kill()
        child.wait()
    if "Traceback" in said and "__main__.py" not in said and not (names_in(tmp_path) - before):
        return  # Python itself was still starting: not a line of ours had run
    assert "Traceback" not in said
    assert "Exception ignored" not in said
    assert "was never" not in said
    assert child.returncode in (0, 130, -signal.SIGINT), said
    for group in groups:
        present = [tmp_path / name for name in group if (tmp_path / name).exists()]
        old = [path for path in present if path.read_bytes() == OLD]
        assert len(old) in (0, len(group)), f"some of them old: {old}"
        assert len(present) in (0, len(group)), f"some of them missing: {present}"
        assert all(is_whole(path) for path in present if path not in old)
    mine = {name for group in groups for name in group}
    folders = {str(Path(name).parent) for name in mine} - {"."}
    more = names_in(tmp_path) - before - mine - folders
    assert not {name for name in more if Path(name).name.startswith(".") or ".part" in name or "tmp" in name}, more
    assert child.returncode == 0 or not more - {f"out/{name}" for name in ("track.csv", "track.json", "objects.csv")}, (
        more
    )


IMPORTED = """
import os, runpy, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "nlos.cli.terminal":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
sys.argv = ["nlos", "methods"]
runpy.run_module("nlos", run_name="__main__", alter_sys=True)
"""


def test_ctrl_c_while_the_program_is_loaded_ends_it_in_silence() -> None:
    command = [sys.executable, "-P", "-c", IMPORTED]
    child = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert (child.returncode, child.stdout, child.stderr) == (130, "", "")


BROKEN_INTO = """
import os, runpy, signal, sys, time
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "nlos.cli.methods":
            broken = False
            try:
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.01)
            except KeyboardInterrupt:
                broken = True
            if broken:  # as NumPy's import_array: what broke it is printed, and no part of the error
                print("KeyboardInterrupt", file=sys.stderr)
                raise ImportError("numpy._core.multiarray failed to import")
            print("loaded", file=sys.stderr)
sys.meta_path.insert(0, Finder())
sys.argv = ["nlos", "methods"]
runpy.run_module("nlos", run_name="__main__", alter_sys=True)
"""


def test_no_import_is_broken_into_once_the_program_runs() -> None:
    """A module in C that a command loads late, as matplotlib's, made an error of the program of it."""
    command = [sys.executable, "-P", "-c", BROKEN_INTO]
    child = subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)
    assert child.returncode in (0, 130)  # 0: it was done before it could be told
    assert child.stderr in ("loaded\n", "loaded\nnlos: interrupted\n")


@pytest.mark.parametrize("verb", ["recover", "resume"])
def test_ctrl_c_when_a_copy_is_about_to_take_its_place_leaves_nothing_of_it(
    tmp_path: Path, inputs: Path, verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(fresh: Path, path: Path) -> None:
        assert fresh.exists()
        raise KeyboardInterrupt

    run = tmp_path / "run.h5"
    with Recording.open(inputs / "run.h5") as whole:
        with RecordingWriter.create(run, whole.plan, whole.header) as writer:
            for sample in list(whole.samples())[:5]:
                writer.write(sample)
        plan, header = whole.plan, whole.header
    with h5py.File(run, "r+") as file:  # a row that resuming leaves out
        file["samples/counts"][2] += 1
    before = run.read_bytes()
    monkeypatch.setattr(salvage, "put_in_place", interrupted)
    act = {
        "recover": lambda: salvage.recover(run, tmp_path / "new.h5"),
        "resume": lambda: salvage.resume(run, plan, header),
    }[verb]
    with pytest.raises(KeyboardInterrupt):
        act()
    assert run.read_bytes() == before
    assert names_in(tmp_path) - {"run.h5.damaged"} == {"run.h5"}


def test_an_error_that_a_library_makes_of_ctrl_c_is_an_interrupt(capsys: pytest.CaptureFixture[str]) -> None:
    """As when a C extension is broken into."""
    tell_to_end(False)
    wrapped = SystemError("initialization raised unreported exception")
    wrapped.__cause__ = KeyboardInterrupt()
    assert report(wrapped) == 130
    assert capsys.readouterr().err == "nlos: interrupted\n"
    assert report(SystemError("of its own")) == 1
    assert "this is a bug" in capsys.readouterr().err
    assert report(MemoryError("Unable to allocate 80 GiB")) == 8
    assert "the memory is not enough (Unable to allocate 80 GiB)" in capsys.readouterr().err
    behind_a_cause = SystemError("of its own")
    behind_a_cause.__cause__, behind_a_cause.__context__ = ValueError("older"), KeyboardInterrupt()
    assert report(behind_a_cause) == 130
    with pytest.raises(KeyboardInterrupt):
        interrupts.interrupt(None)
    assert report(SystemError("that says nothing of what was behind it")) == 130
    tell_to_end(False)
    assert report(SystemError("of its own")) == 1
