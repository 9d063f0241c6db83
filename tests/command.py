"""`nlos WORDS` within the test's own process, for tests of what a command makes and says. How a process begins and
ends, what signals, streams and terminals do to it, is tested with processes; each of them takes a second to begin."""

import contextlib
import io
import signal
import subprocess
import threading
from pathlib import Path

from nlos.__main__ import run


def nlos(folder: Path, *words: str, check: bool = False) -> "subprocess.CompletedProcess[str]":
    """Runs one command in `folder`. With `check`, as `subprocess.run` has it, it has to end with 0."""
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in "oe")
    main = threading.current_thread() is threading.main_thread()
    before = signal.getsignal(signal.SIGINT)
    try:
        with contextlib.chdir(folder), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = run(list(words))
    finally:
        if main:
            signal.signal(signal.SIGINT, before)
    said = [stream.buffer.getvalue().decode() for stream in (out, err)]  # type: ignore[attr-defined]
    done = subprocess.CompletedProcess(["nlos", *words], code, *said)
    if check and code:
        raise AssertionError(f"nlos {' '.join(words)} ended with {code}: {done.stderr}")
    return done
