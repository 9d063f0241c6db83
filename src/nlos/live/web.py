"""A small web server for one page and its data: GET only, on a socket that is given, with a bound for everything.

A connection that asks nothing is closed after seconds, the one that has waited longest gives way to a new one, answers
are made by a few threads, and whoever reads too slowly is dropped: nothing a visitor does costs more than a little
memory.
"""

import asyncio
import contextlib
import socket
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlsplit

MOST_CONNECTIONS = 256
YOUNG_S = 0.25
"""A connection younger than this does not give way to another."""
THREADS = 3
HEAD_BYTES = 1 << 15
"""A browser sends the cookies of every page of this machine, whatever their ports: notebooks leave many."""
HEAD_S = 10.0
"""How long a connection may take to ask (again)."""
WAIT_S = 0.25
"""How long an answer may wait for news: what comes without is as old as that at most."""
NEWS_S = 0.02
"""How often it is looked whether there is any."""
WRITE_S = 20.0
"""How long a visitor may take to read an answer."""
_ELSEWHERE = (
    b'{"message": "refused: use the whole address that the command printed, with its last /. A proxy before it has to '
    b'pass on that name and port as Host."}'
)
_TOO_LONG = (
    b'{"message": "refused: more than 32 KiB before the question. Delete the cookies that other pages of this machine '
    b'have left, or open the page in a private window."}'
)
_ONCE = ("host", "content-length")
"""What may not be said twice; chains of proxies repeat others."""
_REASONS = {200: "OK", 400: "Bad Request", 403: "Forbidden", 404: "Not Found", 405: "Method Not Allowed",
            431: "Request Header Fields Too Large"}  # fmt: skip


@dataclass(frozen=True)
class Request:
    """One GET: the path decoded no further than ASCII, and its query."""

    path: str
    query: Mapping[str, str]
    host: str
    more: bool = True
    """Whether this visitor may ask again on the same connection; else the answer ends with it."""


@dataclass(frozen=True)
class Answer:
    """What is sent back."""

    body: bytes
    status: int = 200
    kind: str = "application/json"
    headers: Mapping[str, str] = field(default_factory=dict)


class Refused(Exception):
    """A request that gets no more than this answer."""

    def __init__(self, status: int) -> None:
        self.status = status
        super().__init__(_REASONS[status])


def parse(head: bytes) -> Request:
    """The request of an HTTP/1 head. Raises `Refused` for anything but a plain GET without a body."""
    try:
        first, *lines = head.decode("latin-1").split("\r\n")  # a cookie or a person's name may be no ASCII
        method, target, version = first.split(" ")
        fields = [line.split(":", 1) for line in lines if line]
        known = {name.lower(): value.strip() for name, value in fields}
    except ValueError as error:
        raise Refused(400) from error
    if version not in ("HTTP/1.1", "HTTP/1.0") or not target.startswith("/") or not target.isascii():
        raise Refused(400)
    if method != "GET":
        raise Refused(405)
    if any(sum(name.lower() == once for name, _ in fields) > 1 for once in _ONCE):
        raise Refused(400)
    if "transfer-encoding" in known or known.get("content-length", "0") != "0":
        raise Refused(400)
    try:
        there = urlsplit(target)
        query = dict(parse_qsl(there.query, max_num_fields=8))
    except ValueError as error:
        raise Refused(400) from error
    more = version == "HTTP/1.1" and known.get("connection", "").lower() != "close"
    return Request(there.path, query, known.get("host", ""), more)


class WebServer:
    """Serves `answer` on `door` until `stop()`; `answer` is called in threads and may raise `Refused`. While
    `nothing_new` says so of a request, its answer waits: for whoever would ask again and again."""

    def __init__(
        self,
        door: socket.socket,
        answer: Callable[[Request], Answer],
        nothing_new: Callable[[Request], bool] = lambda request: False,
    ) -> None:
        self._door, self._answer, self._nothing_new = door, answer, nothing_new
        self._open: dict[asyncio.StreamWriter, float] = {}
        """Connections that wait for their visitor, to ask or to read -> since when."""
        self._count = 0
        self._threads = ThreadPoolExecutor(THREADS, thread_name_prefix="page")
        self._stopping = False

    def run(self) -> None:
        """Returns after `stop`; Ctrl-C ends it with `KeyboardInterrupt`."""
        try:
            asyncio.run(self._run())
        finally:
            self._threads.shutdown(wait=False, cancel_futures=True)

    def stop(self) -> None:
        """May be called from any thread."""
        self._stopping = True

    async def _run(self) -> None:
        server = await asyncio.start_server(self._talk, sock=self._door, limit=HEAD_BYTES, backlog=128)
        while not self._stopping:
            await asyncio.sleep(0.2)
        server.close()
        for writer in list(self._open):
            writer.transport.abort()

    async def _talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._count += 1
        writer.transport.set_write_buffer_limits(high=0)
        try:
            more = self._count <= MOST_CONNECTIONS or self._made_room()
            while more and not self._stopping:
                self._open[writer] = time.monotonic()
                head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_S)
                self._open.pop(writer, None)
                more = await self._serve(head, writer)
        except asyncio.LimitOverrunError:
            await self._send(writer, Answer(_TOO_LONG, 431), False)
        except (TimeoutError, OSError, asyncio.IncompleteReadError):
            pass
        finally:
            self._count -= 1
            self._open.pop(writer, None)
            writer.transport.abort()

    def _made_room(self) -> bool:
        """Closes the connection that has waited for its visitor for longest; False where none does."""
        oldest = min(self._open, key=self._open.__getitem__, default=None)
        if oldest is None or time.monotonic() - self._open[oldest] < YOUNG_S:
            return False
        del self._open[oldest]
        oldest.transport.abort()
        return True

    async def _serve(self, head: bytes, writer: asyncio.StreamWriter) -> bool:
        """Answers one request; whether the connection is kept."""
        more = False
        try:
            request = parse(head[:-4])
            more, until_s = request.more, time.monotonic() + WAIT_S
            while self._nothing_new(request) and time.monotonic() < until_s and not self._stopping:
                await asyncio.sleep(NEWS_S)
            answer = await asyncio.get_running_loop().run_in_executor(self._threads, self._answer, request)
        except Refused as refused:
            said = _ELSEWHERE if refused.status == 403 else b'{"message": "refused"}'
            answer = Answer(said, refused.status, headers={"Allow": "GET"} if refused.status == 405 else {})
        kept = more and answer.status in (200, 404)
        await self._send(writer, answer, kept)
        return kept

    async def _send(self, writer: asyncio.StreamWriter, answer: Answer, kept: bool) -> None:
        headers = {
            "Content-Type": answer.kind,
            "Content-Length": str(len(answer.body)),
            "Cache-Control": "no-store",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Connection": "keep-alive" if kept else "close",
            **answer.headers,
        }
        lines = [f"HTTP/1.1 {answer.status} {_REASONS[answer.status]}", *(f"{k}: {v}" for k, v in headers.items())]
        writer.write("\r\n".join(lines).encode("ascii") + b"\r\n\r\n" + answer.body)
        self._open[writer] = time.monotonic()
        await asyncio.wait_for(writer.drain(), WRITE_S)
        self._open.pop(writer, None)
        if not kept:
            with contextlib.suppress(OSError):
                writer.close()
                await asyncio.wait_for(writer.wait_closed(), WRITE_S)
