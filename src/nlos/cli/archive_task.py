"""One file of an archive: what is to be done with it, doing it, and what became of it."""

import socket
import time
import traceback
from dataclasses import dataclass
from os import getpid
from pathlib import Path
from typing import Any, Literal

from nlos.chain import reconstruct_file
from nlos.cli.exit_codes import ExitCode, exit_code, missing_extra

LOCAL = "local"
"""The scheduler that means workers on this machine."""


@dataclass(frozen=True)
class Task:
    """One file, where its results go, and how they are made; a worker needs nothing else."""

    file: str
    """As the user named it."""
    run: Path
    folder: Path
    method: str
    settings: dict[str, object]
    options: dict[str, Any]
    """Of `nlos.chain.reconstruct_file`."""


@dataclass(frozen=True)
class Outcome:
    """What became of one file."""

    file: str
    outcome: Literal["done", "failed", "unfinished"]
    reason: str
    code: int
    seconds: float | None
    """That the file took, reading and drawing included."""
    worker: str
    method_s: float | None = None
    """That the method took of them."""


def attempt(task: Task) -> Outcome:
    """What a worker does with one file. It raises nothing: one file's trouble is no other file's."""
    worker, began = f"{socket.gethostname()}:{getpid()}", time.monotonic()
    try:
        done = reconstruct_file(task.run, task.method, task.settings, task.folder, **task.options)
    except Exception as error:  # whatever it is, the other files are done; what was not foreseen is said to be a bug
        code = exit_code(error)
        reason = missing_extra(error) or str(error) or type(error).__name__
        if code == ExitCode.BUG:
            reason = "this is a bug; please report it: " + "".join(traceback.format_exception(error)).strip()
        return Outcome(task.file, "failed", reason, int(code), time.monotonic() - began, worker)
    return Outcome(task.file, "done", "", 0, time.monotonic() - began, worker, done.seconds)
