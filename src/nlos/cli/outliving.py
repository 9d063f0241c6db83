"""A command outlives its terminal: what can no longer be printed is dropped, and the work continues.

A pipe whose reader went, a full device, a terminal that hung up, a stream closed before the command began: none of
these is a reason to end a scan in its middle.
"""

import os
import sys

from nlos.cli.passing_stream import PassingStream


class OutlivingStream(PassingStream):
    """A text stream that sends to nowhere once what it sends to is gone."""

    def write(self, text: str) -> int:
        try:
            self.sent.write(text)
        except (OSError, ValueError):  # ValueError: closed
            self._send_to_nowhere()
        return len(text)

    def flush(self) -> None:
        try:
            self.sent.flush()
        except (OSError, ValueError):
            self._send_to_nowhere()

    def _send_to_nowhere(self) -> None:
        """What is still buffered goes there too, also when the interpreter flushes for the last time."""
        try:
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
