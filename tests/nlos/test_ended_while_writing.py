"""A command that is ended while it writes its results leaves all of them or none, and nothing hidden."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

NLOS = [sys.executable, "-m", "nlos"]


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scan") / "demo.h5"
    subprocess.run([*NLOS, "scan", "demo", "-o", str(path)], check=True, capture_output=True, timeout=240)
    return path


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_reconstruction_that_is_ended_while_it_writes_leaves_nothing_half_written(
    scan: Path, tmp_path: Path, number: signal.Signals
) -> None:
    folder, deadline_s = tmp_path / "made", time.monotonic() + 240
    command = [*NLOS, "reconstruct", str(scan), "--method", "lct", "-o", str(folder)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as child:
        while not any(tmp_path.rglob(".*.part")) and child.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.001)
        assert child.poll() is None, "it wrote nothing that could be seen"
        child.send_signal(number)
        said = child.communicate(timeout=240)[1]
    assert child.returncode == 128 + number, said
    assert "Traceback" not in said
    assert not folder.exists()


LOST = """
import signal, sys, time, weakref
from pathlib import Path
from nlos.cli.interrupts import never_lose_an_interrupt
from nlos.recon.whole_files import whole_files

class Kept: pass

never_lose_an_interrupt()
with whole_files(Path("made")) as there:
    (there / "a.txt").write_text("half")
    kept = Kept()
    watched = weakref.ref(kept, lambda reference: signal.raise_signal(signal.SIGTERM))
    del kept  # what the signal raises is lost in here
    time.sleep(60)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends a process without asking it")
def test_an_end_that_python_loses_comes_again(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", LOST], cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert (done.returncode, done.stderr) == (143, "")
    assert not (tmp_path / "made").exists()
