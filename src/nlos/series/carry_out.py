"""Carries a series out: what is missing, one scan after the other, each outcome on disk before the next begins."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.acquisition.recording.salvage import settle
from nlos.acquisition.recording.writer_lock import WriterLock
from nlos.acquisition.scanning.alarms import AlarmRaised
from nlos.chain import reconstruct_file
from nlos.cli.exit_codes import ExitCode, UsageError, exit_code
from nlos.cli.taking import ScanOptions, require_shutter, take
from nlos.cli.terminal import terminal
from nlos.configs.load import Loaded
from nlos.recipe import Recipe
from nlos.recon.errors import ReconError
from nlos.recon.methods import find
from nlos.results_folder import ResultsFolder
from nlos.run_defaults import expanded, hooks_for
from nlos.series import journal as outcomes
from nlos.series.expand import Run, expand
from nlos.series.forecast import Forecast, forecasts
from nlos.series.journal import Journal
from nlos.series.room import check_room
from nlos.series.settings import QueueSettings
from nlos.telling import ALARM, DONE, Ending, tell
from nlos.time_of_day import shown_after

ENDS_BY = {ExitCode.ALARM: outcomes.ALARM, ExitCode.STORAGE: outcomes.STORAGE,
           ExitCode.INTERRUPTED: outcomes.INTERRUPTED, ExitCode.TERMINATED: outcomes.INTERRUPTED}  # fmt: skip


@dataclass(frozen=True)
class Series:
    """A queue that was read and expanded. `retry`: scans that an alarm ended are taken up again."""

    queue: Loaded[QueueSettings]
    folder: Path
    runs: Sequence[Run]
    retry: bool = False

    @classmethod
    def of(cls, queue: Loaded[QueueSettings], retry: bool = False) -> "Series":
        """Raises `ConfigError` for a queue that no bench could carry out."""
        said = queue.settings.folder
        folder = queue.path.parent / expanded(said if said is not None else queue.path.stem)
        if queue.settings.reconstruct is not None:
            find(queue.settings.reconstruct)
        runs = expand(queue)
        for run in runs:
            require_shutter(run.bench, queue.settings.no_shutter)
        return cls(queue, folder, runs, retry)

    def recording(self, run: Run) -> Path:
        return self.folder / f"{run.name}.h5"

    @property
    def constants(self) -> Path | None:
        said = self.queue.settings.constants
        return None if said is None else Path(said)


def carry_out(series: Series) -> int:
    """Everything that is still to do; returns the exit code: 5 where an alarm left a scan as it is. Raises what ends
    the series: it resumes from there when it is carried out again."""
    own = [each for each in (series.folder, *series.folder.parents) if not each.exists()]
    try:
        series.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"{series.folder}: cannot be made ({error.strerror}). Name another `folder` in {series.queue.path}."
        ) from error
    lock = WriterLock(series.folder / outcomes.NAME)
    try:
        journal = Journal(series.folder)
        todo = [run for run in series.runs if not _is_over(series, journal, run)]
        expected = list(forecasts(todo, series.constants))
        _tell(series, journal, todo, expected)
        coming = dict(zip((run.name for run in todo), expected, strict=True))
        journal.plan({run.name: coming[run.name].seconds if run.name in coming else 0.0 for run in series.runs})
        check_room(series.folder, [(series.recording(run), each) for run, each in zip(todo, expected, strict=True)])
        for run in todo:
            _one(series, journal, run)
        failed = _pictures(series, journal) if series.queue.settings.reconstruct is not None else 0
        return _ended(series, journal, failed)
    finally:
        lock.release()
        with suppress(OSError):  # refused before there was anything to keep, or not empty
            for each in own:
                each.rmdir()


def forecast(series: Series) -> None:
    """Checks everything and says what is to come; writes nothing."""
    journal = Journal(series.folder)
    todo = [run for run in series.runs if not _seems_over(series, journal, run)]
    expected = list(forecasts(todo, series.constants))
    _tell(series, journal, todo, expected)
    check_room(series.folder, [(series.recording(run), each) for run, each in zip(todo, expected, strict=True)])


def _seems_over(series: Series, journal: Journal, run: Run) -> bool:
    """What `_is_over` will say, as far as that is known without writing. Raises `UsageError` where the run was another
    one, `FileExistsError` where its recording is none of the series'."""
    last, path = journal.last(run.name), series.recording(run)
    if last is not None and last.digest != run.digest:
        raise UsageError(
            f"{series.folder}: {run.name} was begun with other settings. Undo the change in {series.queue.path} or in "
            "a file that it names, or give this series a folder of its own."
        )
    if last is None and path.exists() and not _holds(path, run):
        raise FileExistsError(f"{path}: exists and is none of this series'. Give the series a folder of its own.")
    if last is not None and last.what == outcomes.ALARM and series.queue.settings.on_alarm == "skip":
        return not series.retry
    return last is not None and last.what == outcomes.DONE and path.exists()


def _is_over(series: Series, journal: Journal, run: Run) -> bool:
    """Whether nothing is left to do for a run: its recording says so, or an alarm ended it and nobody wants it again.
    Raises as `_seems_over` does."""
    if _seems_over(series, journal, run):
        return True
    path = series.recording(run)
    if not path.exists():
        return False
    try:
        complete = settle(path, run.scan.settings.plan())
    except (ValueError, StorageError):  # resuming says what is wrong with it, or starts again
        return False
    if complete:  # it was killed between its last sample and its line
        journal.add(run.name, outcomes.DONE, run.digest, "complete when the series was resumed")
    return complete


def _holds(path: Path, run: Run) -> bool:
    """Whether a recording that no journal knows is this run all the same: the journal was lost."""
    try:
        with open_checked(path) as recording:
            return recording.plan == run.scan.settings.plan()
    except (InvalidData, StorageError):
        return False


def _one(series: Series, journal: Journal, run: Run) -> None:
    """One scan. An alarm that may be skipped is written down; whatever else ends it is passed on to the caller."""
    path = series.recording(run)
    terminal.log(f"run {run.name}")
    journal.add(run.name, outcomes.BEGUN, run.digest)
    try:
        take(run.scan, run.bench, path, ScanOptions(run.notes, resume=True, constants=series.constants))
    except BaseException as error:
        code = ExitCode.TERMINATED if isinstance(error, SystemExit) else exit_code(error)
        journal.add(run.name, ENDS_BY.get(code, outcomes.FAILED), run.digest, str(error), int(code))
        if code not in (ExitCode.INTERRUPTED, ExitCode.TERMINATED):
            _announce(series, run, ALARM, str(error), code)
        if not _may_go_on(series, error):
            again = f"`nlos queue {series.queue.path}` resumes it."
            error.add_note(f"the series ended in run {run.name}. {again}")
            raise
        terminal.log(f"warning: run {run.name} left as it is: {error}")
        return
    journal.add(run.name, outcomes.DONE, run.digest)
    if series.queue.settings.reconstruct is None and _is_stale(journal, run, path):
        terminal.log(f"warning: {path.with_suffix('')}: holds a picture that is older than {path.name}, so not of it")


def _is_stale(journal: Journal, run: Run, path: Path) -> bool:
    """Whether there is a picture that was made before the recording was: of one that had its name. The order of the
    journal's lines tells, whatever the clock was set to meanwhile; of a picture that it does not know, the files'
    times."""
    picture = path.with_suffix("") / "reconstruction.h5"
    if not picture.exists():
        return False
    ours = journal.has_picture(run.name)
    return picture.stat().st_mtime_ns < path.stat().st_mtime_ns if ours is None else not ours


def _may_go_on(series: Series, error: BaseException) -> bool:
    """An alarm is of this scan; a trip, a lost device or a full disk would meet the next one, too."""
    of_this_scan = isinstance(error, AlarmRaised) or isinstance(error.__cause__, AlarmRaised)
    return of_this_scan and series.queue.settings.on_alarm == "skip"


def _pictures(series: Series, journal: Journal) -> int:
    """Reconstructs every complete recording that has no picture yet, or one of an older recording; how many could not
    be."""
    method, failed = series.queue.settings.reconstruct, 0
    assert method is not None
    for run in series.runs:
        path = series.recording(run)
        folder = path.with_suffix("")
        if journal.outcome(run.name) != outcomes.DONE:
            continue
        if (folder / "reconstruction.h5").exists() and not _is_stale(journal, run, path):
            continue
        try:
            done = reconstruct_file(
                path, Recipe(method, constants=series.constants), ResultsFolder(folder, overwrite=True)
            )
        except (ReconError, ValueError, OSError, RuntimeError, MemoryError) as error:
            journal.add(run.name, outcomes.NO_PICTURE, run.digest, str(error), int(exit_code(error)))
            terminal.log(f"warning: {path}: no picture: {error}")
            failed += 1
            continue
        journal.add(run.name, outcomes.PICTURE, run.digest, f"{method}, {done.seconds:.2f} s")
        terminal.log(f"{folder}: {method}, {done.seconds:.2f} s")
    return failed


def _tell(series: Series, journal: Journal, todo: Sequence[Run], expected: Sequence[Forecast]) -> None:
    """What is to come: each scan, and the whole."""
    width = max(len(run.name) for run in series.runs)
    coming = dict(zip((run.name for run in todo), expected, strict=True))
    for run in series.runs:
        each = coming.get(run.name)
        words = journal.outcome(run.name) if each is None else (
            f"{each.points} points, {each.seconds:.1f} s, {each.disk_bytes / 1e6:.1f} MB, {each.scheme}"
        )  # fmt: skip
        terminal.result(f"{run.name:<{width}}  {words}")
    seconds, disk = sum(each.seconds for each in expected), sum(each.disk_bytes for each in expected)
    terminal.result(
        f"{len(todo)} of {len(series.runs)} scans to take: {_duration(seconds)} of bench time, "
        f"until {shown_after(seconds)}, and {disk / 1e6:.0f} MB",
        to_take=len(todo), scans=len(series.runs), expected_s=seconds, expected_disk_bytes=disk,
    )  # fmt: skip


def _duration(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    return f"{hours} h {rest // 60:02d} min" if hours else f"{rest // 60} min {rest % 60:02d} s"


def _ended(series: Series, journal: Journal, failed: int) -> int:
    """Says what became of each, and whom it concerns."""
    found = {run.name: journal.outcome(run.name) for run in series.runs}
    alarms = sum(each == outcomes.ALARM for each in found.values())
    pictures = f", {failed} without a picture" if failed else ""
    words = f"{series.folder}: {sum(each == outcomes.DONE for each in found.values())} of {len(found)} scans done"
    words += f", {alarms} ended by an alarm{pictures}" if alarms else pictures
    terminal.result(words, folder=str(series.folder), outcomes=found)
    code = ExitCode.ALARM if alarms else ExitCode.RECONSTRUCTION if failed else ExitCode.DONE
    _announce(series, None, DONE, words, code)
    return int(code)


def _in_common(notes: Sequence[RunNotes]) -> RunNotes:
    """What is true of all runs: of samples and tags that differ none is the series'."""
    first = notes[0]
    same = {
        name: getattr(first, name) if all(getattr(each, name) == getattr(first, name) for each in notes) else ""
        for name in ("sample", "operator", "note")
    }
    return RunNotes(**same, tags=tuple(tag for tag in first.tags if all(tag in each.tags for each in notes)))


def _announce(series: Series, run: Run | None, status: str, message: str, code: int) -> None:
    first = series.runs[0] if run is None else run
    hooks = series.queue.settings.hooks
    where = str(series.folder if run is None else series.recording(run))
    notes = first.notes if run is not None else _in_common([each.notes for each in series.runs])
    tell(
        hooks_for(first.bench.settings) if hooks is None else hooks,
        Ending(where, status, message, int(code), notes.sample, notes.operator, notes.note, notes.tags),
    )
