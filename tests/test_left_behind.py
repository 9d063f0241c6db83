"""What the gate behind every test sees, and what it waits for."""

import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests import left_behind as gate
from tests.left_behind import Held, end_processes, left_behind

pytestmark = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="/proc tells what a process holds")


def test_files_sockets_threads_and_processes_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "GRACE_S", 0.0)
    before = Held.now()
    until = threading.Event()
    thread = threading.Thread(target=until.wait, name="waits")
    thread.start()
    # Its own child outlives it: what a command leaves behind is no child of this process.
    command = "import subprocess, sys; subprocess.Popen([sys.executable, '-c', 'import sys; sys.stdin.read()'])"
    started = subprocess.Popen([sys.executable, "-c", command], stdin=subprocess.PIPE)
    assert started.stdin is not None
    with (tmp_path / "open.txt").open("w"), socket.socket():
        started.wait(240)
        found = "\n".join(left_behind(before))
    for word in ("open.txt", "socket:", "thread waits", "sys.stdin.read"):
        assert word in found
    started.stdin.close()
    until.set()
    thread.join()


def test_one_that_nobody_waited_for_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate, "GRACE_S", 0.0)
    before = Held.now()
    started = subprocess.Popen([sys.executable, "-c", ""], stdout=subprocess.PIPE)
    assert started.stdout is not None
    started.stdout.read()
    for _ in range(500):
        if "nobody waited" in str(left_behind(before)):
            break
        time.sleep(0.01)
    else:
        pytest.fail("not seen")
    started.stdout.close()
    started.wait()
    assert left_behind(before) == []


def test_a_program_that_a_test_left_is_ended() -> None:
    before = Held.now()
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as left:
        while not Held.now().processes - before.processes:
            time.sleep(0.01)
        end_processes(before)
        assert left.wait(240) == -9
