"""Ctrl-C while torch is loaded: it waits for the end of the import; a bench's own handler shuts the light at once."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")

LOADED = """
import os, signal, sys, time
from nlos.cli.interrupts import end_at_interrupts
from nlos.drivers.exit_paths import ExitPaths

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "torch.distributed" and not came:
            came.append(name)
            os.kill(os.getpid(), signal.SIGINT)

def shut_light(why):
    print("dark", hasattr(sys.modules["torch"], "compile"), flush=True)

came = []
end_at_interrupts()
sys.meta_path.insert(0, Finder())
def work():
    import torch
    time.sleep(20)
try:
    WORK
except KeyboardInterrupt:
    print(came, hasattr(sys.modules.get("torch"), "compile"))
"""
WITH_A_BENCH = "with ExitPaths(shut_light, lambda: None): work()"


def said(work: str) -> list[str]:
    code = LOADED.replace("WORK", work)
    child = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, timeout=240, check=False)
    assert child.stderr == ""
    return child.stdout.splitlines()


def test_it_comes_when_torch_is_whole() -> None:
    assert said("work()")[-1] == "['torch.distributed'] True"


def test_a_bench_is_dark_at_once_and_the_program_ends_when_torch_is_whole() -> None:
    lines = said(WITH_A_BENCH)
    assert (lines[0], lines[-1]) == ("dark False", "['torch.distributed'] True")


def test_an_import_that_began_before_the_command_keeps_no_ctrl_c_away(tmp_path: Path) -> None:
    """As of a script that somebody imports: its own import is over only once the command is."""
    (tmp_path / "script.py").write_text(
        "import os, signal, time\n"
        "from nlos.cli.interrupts import end_at_interrupts\n"
        "end_at_interrupts()\n"
        "os.kill(os.getpid(), signal.SIGINT)\n"
        "time.sleep(20)\n"
        "print('slept on')\n"
    )
    code = "try:\n    import script\nexcept KeyboardInterrupt:\n    print('ended')"
    child = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (child.stdout, child.stderr) == ("ended\n", "")


FIRST_USE = """
import signal, sys
import nlos

class Finder:
    def find_spec(self, name, path=None, target=None):
        if name.startswith("PACKAGE.") and not came:
            came.append(name)
            signal.raise_signal(signal.SIGINT)

def use():
    nlos.reconstruct([[[1.0, 9.0, 1.0, 1.0] * 16] * 8] * 8, wall=1.0, bin_width=96e-12)
    with nlos.open_bench() as bench:
        next(nlos.scan("five_by_five", bench))

came = []
sys.meta_path.insert(0, Finder())
try:
    use()
except KeyboardInterrupt:
    print("interrupted within", "PACKAGE" if came else "")
use()
print("used", signal.getsignal(signal.SIGINT) is signal.default_int_handler)
"""


@pytest.mark.parametrize("package", ["numpy", "matplotlib", "torch"])
def test_an_interrupt_within_the_first_use_of_a_session_leaves_it_usable(package: str) -> None:
    """As that of a notebook's kernel, whose first use imports NumPy, matplotlib and torch."""
    words = [sys.executable, "-c", FIRST_USE.replace("PACKAGE", package)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=240, check=False)
    assert done.stdout == f"interrupted within {package}\nused True\n", done.stderr


def test_an_interrupt_of_a_script_that_somebody_imports_does_not_wait_for_it(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(
        "import signal, time\n"
        "from nlos.whole_imports import whole_imports\n"
        "with whole_imports():\n"
        "    signal.raise_signal(signal.SIGINT)\n"
        "    time.sleep(20)\n"
        "    print('slept on')\n"
    )
    code = "try:\n    import script\nexcept KeyboardInterrupt:\n    print('ended')"
    child = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (child.stdout, child.stderr) == ("ended\n", "")
