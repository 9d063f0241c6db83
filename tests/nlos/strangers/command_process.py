"""Runs command lines as they come on stdin, each with a deadline after which this process ends; answers on stdout."""

import gc
import io
import json
import os
import resource
import signal
import sys
import tempfile
import time
from pathlib import Path

sys.path.append(str(Path(__file__).parents[3]))  # with -P, nothing is imported from the current folder

from tests.left_behind import MARK, Held

MEMORY_BYTES = 12 << 30
"""Address space, most of it libraries': a command that wants more has taken a damaged size for a true one."""
READER_BYTES, READER_S = 4 << 30, 5.0
"""The files of the campaign are small; the reader's own limits are for the largest that there are."""

GRACE_S = 3.0
"""What is ending by itself has ended by then."""


def left_behind(before: Held) -> list[str]:
    """What is still held after what ends by itself has ended. The reader is this process's, and replaced if it dies."""
    until_s = time.monotonic() + GRACE_S
    while left := [each for each in Held.now().more_than(before) if "isolated_child" not in each]:
        if time.monotonic() > until_s:
            break
        gc.collect()
        time.sleep(0.05)
    return left


def serve() -> None:
    from nlos.__main__ import run
    from nlos.acquisition.importers.isolated import IsolatedReader, reading_by
    from nlos.cli.escaped import escape_what_is_printed
    from nlos.cli.terminal import terminal

    os.environ[MARK] = str(os.getpid())
    tempfile.tempdir = str(Path(tempfile.mkdtemp(prefix="commands-", dir=".")).resolve())
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    answers, deadline_s = sys.stdout, float(sys.argv[1])
    with IsolatedReader(READER_BYTES, READER_S) as reader, reading_by(reader):
        for line in sys.stdin:
            raw = io.StringIO()
            sys.stdout = sys.stderr = raw
            escape_what_is_printed()
            terminal.document.clear()
            before = Held.now()
            signal.setitimer(signal.ITIMER_REAL, deadline_s)
            code = run(json.loads(line))
            signal.setitimer(signal.ITIMER_REAL, 0)
            print(
                json.dumps([code, raw.getvalue(), left_behind(before)]),
                file=answers,
                flush=True,
            )


if __name__ == "__main__":
    serve()
