"""An archive: many files to a folder each, every one with an outcome of its own, here or on a Dask cluster."""

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

from nlos.acquisition.importers.isolated import one_reader
from nlos.cli.archive_on_dask import connected, cores, on_workers
from nlos.cli.archive_record import MADE, RECORD, ArchiveRecord, Row
from nlos.cli.archive_task import LOCAL, Outcome, Task, attempt
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.progress import Progress
from nlos.cli.terminal import terminal

SUFFIXES = (".h5", ".hdf5", ".mat", ".npz", ".ptu", ".phu", ".thd", ".ht3", ".pt3")
"""What of a folder is taken for a scan; a file that is named is always read."""
STARTUP_S = 12.0
"""What workers on this machine cost before their first file: `--scheduler local` starts them for no less."""


def files_of(runs: Sequence[Path]) -> list[Path]:
    """The files named, and those of the folders named, in the order of their names. Raises `UsageError`."""
    files: list[Path] = []
    for run in runs:
        inside = sorted(path for path in run.iterdir() if path.suffix.lower() in SUFFIXES) if run.is_dir() else [run]
        if not inside:
            raise UsageError(f"{run}: holds no scans ({', '.join(SUFFIXES)})")
        files += [path for path in inside if not path.name.startswith(".")]
    return list(dict.fromkeys(files))


def folders_for(files: Sequence[Path], output: Path) -> list[Path]:
    """`output`/NAME for every file; with its suffix where two have one stem. Raises `UsageError`."""
    stems = [file.stem for file in files]
    names = [file.stem if stems.count(file.stem) == 1 else file.name for file in files]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise UsageError(f"{', '.join(twice)}: two files of one name. Reconstruct them into folders of their own.")
    return [output / name for name in names]


@dataclass(frozen=True)
class Archived:
    """What archive.json says of every file of a call, and which of these were done now."""

    rows: list[Row]
    now: list[Row]


def reconstruct_archive(
    tasks: Sequence[Task], output: Path, scheduler: str | None, *, overwrite: bool = False, skip_existing: bool = False
) -> Archived:
    """Every task that is left to do, here or on the workers of `scheduler`.

    Raises `FileExistsError`, unless results may be overwritten or skipped, and `Stopped` where no scheduler answers,
    before anything is written; `Stopped` where a Ctrl-C ends it, with what is done and what is not.
    """
    record = ArchiveRecord(output)
    left = [replace(task, results=replace(task.results, overwrite=True)) for task in tasks
            if not record.has(task, overwrite, skip_existing)]  # fmt: skip
    if len(left) < len(tasks):
        terminal.log(f"{len(tasks) - len(left)} of {len(tasks)} files already exist, skipped")
    known = {task.file: task for task in left}
    try:
        with _ended_by_sigterm_too(), _outcomes(left, scheduler) as outcomes:
            record.forget_what_is_gone()
            record.begin(left)
            with record, Progress(len(left), what="archive", unit="files") as progress:
                for outcome in outcomes:
                    record.add(known[outcome.file], outcome)
                    progress.step()
                    if outcome.outcome != "done":
                        terminal.log(f"{outcome.file}: {outcome.outcome}: {outcome.reason}", -1)
    except KeyboardInterrupt as error:
        made = sum(row["outcome"] in MADE for row in record.rows_of(tasks))
        raise Stopped(
            ExitCode.TERMINATED if isinstance(error, _Terminated) else ExitCode.INTERRUPTED,
            f"{'terminated' if isinstance(error, _Terminated) else 'interrupted'}: {made} of {len(tasks)} files have "
            f"results in {output}. The same command with --skip-existing takes the rest.",
        ) from error
    rows = record.rows_of(tasks)
    terminal.document["archive"] = rows
    return Archived(rows, record.rows_of(left))


def ended(rows: Sequence[Row], output: Path) -> Stopped | None:
    """How an archive ends in which not every file is done: how many, of which outcome, and what to do next."""
    others = [row for row in rows if row["outcome"] != "done"]
    if not others:
        return None
    missing, partial = (
        [row for row in others if row["outcome"] not in MADE], [row for row in others if row["outcome"] in MADE]
    )  # fmt: skip
    said = [f"{len(missing)} of {len(rows)} files without a result"] if missing else []
    if partial:
        said.append(f"{len(partial)} of {len(rows)} partial, made without their damaged samples")
    again = " The same command with --skip-existing takes the files without a result again." if missing else ""
    return Stopped(worst(others), f"{'; '.join(said)}; the others are done. {output / RECORD} says why.{again}")


def worst(rows: Sequence[Row]) -> ExitCode:
    """The exit code of an archive: a bug before all, else the highest of its files'."""
    return max((ExitCode(row["code"]) for row in rows), key=lambda code: (code == ExitCode.BUG, code))


class _Terminated(KeyboardInterrupt):
    """SIGTERM, which ends an archive as Ctrl-C does."""


@contextmanager
def _ended_by_sigterm_too() -> Iterator[None]:
    """Signals reach a process's main thread only; elsewhere they are left alone."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _outcomes(tasks: Sequence[Task], scheduler: str | None) -> Iterator[Iterator[Outcome]]:
    """One outcome a task, as they come. Raises `Stopped` at once where no scheduler answers."""
    if scheduler is None or not tasks:
        yield _here(tasks)
    elif scheduler == LOCAL:
        yield _here_then_on_workers(tasks)
    else:
        with connected(scheduler) as client:
            yield on_workers(client, tasks, scheduler)


def _here_then_on_workers(tasks: Sequence[Task]) -> Iterator[Outcome]:
    """Workers are started once they save more than they cost."""
    workers = cores()
    typical_s: list[float] = []
    for taken, outcome in enumerate(_here(tasks), 1):
        yield outcome
        typical_s = sorted([*typical_s, outcome.seconds or 0.0]) if taken > 1 else []  # the first one also loads
        left = len(tasks) - taken
        if typical_s and left * typical_s[len(typical_s) // 2] * (1 - 1 / min(workers, max(left, 1))) > STARTUP_S:
            with connected(LOCAL) as client:
                yield from on_workers(client, tasks[taken:], LOCAL)
            return


def _here(tasks: Sequence[Task]) -> Iterator[Outcome]:
    with one_reader():
        for task in tasks:
            yield attempt(task)
