"""The page beside the terminal of `nlos monitor` and `nlos jog`: a process of its own that is told, and asks nothing.

Whatever becomes of it - stopped, killed, besieged - the light, the mirror and the terminal do not notice: updates go
through one slot, and one that nobody took in time is replaced by the next.
"""

import json
import secrets
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from nlos.by_hand.hand import Hand
from nlos.by_hand.shown import shown
from nlos.cli.terminal import terminal
from nlos.live.process import check_pages, listening, page_process

_NICENESS = 5
"""So much less than this program gets: a besieged page takes a quarter of a core that both want."""
_LAST_WORD_S = 2.0
"""How long the page may take to tell its visitors that it is over."""


class Viewer:
    """`show` costs a few tenths of a millisecond and never waits. The process is started by the first update."""

    def __init__(self, door: socket.socket) -> None:
        self._door, self._token = door, secrets.token_urlsafe(24)
        self.url = f"http://127.0.0.1:{door.getsockname()[1]}/{self._token}/"
        self._slot: bytes | None = None
        self._number, self._over = 0, False
        self._changed = threading.Condition()
        self._process: subprocess.Popen[bytes] | None = None
        self._thread = threading.Thread(target=self._hand_on, name="page", daemon=True)

    def show(self, hand: Hand, **more: Any) -> None:
        """The newest update, for whoever looks."""
        self._number += 1
        self._put({"number": self._number, **shown(hand), **more})

    def end(self, big: str, small: str, kind: str) -> None:
        """The last word, as the page's banner has it, and the end of the process."""
        if self._process is not None:
            with self._changed:
                self._over = True
            self._put({"number": self._number + 1, "over": [big, small, kind]})
            self._thread.join(_LAST_WORD_S)
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_LAST_WORD_S)
            self._process.kill()
            self._process.wait()
            self._thread.join()
        self._door.close()

    def _put(self, update: dict[str, Any]) -> None:
        if self._process is None:
            self._start()
        with self._changed:
            self._slot = json.dumps(update).encode() + b"\n"
            self._changed.notify()

    def _start(self) -> None:
        command = [sys.executable, "-P", "-m", "nlos.by_hand.page"]
        self._process = page_process(command, self._door, self._token, _NICENESS, subprocess.PIPE)
        self._thread.start()

    def _hand_on(self) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        over = False
        with suppress(OSError), self._process.stdin as pipe:  # closed from the other end: nobody is there any more
            while not over:
                with self._changed:
                    self._changed.wait_for(lambda: self._slot is not None)
                    update, self._slot = self._slot, None
                    over = self._over
                assert update is not None
                pipe.write(update)
                pipe.flush()


@contextmanager
def viewer(wanted: bool, port: int) -> Iterator[Viewer | None]:
    """The page while the block runs, its address said; None where none is wanted. Enter it before the bench is opened,
    so that its last word is said when the light is off. Raises `UsageError` where the port is taken."""
    if not wanted:
        yield None
        return
    check_pages("--live")
    page = Viewer(listening(port))
    terminal.log(f"live: {page.url}", -1)
    terminal.document["live"] = {"url": page.url}
    try:
        yield page
    finally:
        error = sys.exception()
        ends_well = error is None or isinstance(error, KeyboardInterrupt | SystemExit)
        if ends_well:
            page.end("It has ended", "The light is off.", "good")
        else:
            page.end("It has ended", str(error), "bad")
