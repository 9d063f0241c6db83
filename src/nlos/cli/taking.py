"""One scan of the command line, from its settings to its recording and picture, whoever asks for it."""

import os
from collections.abc import Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.planning.preflight import aim_of, refitted
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.ended_as_asked import AS_ASKED
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.run_notes import NO_NOTES, RunNotes
from nlos.acquisition.recording.salvage import settle
from nlos.acquisition.scanning.control import ScanControl
from nlos.chain import reconstruct_file
from nlos.cli.benches import opened
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.interrupts import Interrupts, end_in_order_at_sigterm
from nlos.cli.picture_beside import picture_beside, picture_kept
from nlos.cli.progress import Progress
from nlos.cli.taken import Taken, listen, say_complete, say_ended, say_nothing_left
from nlos.cli.targets import recording_target, refuse_own_input
from nlos.cli.terminal import terminal
from nlos.configs.load import Loaded
from nlos.drivers.bench import Bench, BenchSettings
from nlos.drivers.errors import SafetyTrip
from nlos.drivers.exit_paths import undisturbed
from nlos.live.goal import Goal
from nlos.live.good_enough import Enough
from nlos.live.looks import Looks, catch_up
from nlos.live.looks_before import ended_before
from nlos.live.process import methods_for, pages_can_be, start_live
from nlos.live.so_far import new_scan
from nlos.live.where_next import WhereNext
from nlos.recipe import Recipe
from nlos.recon.explained_share import NOT_LOOKED_FOR
from nlos.recon.results import files_in
from nlos.recon.volume import response_words
from nlos.response import response_wanted
from nlos.results_folder import ResultsFolder
from nlos.scan_ending import ScanEnding
from nlos.scan_preparation import PreparedScan, ScanRequest, prepare
from nlos.time_left import TimeLeft

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.recording.writer import RecordingWriter
    from nlos.loaded import LoadedScan


@dataclass(frozen=True)
class ScanOptions:
    """What is asked of one scan beside scan and bench file."""

    notes: RunNotes = NO_NOTES
    method: str | None = None
    """Reconstructed by at the end; also what is watched by."""
    seeing: Mapping[str, object] = field(default_factory=dict)
    """The method's settings."""
    resume: bool = False
    scene: Path | None = None
    constants: Path | None = None
    live: bool = False
    until: Goal | None = None
    """The scan ends, or its second pass begins, once the picture is that good."""
    overwrite: bool = False
    response: str = "auto"
    """Of the instrument, as `--response` says it."""


def require_shutter(table: Loaded[BenchSettings], no_shutter: bool) -> None:
    """Raises `UsageError` for a bench without a shutter, unless somebody agreed."""
    if table.settings.shutter.model == "none" and not no_shutter:
        raise UsageError(
            f"{table.path}: this bench has no shutter, so nothing here can shut off the light. "
            "Use --no-shutter if something else does."
        )


def take(wanted: Loaded[ScanSettings], table: Loaded[BenchSettings], target: Path, options: ScanOptions) -> None:
    """One scan, from its settings to its recording and picture. Raises `Stopped`, and what any of it raises."""
    plan, resume, overwrite = wanted.settings.plan(), options.resume, options.overwrite
    recording_target(target)
    refuse_own_input(target, [options.scene], "the recorded scan whose light is replayed")
    refuse_own_input(target, [options.constants], "the file of the constants")
    if resume and _nothing_is_left(target, plan, options):  # no device is even opened
        if options.method is not None and not picture_kept(target, options.method):
            _reconstruct(target, _recipe(options.method, options), overwrite)
        return
    if os.path.lexists(target) and not (overwrite or resume):  # a link to nothing, too
        raise FileExistsError(f"{target}: exists. Choose another name with -o, or use --resume or --overwrite.")
    if options.method is not None:
        remedy = "Move it away" if resume else "Choose another name with -o, use --overwrite"
        picture_beside(target, overwrite, f"{remedy}, or leave --reconstruct out.")
    header = Header(
        scan_text=wanted.text,
        scan_json=wanted.settings.model_dump_json(),
        bench_text=table.text,
        bench_json=table.settings.model_dump_json(),
        notes=options.notes,
    )
    target.parent.mkdir(exist_ok=True)
    watching = _Watching(
        options.method, dict(options.seeing), options.live, options.until, options.response, options.constants
    )
    request = ScanRequest(plan, wanted.settings.alarms, header, target, resume, overwrite, options.constants)
    end_in_order_at_sigterm()
    with Interrupts().caught() as interrupts, ExitStack() as shown:  # left once the bench is closed
        with opened(table, options.scene) as open_bench:
            taken = _acquire(request, open_bench, interrupts, watching, shown)
        # Where nothing was left once the bench was open, another program has taken the rest meanwhile.
        taken.tell(shown) if taken is not None else say_complete(target)
    if options.method is not None:
        _reconstruct(target, _recipe(options.method, options), overwrite)


def _nothing_is_left(target: Path, plan: "ScanPlan", options: ScanOptions) -> bool:
    """Whether the recording holds all that is asked for, which is said then."""
    if settle(target, plan):
        say_complete(target)
        return True
    if options.until is None:
        return False
    seen = ended_before(target, plan, options.until, methods_for(options.method)[-1])
    if seen is not None:
        say_nothing_left(target, seen.said)
    return seen is not None


@dataclass(frozen=True)
class _Watching:
    """Who looks on: the method and all that it is told, whether on a page, and when the scan may end."""

    method: str | None
    settings: dict[str, object]
    live: bool
    until: Goal | None
    response: str
    constants: Path | None

    def enough(self, scan: PreparedScan) -> Enough | None:
        """Decides when the picture is good enough. It reads what is there, so it is made before the file is opened."""
        if self.until is None:
            return None
        asked, bench = scan.request, scan.bench
        assert asked.target is not None
        enough = Enough(
            asked.plan, self._nothing_yet(scan), self.until, self._recipe, bench.report, self._watched(scan)
        )
        if asked.resume and asked.target.exists():
            enough.catch_up(asked.target)
        return enough

    def adviser(self, scan: PreparedScan) -> WhereNext | None:
        """Says which candidates come next, where the plan has any. Made before the file is opened, as `enough` is."""
        asked, bench = scan.request, scan.bench
        if asked.plan.budget is None or not asked.plan.positions.on_grid:
            return None
        assert asked.target is not None
        watched = self._watched(scan)
        looks = Looks(asked.plan, self._nothing_yet(scan), self._recipe, bench.report) if watched is None else None
        adviser = WhereNext(asked.plan, looks, watched)
        if asked.resume and asked.target.exists():
            catch_up(adviser.add, asked.target)
        return adviser

    def _nothing_yet(self, scan: PreparedScan) -> "LoadedScan":
        devices = {role: f"{who.model} {who.serial}".strip() for role, who in scan.header.devices.items()}
        return new_scan(scan.request.plan, devices, scan.header.bench_json)

    @property
    def _recipe(self) -> Recipe:
        return Recipe(methods_for(self.method)[-1], self.settings, self.constants, response_wanted(self.response))

    @staticmethod
    def _watched(scan: PreparedScan) -> Path | None:
        """The recording whose live process makes pictures; None on a simulated bench, whose clock waits for them."""
        return None if scan.bench.settings.simulated else scan.request.target

    def show(self, scan: PreparedScan, enough: Enough | None, control: ScanControl) -> None:
        """Starts the page, where one is asked for or the picture is judged while light is on. Of a scan that is resumed
        the pictures are awaited that say whether more light is needed."""
        assert scan.request.target is not None
        judged = self.until is not None or (scan.request.plan.budget is not None and pages_can_be())
        if not (self.live or (judged and not scan.bench.settings.simulated)):
            return
        before = 0 if enough is None else enough.before
        page = start_live(
            scan.request.target, self.method, self.settings.get("weights"), self.response, self.constants, before
        )
        if enough is not None and before:
            terminal.log("the pictures so far are made again in the dark, to be compared with")
            if not enough.wait_in_the_dark(lambda: page.poll() is None and not control.wanted) and not control.wanted:
                terminal.log("warning: they did not come; the scan may take a quarter more points than it needs")


def _acquire(
    request: ScanRequest, bench: Bench, interrupts: Interrupts, watching: _Watching, shown: ExitStack
) -> Taken | None:
    """Checks, then scans into the target. Whatever happens, the shutter is closed before the recording is. None where
    nothing was left to take."""

    prepared = prepare(request, bench)
    plan = prepared.request.plan
    for warning in filter(None, (refitted(request.plan.axis, plan.axis), *prepared.warnings)):
        terminal.log(f"warning: {warning}")
    if prepared.constants is not None:
        terminal.log(prepared.constants.said(aim_of(bench)))
        if prepared.constants.warning:
            terminal.log(f"warning: {prepared.constants.warning}")
    until = "until stopped, at most " if plan.until_stopped else ""
    expected = f"{until}{prepared.choice.forecast.total_s:.1f} s{'' if until else ' expected'}"
    terminal.log(f"scheme {prepared.choice.scheme.words}, {expected}; {prepared.choice.why}")
    prepared.alarms.wait_for_rates(bench)
    enough, adviser = watching.enough(prepared), watching.adviser(prepared)
    ending: ScanEnding | None = None
    try:
        with ExitStack() as stack:
            with undisturbed():  # a recording that is begun is ended, whenever a signal comes
                begun = prepared.begin()
                writer = begun.writer
                if begun.kept is not None:
                    terminal.log(f"warning: {_kept_words(begun.kept, len(begun.taken))}")
                if writer is None:
                    return None
                progress = Progress(None if plan.until_stopped else plan.most_samples, len(begun.taken))
                time_left = TimeLeft(plan, begun.taken, begun.elapsed_s)
                control = ScanControl(lambda why: _ask(interrupts, progress, writer, why))
                shown.push(progress)
                start_s = bench.clock.now() - begun.elapsed_s  # a signal that waited comes where this block ends
                ending = stack.enter_context(ScanEnding(bench, writer, control, "--resume", terminal.log))
            interrupts.pauses(control, bench.settings.shutter_on != "nothing")
            watching.show(prepared, enough, control)
            start_s = bench.clock.now() - begun.elapsed_s  # the dark before it is no part of the scan
            progress.show()
            samples = prepared.samples(begun, control, enough, adviser, () if enough is None else enough.decided)
            listen(bench, writer, start_s)
            with closing(samples):
                for sample in samples:
                    writer.write(sample)
                    progress.step(times_as_long=time_left.times_as_long(sample))
                    if enough is not None:
                        enough.add(sample)
                    if adviser is not None:
                        adviser.add(sample)
    except SafetyTrip as error:
        if ending is None:  # before the recording was begun
            raise
        raise Stopped(ExitCode.ALARM, str(error)) from error
    except (KeyboardInterrupt, SystemExit) as error:
        if ending is None:
            raise
        if not (ending.film_is_whole and isinstance(error, KeyboardInterrupt)):
            say_ended(request, ending)
            raise
    assert writer is not None
    assert ending is not None
    duration_s = bench.clock.now() - start_s - begun.away_s
    as_asked = not ending.complete and enough is not None and enough.reached and not interrupts.seen
    status = AS_ASKED if as_asked else "complete" if ending.complete else "interrupted"
    seen, reached = ("", False) if enough is None else (enough.said, enough.reached)
    return Taken(prepared, ending, writer.acknowledged, len(begun.taken), duration_s, status, seen, reached)


def _kept_words(kept: Path, taken: int) -> str:
    """What became of a recording that is resumed without some of it."""
    if taken:
        return f"some of its points are damaged and are taken again; the recording as it was is kept as {kept}"
    return f"what lay there cannot be read as a recording, so the scan begins anew; it is kept as {kept}"


def _ask(interrupts: Interrupts, progress: Progress, writer: "RecordingWriter", why: str) -> bool:
    writer.flush()  # whoever is asked may come back tomorrow
    progress.hide()
    going = interrupts.ask(why, writer.has_all)
    if going:
        progress.show()
    return going


def _recipe(method: str, options: ScanOptions) -> Recipe:
    return Recipe(method, options.seeing, options.constants, response_wanted(options.response))


def _reconstruct(run: Path, recipe: Recipe, overwrite: bool) -> None:
    """The picture of a scan that has just ended. Raises `Stopped`: whatever fails here, the scan is safe."""
    folder = run.with_suffix("")
    done = reconstruct_file(run, recipe, ResultsFolder(folder, overwrite=overwrite))
    terminal.result(f"{folder}: {', '.join(files_in(folder))} ({recipe.method}, {done.seconds:.2f} s)")
    terminal.log(f"response: {response_words(done)}")
    explained = done.explained or NOT_LOOKED_FOR
    terminal.log(f"{folder}: {explained}{explained.remark}", -1 if explained.nothing or explained.doubt else 0)
    terminal.document["reconstruction"] = {
        "folder": str(folder), "method": recipe.method, "seconds": done.seconds, "files": files_in(folder),
        "explained": explained.share, "explained_error": explained.error, "explained_note": explained.note,
        "explained_doubt": explained.doubt, "response": response_words(done),
    }  # fmt: skip
