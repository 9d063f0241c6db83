"""A command ends when it is done: what a method began or printed beside it changes neither end nor document."""

import json
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "recon" / "method_of_ones_own.py"
WILD = """import subprocess, sys, threading, time
threading.Thread(target=time.sleep, args=(600,), name="theirs").start()
subprocess.run([sys.executable, "-c", "print('from a program')"])


class Settings("""


def test_threads_that_a_method_leaves_and_programs_that_it_calls(tmp_path: Path) -> None:
    """It hung for ever, deaf to Ctrl-C, and what a program of the method's printed stood before the document."""
    text = EXAMPLE.read_text(encoding="utf-8").replace("class Settings(", WILD)
    (tmp_path / "mine.py").write_text(text, encoding="utf-8")
    begin = "import nlos.__main__, nlos.cli.threads_left as left; "
    begin += "left.end_within.__defaults__ = (0.2,); nlos.__main__.main()"
    words = [sys.executable, "-c", begin, "methods", "./mine.py", "--json"]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "least_counts" in json.dumps(json.loads(done.stdout))
    assert "from a program" in done.stderr
    assert "nlos: done; threads that go on are not waited for: theirs" in done.stderr


def test_a_bench_that_was_left_open_is_closed_all_the_same() -> None:
    """Python closes one once every thread has ended, and these do not: its light would have stayed on."""
    begin = "import sys, threading, time; from nlos.cli.threads_left import end_within; "
    begin += "from nlos.drivers.exit_paths import ExitPaths; "
    begin += "bench = ExitPaths(print, lambda: print('closed', flush=True)); bench.__enter__(); "
    begin += "threading.Thread(target=time.sleep, args=(600,)).start(); end_within(3, 0.2)"
    done = subprocess.run([sys.executable, "-c", begin], capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout) == (3, "closed\n"), done.stderr
