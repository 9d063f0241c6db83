"""A command outlives its terminal: what can no longer be printed is dropped, and the work continues.

A pipe whose reader went, a full device, a terminal that hung up, a stream closed before the command began: none of
these is a reason to end a scan in its middle. Nor does light wait for a terminal that takes nothing more (Ctrl-S, a
connection that hangs), or a pipe or socket whose reader sleeps: while it is on, what they do not take at once is
dropped, also what was waiting for them since before. Nor does a bench that is being closed wait for one, nor the end
of a command that a signal ended.

Of a file, results that its disk did not take are remembered: somebody will read it, and has to be told.
"""

import errno
import os
import select
import stat
import sys
import time
from typing import TextIO

from nlos.cli.passing_stream import PassingStream
from nlos.drivers.exit_paths import a_bench_is_closing, a_bench_is_open, light_may_be_on, was_told_to_end

_TAKES_S = 0.1
"""So long is waited for a stream that took all that came before; one that did not is not waited for."""
_LOOK_S = 0.05
"""In the dark a stream is waited for, and so often it is looked whether it still may be."""
_PIECE = 512
"""A pipe that has room at all takes so many bytes without waiting (PIPE_BUF)."""


class OutlivingStream(PassingStream):
    """A text stream that sends to nowhere once what it sends to is gone."""

    def __init__(self, sent: TextIO) -> None:
        super().__init__(sent)
        self._unwaiting = _without_waiting(sent)
        self._is_terminal = self.isatty()
        self._stuck = self._offering = False
        self.refused: OSError | None = None
        """Why the disk of the file that this leads to did not take all of it."""

    def write(self, text: str) -> int:
        try:
            if self._unwaiting is not None and self._offers():
                self._offer(text.encode(self.sent.encoding, "backslashreplace"), self._unwaiting)
            else:
                self.sent.write(text)
        except (OSError, ValueError) as error:  # ValueError: closed
            self._send_to_nowhere(error)
        return len(text)

    def flush(self) -> None:
        try:
            if self._unwaiting is None or not (a_bench_is_open() or self._hurried()):
                self.sent.flush()  # what was written before the first bench; nothing else is below
        except (OSError, ValueError) as error:
            self._send_to_nowhere(error)

    def complete(self) -> None:
        """Hands on what is left. A file on a network share says only where it is closed what it did not take."""
        self.flush()
        try:
            os.close(os.dup(self.sent.fileno()))
        except (OSError, ValueError) as error:
            self._send_to_nowhere(error)

    def _offers(self) -> bool:
        """Whether it is written in pieces: from the first bench on, also when that is closed, so that a signal ends
        what waits then; and where a program that shares the pipe has it wait for nobody."""
        self._offering |= a_bench_is_open() or not os.get_blocking(self.sent.fileno())
        return self._offering or self._hurried()

    def _hurried(self) -> bool:
        """Whether nothing is waited for that has no deadline."""
        return light_may_be_on() or a_bench_is_closing() or (self._is_terminal and was_told_to_end())

    def _offer(self, data: bytes, number: int) -> None:
        """Sends what is taken, past what is buffered below: in the dark all of it, but whoever waits there, another
        thread perhaps and with a lock of the screen, waits no longer once light comes."""
        until_s = time.monotonic() + (0.0 if self._stuck else _TAKES_S)
        while data:
            left_s = until_s - time.monotonic() if self._hurried() else _LOOK_S
            if select.select([], [number], [], min(max(left_s, 0.0), _LOOK_S))[1]:
                try:
                    data = data[os.write(number, data[:_PIECE]) :]
                    continue
                except BlockingIOError:  # room for less than the next character
                    time.sleep(min(max(left_s, 0.0), _LOOK_S))
            if left_s <= 0:
                break
        self._stuck = bool(data)

    def _send_to_nowhere(self, why: Exception) -> None:
        """What is still buffered goes there too, also when the interpreter flushes for the last time."""
        self._unwaiting = None
        try:
            if isinstance(why, OSError) and not self._is_terminal and _is_of_a_disk(self.sent.fileno(), why):
                self.refused = self.refused or why
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.sent.fileno())
            os.close(nowhere)
        except (OSError, ValueError):
            self.sent = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - as long as the process

    def isatty(self) -> bool:
        try:
            return self.sent.isatty()
        except (OSError, ValueError):
            return False


def _is_of_a_disk(number: int, why: OSError) -> bool:
    """Whether it leads to a file or a device, not to a reader who may leave. A terminal that hung up before the command
    began is told by its error alone."""
    mode = os.fstat(number).st_mode
    return stat.S_ISREG(mode) or stat.S_ISBLK(mode) or (stat.S_ISCHR(mode) and why.errno != errno.EIO)


def _without_waiting(sent: TextIO) -> int | None:
    """A file number for the same terminal, pipe or socket (of `ssh HOST nlos`, or the system's log), writing to which
    waits for nothing once it says that it has room; None where there is none, or no need. A terminal's is its own, so
    that who shares the terminal waits as before."""
    if not hasattr(os, "ttyname"):
        return None
    try:
        number = sent.fileno()
        if os.isatty(number):
            return os.open(os.ttyname(number), os.O_WRONLY | os.O_NOCTTY | os.O_NONBLOCK)
        mode = os.fstat(number).st_mode
        return number if stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode) else None
    except (OSError, ValueError):
        return None


def outlive_terminal() -> None:
    """From now on nothing that this process prints can end it, and no file that it opens takes the number of a standard
    stream: a library's message would then be written into a recording."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
        if getattr(sys, name) is None:
            mode = "r" if name == "stdin" else "w"
            setattr(sys, name, open(number, mode, encoding="utf-8", closefd=False))  # noqa: SIM115
    sys.stdout, sys.stderr = OutlivingStream(sys.stdout), OutlivingStream(sys.stderr)


def refused_results() -> OSError | None:
    """Why the results that this process printed are not whole in the file that they were sent to; None where they are,
    where a reader left, and where there was no standard output. To be asked when all is printed."""
    below = getattr(sys.stdout, "sent", None)
    if not isinstance(below, OutlivingStream):
        return None
    below.complete()
    return below.refused
