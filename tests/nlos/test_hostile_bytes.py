"""Whatever is sent to the page's port is refused or dropped, and the page goes on answering its own user."""

import http.client
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]

ROUNDS = 500 if os.environ.get("NLOS_SOAK") else 20


@pytest.fixture
def page(nlos: Nlos, small: Path, tmp_path: Path) -> Iterator[str]:
    assert nlos("scan", small.name, "-o", "run.h5").returncode == 0
    viewer = subprocess.Popen(
        [sys.executable, "-m", "nlos", "live", "run.h5", "--method", "lct"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert viewer.stdout is not None
    yield viewer.stdout.readline().strip()
    viewer.send_signal(signal.SIGINT)
    assert viewer.wait(20) == 0


def sent(port: int, data: bytes) -> bytes:
    """What comes back for raw bytes, until the other side closes or falls silent for half a second."""
    answer = b""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as line:
        line.sendall(data)
        line.shutdown(socket.SHUT_WR)
        line.settimeout(0.5)
        try:
            while part := line.recv(65536):
                answer += part
        except OSError:
            pass
    return answer


@pytest.mark.soak
def test_hostile_bytes_are_refused_and_the_page_lives_on(page: str) -> None:
    there = urlsplit(page)
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
        b"POST /" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\nContent-Length: 1000000000\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nHost: " + host + b"\r\nX: " + b"x" * 300_000 + b"\r\n\r\n",
        b"GET /" + token + b"/state HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nHost: rebound\r\n\r\n",
    ):
        answer = sent(port, request)
        assert b"200 OK" not in answer, request[:80]
        assert b"root:" not in answer
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request("GET", f"{own}state")
    assert connection.getresponse().status == 200
