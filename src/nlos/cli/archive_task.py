"""One file of an archive: what is to be done with it, doing it, and what became of it."""

import socket
import time
import traceback
from dataclasses import dataclass
from os import getpid
from pathlib import Path
from typing import Any, Literal

from nlos.acquisition.importers.given import NOTHING, Given
from nlos.chain import reconstruct_file
from nlos.cli.archive_inputs import stamp
from nlos.cli.exit_codes import ExitCode, exit_code, missing_package
from nlos.recipe import Recipe
from nlos.results_folder import ResultsFolder


@dataclass(frozen=True)
class Task:
    """One file, where its results go, and how they are made; a worker needs nothing else."""

    file: str
    """As the user named it."""
    run: Path
    recipe: Recipe
    results: ResultsFolder
    given: Given = NOTHING
    frame: int | None = None


@dataclass(frozen=True)
class Outcome:
    """What became of one file."""

    file: str
    outcome: Literal["done", "partial", "failed", "unfinished"]
    """Partial: a result was made, without samples of the file that are damaged."""
    reason: str
    code: int
    seconds: float | None
    """That the file took, reading and drawing included."""
    worker: str
    method_s: float | None = None
    """That the method took of them."""
    source: dict[str, Any] | None = None
    """The file as it was read: see `archive_inputs.stamp`."""


def attempt(task: Task) -> Outcome:
    """What a worker does with one file. It raises nothing: one file's trouble is no other file's."""
    worker, began = f"{socket.gethostname()}:{getpid()}", time.monotonic()
    source = stamp(task.run)
    try:
        done = reconstruct_file(task.run, task.recipe, task.results, given=task.given, frame=task.frame)
    except Exception as error:  # whatever it is, the other files are done; what was not foreseen is said to be a bug
        code = exit_code(error)
        reason = missing_package(error) or str(error) or type(error).__name__
        if code == ExitCode.BUG:
            reason = "this is a bug; please report it: " + "".join(traceback.format_exception(error)).strip()
        return Outcome(task.file, "failed", reason, int(code), time.monotonic() - began, worker, source=source)
    seconds = time.monotonic() - began
    if done.left_aside:
        reason = (
            f"{done.left_aside} samples are damaged or unreadable and are skipped: this is of the other points, "
            f"{done.points}. `nlos verify` names them."
        )
        return Outcome(task.file, "partial", reason, int(ExitCode.DATA), seconds, worker, done.seconds, source)
    return Outcome(task.file, "done", "", 0, seconds, worker, done.seconds, source)
