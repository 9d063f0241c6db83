"""A visitor of a page who asks nothing, asks slowly, or never reads, is dropped after a while; others are answered."""

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest

from nlos.live import web
from nlos.live.web import Answer, Refused, Request, WebServer
from tests.nlos.test_waiting_answers import served

LARGE = b"x" * (32 << 20)
"""More than the system keeps for a reader who does not come."""
ASKED = b"GET /%s HTTP/1.1\r\nHost: x\r\n\r\n"


def answered(request: Request) -> Answer:
    if request.path == "/refused":
        raise Refused(404)
    return Answer(LARGE if request.path == "/large" else b"here", 404 if request.path == "/gone" else 200)


@pytest.fixture
def url() -> Iterator[str]:
    with served(lambda request: False, answered) as there:
        yield there


@contextmanager
def line(url: str, seconds: float = 60) -> Iterator[socket.socket]:
    there = urlsplit(url)
    with socket.create_connection((there.hostname or "", there.port or 0), timeout=seconds) as opened:
        yield opened


def all_of(opened: socket.socket) -> bytes:
    """Until the other side closes. Raises `TimeoutError` where it does not."""
    got = b""
    try:
        while part := opened.recv(1 << 16):
            got += part
    except ConnectionError:
        pass
    return got


@pytest.mark.parametrize("begun", [b"", b"GET / HTTP/1.1\r\nHost: x\r\n", ASKED % b""])
def test_who_does_not_ask_or_not_to_its_end_or_not_again_is_dropped(
    url: str, monkeypatch: pytest.MonkeyPatch, begun: bytes
) -> None:
    monkeypatch.setattr(web, "HEAD_S", 0.5)
    with line(url) as silent:
        silent.sendall(begun)
        assert (b"200 OK" in all_of(silent)) == (begun == ASKED % b"")
    monkeypatch.undo()  # a busy machine may take longer to ask
    assert urlopen(url).read() == b"here"


def test_who_asks_a_letter_at_a_time_is_dropped_all_the_same(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "HEAD_S", 0.3)
    with line(url) as slow, contextlib.suppress(ConnectionError):
        for _ in range(1200):
            slow.sendall(b"x")
            time.sleep(0.05)
        pytest.fail("a head of a minute")


def test_who_never_reads_is_dropped_with_what_was_to_be_sent(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ended, sends = threading.Event(), WebServer._send

    async def send(server: WebServer, writer: asyncio.StreamWriter, answer: Answer, kept: bool) -> None:
        try:
            await sends(server, writer, answer, kept)
        finally:
            ended.set()

    monkeypatch.setattr(WebServer, "_send", send)
    monkeypatch.setattr(web, "WRITE_S", 0.3)
    with line(url) as lazy:
        lazy.sendall(ASKED % b"large")
        assert ended.wait(30)
        assert len(all_of(lazy)) < len(LARGE)
    assert urlopen(f"{url}large").read() == LARGE  # of who reads it all comes


def test_where_all_places_are_taken_the_one_that_has_waited_longest_gives_way(
    url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web, "MOST_CONNECTIONS", 3)
    monkeypatch.setattr(web, "YOUNG_S", 0.0)
    with ExitStack() as stack:
        first, second, third = (stack.enter_context(line(url)) for _ in range(3))
        for each in (first, second, third):
            each.sendall(ASKED % b"")
            assert b"200 OK" in each.recv(1 << 16)
        first.sendall(ASKED % b"")
        assert b"200 OK" in first.recv(1 << 16)  # it has asked again: now the second waits for longest
        assert urlopen(url).read() == b"here"
        assert all_of(second) == b""
        for each in (first, third):
            each.sendall(ASKED % b"")
            assert b"200 OK" in each.recv(1 << 16)


def test_where_all_places_are_taken_by_young_ones_no_more_come_in(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web, "MOST_CONNECTIONS", 2)
    monkeypatch.setattr(web, "YOUNG_S", 60.0)
    with ExitStack() as stack:
        held = [stack.enter_context(line(url)) for _ in range(2)]
        for each in held:
            each.sendall(ASKED % b"")
            assert b"200 OK" in each.recv(1 << 16)
        with line(url) as more:
            more.sendall(ASKED % b"")
            assert all_of(more) == b""
        held[0].close()
        deadline_s = time.monotonic() + 60
        while True:  # until the server has seen it go
            with line(url) as later:
                later.sendall(ASKED % b"")
                if b"200 OK" in later.recv(1 << 16):
                    return
            assert time.monotonic() < deadline_s


@pytest.mark.parametrize(
    ("asked", "status", "kept"),
    [
        (ASKED % b"", b"200 OK", True),
        (ASKED % b"gone", b"404 Not Found", True),
        (ASKED % b"refused", b"404 Not Found", True),
        (b"POST / HTTP/1.1\r\n\r\n", b"405 Method Not Allowed", False),
        (b"GET /\r\n\r\n", b"400 Bad Request", False),
        (b"GET / HTTP/1.1\r\nContent-Length: 3\r\n\r\n", b"400 Bad Request", False),
        (b"GET / HTTP/1.1\r\nX: " + b"x" * web.HEAD_BYTES + b"\r\n\r\n", b"431 Request Header Fields Too Large", False),
        (b"GET / HTTP/1.0\r\n\r\n", b"200 OK", False),
    ],
)
def test_who_asks_what_is_no_question_is_told_and_asked_no_further(
    url: str, asked: bytes, status: bytes, kept: bool
) -> None:
    with line(url) as opened:
        opened.sendall(asked)
        head = opened.recv(1 << 16)
        assert head.startswith(b"HTTP/1.1 " + status)
        assert (b"Connection: close" in head) == (not kept)
        if kept:
            opened.sendall(ASKED % b"")
            assert b"200 OK" in opened.recv(1 << 16)
        else:
            assert status not in all_of(opened)  # to its end


def test_a_server_that_is_to_end_waits_for_no_visitor() -> None:
    begun = threading.Event()
    release = threading.Event()

    def slow(request: Request) -> Answer:
        begun.set()
        release.wait(60)
        return Answer(b"")

    with ExitStack() as stack:
        with served(lambda request: False, slow) as url:
            silent, asking = stack.enter_context(line(url)), stack.enter_context(line(url))
            asking.sendall(ASKED % b"")
            assert begun.wait(60)
        assert all_of(silent) == b""  # the block has ended, so the server has
        release.set()
