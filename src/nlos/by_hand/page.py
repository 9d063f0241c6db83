"""The page of `nlos monitor` and `nlos jog`, in a process of its own: read-only, told of each update through a pipe.

Nothing here can reach the laser or the mirror: there is no way back through the pipe. It ends with the program that
started it, after it has said so to whoever looks.
"""

import json
import os
import socket
import sys
import threading
import time
from importlib.resources import files

from nlos.live.admission import admitted, page_answer
from nlos.live.process import SOCKET, TOKEN
from nlos.live.web import Answer, Request, WebServer

_WAITS_S = 0.1
"""How long a question waits for an update that is newer than what the visitor has."""
_SEEN_S = 1.0
"""A visitor who has not asked for so long is gone."""
_LAST_WORD_S = 1.5
_KILLED = (
    "The program was killed: the light may be on",
    "Nobody commands the shutter now. Look at the laser, then run `nlos shutter close`.",
    "bad",
)


class MonitorPage:
    """Answers with the newest update, as soon as there is one that the visitor does not have."""

    def __init__(self, token: str, hosts: set[str]) -> None:
        self._token, self._hosts, self._html = token.encode(), hosts, assembled()
        self._changed = threading.Condition()
        self._newest, self._number, self.over = b"{}", 0, False
        self._asked_s, self._told = -float("inf"), False

    def __call__(self, request: Request) -> Answer:
        """Raises `Refused`."""
        what = admitted(request, self._token, self._hosts)
        if what == "":
            return page_answer(self._html)
        if what != "newest":
            return Answer(b'{"message": "nothing is called that"}', 404)
        has = request.query.get("has", "")
        has_number = int(has) if has.isascii() and has.isdigit() and len(has) < 12 else 0
        with self._changed:
            self._asked_s = time.monotonic()
            self._changed.wait_for(lambda: self._number > has_number, _WAITS_S)
            self._told = self._told or self.over
            return Answer(self._newest if self._number > has_number else b"{}")

    def read(self, pipe: "object") -> None:
        """Updates until the pipe's end, then the last word: the program's own, or that it was killed."""
        for line in pipe:  # type: ignore[attr-defined]
            self._take(line)
        if not self.over:
            self._take(json.dumps({"number": self._number + 1, "over": _KILLED}).encode())

    def wait_until_told(self) -> None:
        """Until whoever looks has been told that it is over; a second and a half at most."""
        until_s = time.monotonic() + _LAST_WORD_S
        while time.monotonic() < until_s and not self._told and time.monotonic() - self._asked_s < _SEEN_S:
            time.sleep(0.02)
        time.sleep(0.1)

    def _take(self, line: bytes) -> None:
        update = json.loads(line)
        with self._changed:
            self._newest, self._number = line.strip(), int(update["number"])
            self.over = "over" in update
            self._changed.notify_all()


def assembled() -> str:
    """The page with its styles and scripts inside; colours and drawing are those of the page of a scan."""
    ours, shared = files("nlos.by_hand") / "page_parts", files("nlos.live") / "page_parts"
    styles = (shared / "colours.css", ours / "monitor.css")
    scripts = (shared / "draw.js", ours / "charts.js", ours / "monitor.js")
    return (
        (ours / "monitor.html")
        .read_text(encoding="utf-8")
        .replace("STYLES", "\n".join(each.read_text(encoding="utf-8") for each in styles))
        .replace("SCRIPTS", "\n".join(each.read_text(encoding="utf-8") for each in scripts))
    )


def main() -> None:
    """Serves on the socket that was handed over, until the pipe on standard input ends."""
    door = socket.socket(fileno=int(os.environ.pop(SOCKET)))
    number = door.getsockname()[1]
    page = MonitorPage(os.environ.pop(TOKEN), {f"127.0.0.1:{number}", f"localhost:{number}"})
    server = WebServer(door, page)

    def read() -> None:
        try:
            page.read(sys.stdin.buffer)
            page.wait_until_told()
        finally:
            server.stop()

    threading.Thread(target=read, daemon=True).start()
    server.run()


if __name__ == "__main__":
    main()
