"""An archive: many files to a folder each, every one with an outcome of its own, here or on a Dask cluster."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from nlos.acquisition.importers.isolated import one_reader
from nlos.cli.archive_on_dask import cores, on_workers
from nlos.cli.archive_record import ArchiveRecord, Row
from nlos.cli.archive_task import LOCAL, Outcome, Task, attempt
from nlos.cli.exit_codes import ExitCode, UsageError
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


def reconstruct_archive(
    tasks: Sequence[Task], output: Path, scheduler: str | None, *, overwrite: bool = False, skip_existing: bool = False
) -> list[Row]:
    """Every task that is left to do, here or on the workers of `scheduler`; returns what archive.json says of them.

    Raises `FileExistsError`, unless results may be overwritten or skipped, before anything starts.
    """
    record = ArchiveRecord(output)
    left = [replace(task, results=replace(task.results, overwrite=True)) for task in tasks
            if not record.has(task, overwrite, skip_existing)]  # fmt: skip
    if len(left) < len(tasks):
        terminal.log(f"{len(tasks) - len(left)} of {len(tasks)} files already exist, skipped")
    known = {task.file: task for task in left}
    with record, Progress(len(left), what="archive", unit="files") as progress:
        for outcome in _outcomes(left, scheduler):
            record.add(known[outcome.file], outcome)
            progress.step()
            if outcome.outcome != "done":
                terminal.log(f"{outcome.file}: {outcome.outcome}: {outcome.reason}", -1)
    rows = record.rows_of(task.file for task in tasks)
    terminal.document["archive"] = rows
    return rows


def worst(rows: Sequence[Row]) -> ExitCode:
    """The exit code of an archive: a bug before all, else the highest of its files'."""
    return max((ExitCode(row["code"]) for row in rows), key=lambda code: (code == ExitCode.BUG, code))


def _outcomes(tasks: Sequence[Task], scheduler: str | None) -> Iterator[Outcome]:
    """One outcome a task, as they come."""
    if scheduler is None or not tasks:
        yield from _here(tasks)
        return

    if scheduler != LOCAL:
        yield from on_workers(tasks, scheduler)
        return
    workers = cores()
    typical_s: list[float] = []
    for taken, outcome in enumerate(_here(tasks), 1):  # workers are started once they save more than they cost
        yield outcome
        typical_s = sorted([*typical_s, outcome.seconds or 0.0]) if taken > 1 else []  # the first one also loads
        left = len(tasks) - taken
        if typical_s and left * typical_s[len(typical_s) // 2] * (1 - 1 / min(workers, max(left, 1))) > STARTUP_S:
            yield from on_workers(tasks[taken:], LOCAL)
            return


def _here(tasks: Sequence[Task]) -> Iterator[Outcome]:
    with one_reader():
        for task in tasks:
            yield attempt(task)
