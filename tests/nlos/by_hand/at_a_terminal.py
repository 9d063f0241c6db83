"""`nlos` as somebody uses it at a terminal: keys go in, a screen comes out."""

import fcntl
import os
import pty
import re
import select
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

ARROWS = {"up": b"\x1b[A", "down": b"\x1b[B", "right": b"\x1b[C", "left": b"\x1b[D"}
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


class AtATerminal:
    """A child process whose terminal is ours."""

    def __init__(self, process: "subprocess.Popen[bytes]", terminal: int) -> None:
        self.process, self._terminal = process, terminal
        self._seen = bytearray()
        self.frames: list[tuple[float, str]] = []
        """When each screen was drawn, and what it said."""
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def press(self, *keys: str) -> None:
        """Named arrows, or characters; lone surrogates are bytes of another encoding, as in names of files."""
        for key in keys:
            os.write(self._terminal, ARROWS.get(key, key.encode(errors="surrogateescape")))

    @property
    def said(self) -> str:
        """Everything, without what moves the cursor."""
        return _CONTROL.sub("", bytes(self._seen).decode("utf-8", "replace")).replace("\r", "")

    def wait_for(self, text: str, seconds: float = 120.0) -> str:
        """Until that has been shown; what has been."""
        return self.wait_until(lambda: text in self.said, text, seconds)

    def wait_until(self, holds: Callable[[], bool], what: str, seconds: float = 120.0) -> str:
        until_s = time.monotonic() + seconds
        while not holds():
            waiting = time.monotonic() < until_s and self._reader.is_alive()
            assert waiting or holds(), f"never saw {what!r} in\n{self.said[-3000:]}"
            time.sleep(0.005)
        return self.said

    def signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)

    def ends(self, seconds: float = 120.0) -> int:
        """Its exit code."""
        code = self.process.wait(seconds)
        self._reader.join(5)
        return code

    def _read(self) -> None:
        while True:
            ready = select.select([self._terminal], [], [], 0.2)[0]
            try:
                data = os.read(self._terminal, 65536) if ready else b""
            except OSError:  # nobody holds the other end any more
                return
            if data:
                self._seen += data
                if b"\x1b[H" in data:
                    self.frames.append((time.monotonic(), data.decode("utf-8", "replace")))
            elif self.process.poll() is not None and not ready:
                return


def _take_terminal() -> None:
    """Its Ctrl-C is a signal only to who has it as the controlling terminal, and was not started to ignore it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


@contextmanager
def at_a_terminal(
    folder: Path, *words: str, environment: Mapping[str, str] | None = None,
    program: Sequence[str] = (sys.executable, "-m", "nlos"),
) -> Iterator[AtATerminal]:  # fmt: skip
    """`nlos WORDS` in `folder`, or another program; killed when the block is left, if it still runs."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [*program, *words], cwd=folder, stdin=theirs, stdout=theirs, stderr=theirs,
        start_new_session=True, preexec_fn=_take_terminal,
        env={**os.environ, "COLUMNS": "100", "LINES": "34", **(environment or {})},
    )  # fmt: skip
    os.close(theirs)
    child = AtATerminal(process, ours)
    try:
        yield child
    finally:
        process.kill()
        process.wait()
        child._reader.join(5)
        os.close(ours)
