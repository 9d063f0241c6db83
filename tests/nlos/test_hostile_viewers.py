"""Whatever is sent to the page's port is refused or dropped, costs little, and the page keeps answering its user."""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nlos.live import web
from nlos.live.web import MOST_CONNECTIONS, Answer, Refused, parse
from tests.nlos.test_waiting_answers import served
from tests.scan_texts import COARSE_TO_FINE

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]
Viewing = Callable[..., AbstractContextManager[Any]]
SOAK = bool(os.environ.get("NLOS_SOAK"))
ROUNDS = 500 if SOAK else 20
IDLE = 1500 if SOAK else 300
PICTURES = 2000 if SOAK else 200


@pytest.fixture
def viewer(nlos: Nlos, small: Path, viewing: Viewing) -> Iterator[Any]:
    assert nlos("scan", small.name, "-o", "run.h5").returncode == 0
    with viewing("run.h5", "--method", "lct") as there:
        there.waits(lambda state: state["samples"] == 16)
        yield there
        assert len(there.errors.read_text()) < 4000  # of logs, none of tracebacks
        assert "Traceback" not in there.errors.read_text()


def sent(port: int, data: bytes) -> bytes:
    """What comes back for raw bytes, until the other side closes or falls silent for half a second."""
    answer = b""
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=5) as line:
        line.sendall(data)
        line.shutdown(socket.SHUT_WR)
        line.settimeout(0.5)
        while part := line.recv(65536):
            answer += part
    return answer


def test_hostile_bytes_are_refused_and_the_page_lives_on(viewer: Any) -> None:
    there = urlsplit(viewer.url)
    port, own, host = there.port or 0, there.path, there.netloc.encode()
    rng = np.random.default_rng(0)
    for size in rng.integers(1, 20_000, ROUNDS):
        assert b"200 OK" not in sent(port, rng.bytes(int(size)))
    token = own.strip("/").encode()
    for request in (
        b"GET /../../etc/passwd HTTP/1.1\r\nHost: " + host + b"\r\n\r\n",
        b"GET /" + token + b"/../../../etc/passwd HTTP/1.1\r\nHost: " + host + b"\r\n\r\n",
        b"GET /" + token + b"/%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\nHost: " + host + b"\r\n\r\n",
        b"GET /" + token[:-1] + b"/state HTTP/1.1\r\nHost: " + host + b"\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nHost: rebound.example\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\n\r\n",
        b"GET http://rebound/" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\nHost: rebound\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\nTransfer-Encoding: chunked\r\n\r\n",
        b"POST /" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\nContent-Length: 1000000000\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\nX: " + b"x" * 300_000 + b"\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nHost: rebound\r\n\r\n",
    ):
        answer = sent(port, request)
        assert b"200 OK" not in answer, request[:80]
        assert b"root:" not in answer
    assert viewer.state()["samples"] == 16


@given(st.binary(max_size=400))
def test_no_bytes_are_taken_for_another_request(head: bytes) -> None:
    try:
        request = parse(head)
    except Refused:
        return
    assert head.startswith(b"GET /")
    assert request.path.startswith("/")


@pytest.mark.parametrize(
    ("version", "line", "more"),
    [("1.1", "X: y", True), ("1.1", "Connection: close", False), ("1.0", "X: y", False), ("1.0", "Host: z", False)],
)
def test_who_reads_to_the_end_of_an_answer_is_given_one(version: str, line: str, more: bool) -> None:
    assert parse(f"GET /token/state HTTP/{version}\r\n{line}".encode()).more == more


@pytest.mark.parametrize(
    "lines",
    [
        "Cookie: name=Zürich",
        "X-Forwarded-For: 10.0.0.1\r\nX-Forwarded-For: 10.0.0.2\r\nVia: 1.1 a\r\nVia: 1.1 b",
        "Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABkAAQ",
    ],
    ids=["letters", "proxies", "upgrade"],
)
def test_what_a_browser_or_a_proxy_adds_is_passed_over(lines: str) -> None:
    request = parse(f"GET /token/state?made=1 HTTP/1.1\r\nHost: here:1\r\n{lines}".encode())
    assert (request.path, request.query, request.host) == ("/token/state", {"made": "1"}, "here:1")


@pytest.mark.parametrize("twice", ["Host: here:1", "host: elsewhere", "Content-Length: 0\r\nContent-Length: 5"])
def test_what_decides_about_a_question_is_said_once(twice: str) -> None:
    with pytest.raises(Refused):
        parse(f"GET /token/state HTTP/1.1\r\nHost: here:1\r\n{twice}".encode())
    with pytest.raises(Refused):
        parse("GET /tokén/state HTTP/1.1\r\nHost: here:1".encode())


def test_the_cookies_of_many_other_pages_fit_and_more_are_told_apart() -> None:
    with served(lambda request: False, lambda request: Answer(b"here")) as url:
        there = urlsplit(url)
        for letters, status, said in ((20_000, b"200 OK", b"here"), (web.HEAD_BYTES, b"431 ", b"private window")):
            cookies = b"Cookie: " + b"c" * letters
            answer = sent(there.port or 0, b"GET / HTTP/1.1\r\nConnection: close\r\n" + cookies + b"\r\n\r\n")
            assert answer.startswith(b"HTTP/1.1 " + status)
            assert said in answer
        assert b"\r\nAllow: GET\r\n" in sent(there.port or 0, b"HEAD / HTTP/1.1\r\n\r\n")


def open_files(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/fd"))


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="this system does not say what a process has open")
def test_idle_connections_give_way_and_cost_nothing(viewer: Any) -> None:
    port, before = urlsplit(viewer.url).port or 0, open_files(viewer.process.pid)
    lines = []
    for number in range(IDLE):
        line = socket.create_connection(("127.0.0.1", port), timeout=10)
        if number % 3:
            line.sendall(b"GET /" if number % 3 == 1 else b"GET / HTTP/1.1\r\nHost: x\r\nX-Slow: ")
        lines.append(line)
        if number % 100 == 99:
            assert viewer.state()["samples"] == 16
    assert open_files(viewer.process.pid) <= before + MOST_CONNECTIONS + 4
    for _ in range(5):
        assert viewer.state()["samples"] == 16
    for line in lines:
        line.close()


def test_who_asks_and_never_reads_is_dropped(viewer: Any) -> None:
    there = urlsplit(viewer.url)
    question = f"GET {there.path} HTTP/1.1\r\nHost: {there.netloc}\r\n\r\n".encode() * 200
    lines = []
    for _ in range(100):
        line = socket.socket()
        line.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        line.connect(("127.0.0.1", there.port or 0))
        line.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            line.send(question)
        lines.append(line)
    for _ in range(10):
        assert viewer.state()["samples"] == 16
    for line in lines:
        line.close()


def test_many_different_pictures_asked_for_make_no_more_than_there_are(viewer: Any) -> None:
    """Two thousand questions for frames cost twenty pictures, and meanwhile others are answered."""
    viewer.waits(lambda state: state["over"])
    own = urlsplit(viewer.url).path
    codes: list[int] = []

    def ask(first: int) -> None:
        for number in range(first, PICTURES, 4):
            codes.append(viewer.get(f"{own}picture?frame={number % 40}&samples={number}")[0])

    threads = [threading.Thread(target=ask, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    while any(thread.is_alive() for thread in threads):
        assert viewer.get(f"{own}state")[0] == 200
    for thread in threads:
        thread.join()
    assert set(codes) <= {200, 404}
    assert viewer.waits(lambda state: all(state["frames"]))["frames_version"] == 20


KILLED = """
import os, signal, sys
from pathlib import Path
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
with Recording.open(Path("run.h5")) as recording:
    samples, plan, header = list(recording.samples()), recording.plan, recording.header
writer = RecordingWriter.create(Path("lost.h5"), plan, header)
for sample in samples[:100]:
    writer.write(sample)
writer.flush()
print("written", flush=True)
sys.stdin.readline()
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("how", ["killed", "deleted", "replaced"] if SOAK else ["killed"])
def test_a_viewer_that_lost_its_scan_says_so_and_ends(nlos: Nlos, viewing: Viewing, tmp_path: Path, how: str) -> None:
    (tmp_path / "scan.yaml").write_text(COARSE_TO_FINE)
    assert nlos("scan", "scan.yaml", "-o", "run.h5").returncode == 0
    writer = subprocess.Popen(
        [sys.executable, "-c", KILLED], cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert writer.stdout is not None
    assert writer.stdout.readline() == "written\n"
    with viewing("lost.h5", "--method", "lct", "--idle-s", "2", ends=None) as viewer:
        viewer.waits(lambda state: state["samples"] == 100)
        if how == "killed":
            writer.communicate("now\n", timeout=240)
        elif how == "deleted":
            (tmp_path / "lost.h5").unlink()
            writer.communicate("now\n", timeout=240)
            (tmp_path / "lost.h5.lock").unlink(missing_ok=True)
        else:
            writer.communicate("now\n", timeout=240)
            shutil.copy(tmp_path / "run.h5", tmp_path / "another.h5")
            assert nlos("scan", "scan.yaml", "-o", "another.h5", "--overwrite").returncode == 0
            os.replace(tmp_path / "another.h5", tmp_path / "lost.h5")
        state = viewer.waits(lambda state: state["lost"] and state["over"])
        assert state["samples"] == 100
        assert state["status"] == "lost"
        assert state["pictures"]["lct"]["samples"] == 100
        assert viewer.process.wait(240) == 0


def test_a_viewer_ends_by_either_signal(nlos: Nlos, small: Path, viewing: Viewing) -> None:
    assert nlos("scan", small.name, "-o", "run.h5").returncode == 0
    with viewing("run.h5", "--method", "lct", ends=None) as viewer:
        viewer.process.send_signal(signal.SIGTERM)
        assert viewer.process.wait(240) == 143


WITHOUT = "import sys; sys.modules['torch'] = None; from nlos.__main__ import run; sys.exit(run(sys.argv[1:]))"


def test_no_page_is_promised_whose_method_is_not_installed(small: Path, tmp_path: Path) -> None:
    command = [sys.executable, "-c", WITHOUT, "scan", small.name, "--live"]
    done = subprocess.run(
        [*command, "--reconstruct", "nano"], cwd=tmp_path, capture_output=True, text=True, timeout=240, check=False
    )
    assert done.returncode == 2, done.stderr
    assert "live: http" not in done.stderr
    assert "pip install" in done.stderr
    assert not list(tmp_path.glob("*.h5"))
