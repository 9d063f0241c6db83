"""An archive: many files to a folder each, every one with an outcome of its own, here or on a Dask cluster."""

import re
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType

from nlos.acquisition.importers.own_data import how_to_convert
from nlos.acquisition.recording.no_such_file import meant_by
from nlos.cli.archive_crew import Crew
from nlos.cli.archive_on_dask import connected
from nlos.cli.archive_on_this_machine import begun_when_worth_it, processes_of
from nlos.cli.archive_record import MADE, PAGE, RECORD, ArchiveRecord, Row
from nlos.cli.archive_task import Outcome, Task
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.progress import Progress
from nlos.cli.targets import names_of
from nlos.cli.terminal import terminal
from nlos.names_for_one import folded

SUFFIXES = (
    ".h5", ".hdf5", ".mat", ".npz", ".npy", ".sdt",
    ".ptu", ".phu", ".pt2", ".pt3", ".ht2", ".ht3", ".t3r", ".phd", ".hhd", ".thd",
)  # fmt: skip
"""What of a folder is taken for a scan; a file that is named is always read."""
_OF_NEIGHBOURS = re.compile(r"tof(_raw|_\d+)?\.mat", re.IGNORECASE)
"""What f-k migration's authors call the times of flight that go with the measurements beside them."""
MOST_NAMED = 3
WAITS_S = 30.0
"""An archive that is told to end waits so long for the files that workers have begun."""


def files_of(runs: Sequence[Path]) -> list[Path]:
    """The files named, and the scans of the folders named, in the order of their names. Raises `UsageError`."""
    files: list[Path] = []
    for run in runs:
        inside = _scans_in(run) if run.is_dir() else [run]
        if not inside:
            raise UsageError(f"{run}: holds no scans ({', '.join(SUFFIXES)}). {meant_by(run) or how_to_convert()}")
        files += inside
    return list(dict.fromkeys(files))


def _scans_in(folder: Path) -> list[Path]:
    """Its files by their suffix; times of flight that go with other MATLAB files are no scan of their own."""
    shown = (path for path in folder.iterdir() if not path.name.startswith("."))  # macOS keeps ._run.h5 on shares
    inside = sorted(path for path in shown if path.suffix.lower() in SUFFIXES)
    scans = [path for path in inside if not _OF_NEIGHBOURS.fullmatch(path.name)]
    return scans if any(path.suffix.lower() == ".mat" for path in scans) else inside


def folders_for(files: Sequence[Path], output: Path) -> list[Path]:
    """`output`/NAME for every file; with its suffix where two have one stem. Raises `UsageError`."""
    names = names_of(files, output)
    if own := sorted({RECORD, PAGE} & {folded(name) for name in names}):
        raise UsageError(
            f"{output / own[0]}: is a file of every archive. Rename the scan whose results would go there."
        )
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
        with _ended_by_sigterm_too(), _crew(left, scheduler) as (crew, outcomes):
            record.forget_what_is_gone()
            record.begin(left)
            with record, Progress(len(left), what="archive", unit="files") as progress:

                def take(outcome: Outcome) -> None:
                    record.add(known[outcome.file], outcome)
                    progress.step()
                    if outcome.outcome != "done":
                        why = outcome.reason.removeprefix(f"{outcome.file}: ")
                        terminal.log(f"{outcome.file}: {outcome.outcome}: {why}", -1)

                try:
                    for outcome in outcomes:
                        take(outcome)
                except KeyboardInterrupt:
                    _end_early(crew, take)
                    raise
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
    said = [f"{len(missing)} of {len(rows)} files without a result ({_named(missing)})"] if missing else []
    if partial:
        said.append(f"{len(partial)} of {len(rows)} partial, made without their damaged samples ({_named(partial)})")
    again = " The same command with --skip-existing takes the files without a result again." if missing else ""
    words = f"{'; '.join(said)}; the others are done. {output / RECORD} says why.{again}"
    return Stopped(worst(others), words, names_files=True)


def _named(rows: Sequence[Row]) -> str:
    more = f" and {len(rows) - MOST_NAMED} more" if len(rows) > MOST_NAMED else ""
    return ", ".join(str(row["file"]) for row in rows[:MOST_NAMED]) + more


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
def _crew(tasks: Sequence[Task], scheduler: str | None) -> Iterator[tuple[Crew, Iterator[Outcome]]]:
    """Who does them, and one outcome a task, as they come. Raises `Stopped` at once where no scheduler answers."""
    here = 1 if scheduler is None else processes_of(scheduler)
    if here is not None:
        crew = Crew(tasks, "of this machine", here=True)
        try:
            yield crew, begun_when_worth_it(crew, here)
        finally:
            crew.end()
        return
    assert scheduler is not None
    with connected(scheduler) as client:
        crew = Crew(tasks, scheduler, here=False)
        crew.begin_workers(nullcontext(client))
        try:
            yield crew, crew.outcomes()
        finally:
            crew.end()


def _end_early(crew: Crew, take: Callable[[Outcome], None]) -> None:
    """Nothing more is begun, and what workers have begun is waited for: the record then says what the folder holds. At
    a second Ctrl-C, or after a while, it says of what."""
    crew.give_out_no_more()
    if tasks := crew.under_way():
        names = ", ".join(task.file for task in tasks[:3]) + (", ..." if len(tasks) > 3 else "")
        files = "1 file that a worker has" if len(tasks) == 1 else f"{len(tasks)} files that workers have"
        terminal.log(f"ending: waiting up to {WAITS_S:.0f} s for {files} begun: {names}. Ctrl-C again: not at all", -1)
        try:
            for outcome in crew.outcomes_under_way(WAITS_S):
                take(outcome)
        except KeyboardInterrupt:
            terminal.log("not waiting", -1)
    for outcome in crew.outcomes_under_way(0.0):
        take(outcome)
    tasks = crew.under_way()
    crew.end()
    for task in tasks:
        reason = "a worker had begun it when the command ended; whether it finished is not known"
        take(Outcome(task.file, "unfinished", reason, int(ExitCode.INTERRUPTED), None, ""))
