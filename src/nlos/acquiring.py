"""`nlos.open_bench` and `nlos.scan`: the command line's benches and scans, from Python."""

import os
from collections.abc import Generator, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path

from nlos.acquisition.errors import PlanRefused, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.salvage import Resumed
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.alarms import AlarmSettings
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.cli.agreeing import agrees
from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import recording_target
from nlos.configs.load import load
from nlos.drivers import bench as table
from nlos.drivers.bench import Bench, BenchSettings
from nlos.drivers.errors import DeviceBusy, ShutterHeld
from nlos.drivers.exit_paths import undisturbed
from nlos.drivers.trip_latch import TripLatch
from nlos.live.looks import catch_up
from nlos.live.where_next import WhereNext
from nlos.python_words import said_in_python
from nlos.run_defaults import notes_for
from nlos.scan_ending import ScanEnding
from nlos.scan_preparation import PreparedScan, ScanRequest, prepare


@contextmanager
def open_bench(bench: str | Path = "simulated") -> Iterator[Bench]:
    """The bench of a YAML file, or of that name in `configs/bench`: mirror, counter and shutter, opened together.

    The light is shut first and the mirror parked on every way out. `bench.simulated` says whether there is any light at
    all. Raises `ConfigError` for what the file says and `DeviceError` for what is not there.
    """
    settings = load("bench", str(bench), BenchSettings).settings
    with table.open_bench(settings, latch=TripLatch.of_bench(settings), agree=agrees) as opened:
        yield opened


@said_in_python()
def scan(
    scan: str | Path | ScanPlan,
    bench: Bench,
    *,
    output: str | Path | None = None,
    resume: bool = False,
    constants: str | Path | None = None,
    no_shutter: bool = False,
    sample: str | None = None,
    operator: str | None = None,
    note: str | None = None,
    tags: Sequence[str] = (),
) -> Generator[Sample, None, None]:
    """Acquires: yields every sample as it is taken. `scan`: a YAML file, a name in `configs/scan`, or a `ScanPlan`.

    Everything is checked at once, before anything moves (`SafetyTrip`, `LimitError`, `PlanRefused`, `StorageError`);
    the light is on only between the first and the last sample that are asked for. `output`: also writes the recording,
    with all that happens, each sample before it is yielded; `resume`: only what is missing there. `constants`: what
    `nlos calibrate` measured, to aim by; default: the bench's newest; "none": none. A bench without a shutter needs
    `no_shutter=True`. `sample`, `operator`, `note`, `tags`: kept in the recording; defaults are the bench's, then one's
    own. Raises `DeviceError` with the shutter closed, `DeviceBusy` while another scan of this bench is under way,
    `ShutterHeld` after a signal whose handler in this program went on.
    """
    _check_free(bench)
    _check_notes(tags, sample=sample, operator=operator, note=note)
    if bench.settings.shutter.model == "none" and not no_shutter:
        raise PlanRefused(
            "this bench has no shutter, so nothing here can shut off the light. Pass no_shutter=True if something else "
            "does."
        )
    if isinstance(scan, ScanPlan):
        plan, alarms, header = scan, AlarmSettings(), Header()
    else:
        wanted = load("scan", str(scan), ScanSettings)
        plan, alarms = wanted.settings.plan(), wanted.settings.alarms
        header = Header(scan_text=wanted.text, scan_json=wanted.settings.model_dump_json())
    notes = notes_for(bench.settings, sample, operator, note, tags)
    header = replace(header, bench_json=bench.settings.model_dump_json(), notes=notes)
    target = None if output is None else _checked_target(Path(output), resume)
    aimed_by = None if constants is None else Path(constants)
    prepared = prepare(ScanRequest(plan, alarms, header, target, resume, constants=aimed_by), bench)
    prepared.alarms.wait_for_rates(bench)
    if target is None:
        return _alone(bench, _advised(prepared, Resumed(None, {}, 0.0), ScanControl(), _adviser(prepared)))
    return _alone(bench, _recorded(prepared))


def _check_free(bench: Bench) -> None:
    """Raises `TypeError` for what is no open bench, `BenchClosed` for one that was, and `DeviceBusy` where a scan of it
    is under way."""
    if not isinstance(bench, Bench):
        raise TypeError(
            f"{bench!r} is no open bench. Open it: with nlos.open_bench(...) as bench: nlos.scan(..., bench)"
        )
    bench.check_open()
    if bench.scanning.locked():
        raise _busy(bench)


def _check_notes(tags: object, **texts: object) -> None:
    """Raises `TypeError` for what is no text, and for a word in the place of a list of words: its letters are none."""
    for name, text in texts.items():
        if not isinstance(text, str | None):
            raise TypeError(f"{name}={text!r}: text is expected, as {name}={str(text)!r}.")
    if not (isinstance(tags, Sequence) and not isinstance(tags, str) and all(isinstance(tag, str) for tag in tags)):
        raise TypeError(f"tags={tags!r}: a list of words is expected, as tags=['night'].")


def _busy(bench: Bench) -> DeviceBusy:
    return DeviceBusy(
        "bench",
        f"{bench.settings.name} is scanning already.",
        "End that scan first: its loop, or close() of its samples.",
    )


def _alone(bench: Bench, samples: Generator[Sample, None, None]) -> Generator[Sample, None, None]:
    """The samples, while no other scan speaks to the same instruments."""
    with closing(samples):
        if not bench.scanning.acquire(blocking=False):
            raise _busy(bench)
        try:
            yield from samples
        finally:
            samples.close()
            bench.scanning.release()


def _checked_target(path: Path, resume: bool) -> Path:
    """Raises `StorageError` for a name or a place that cannot be written, and for a file that would be lost."""
    try:
        recording_target(path)
    except UsageError as error:
        raise StorageError(str(error)) from None
    if os.path.lexists(path) and not resume:  # a link to nothing, too
        raise StorageError(f"{path}: exists. Choose another name, or pass resume=True.")
    path.absolute().parent.mkdir(exist_ok=True)
    return path


def _adviser(prepared: PreparedScan) -> WhereNext | None:
    """Of candidates, by the light alone: nobody makes pictures here."""
    asked = prepared.request
    if asked.plan.budget is None or not asked.plan.positions.on_grid:
        return None
    adviser = WhereNext(asked.plan)
    if asked.resume and asked.target is not None and asked.target.exists():
        catch_up(adviser.add, asked.target)
    return adviser


def _advised(
    prepared: PreparedScan, begun: Resumed, control: ScanControl, adviser: WhereNext | None
) -> Generator[Sample, None, None]:
    """What is missing, each sample told to the adviser before it is handed on. The command line's own handlers end
    its scans; here a signal's handler may be anybody's, so that the shutter itself tells the scan of it."""
    shutter = prepared.bench.shutter
    shutter.when_held = control.interrupt
    try:
        with closing(prepared.samples(begun, control, adviser=adviser)) as samples:
            for sample in samples:
                if adviser is not None:
                    adviser.add(sample)
                yield sample
    finally:
        shutter.when_held = lambda why: None
    if control.state is ScanState.ENDED and (signal := shutter.is_held()):
        raise ShutterHeld(
            "shutter",
            f"{signal} shut the light off, and this program's own handler of it went on: the scan ends here.",
            "A handler that is to leave light alone is set once the bench is open.",
        )


def _recorded(prepared: PreparedScan) -> Generator[Sample, None, None]:
    """The samples, each in the recording before it is handed on."""
    bench, control, adviser = prepared.bench, ScanControl(), _adviser(prepared)
    with ExitStack() as stack:
        with undisturbed():  # a recording that is begun is ended, whenever a signal comes
            begun = prepared.begin()
            writer = begun.writer
            if writer is None:
                return
            stack.enter_context(ScanEnding(bench, writer, control, "resume=True"))
        start_s = bench.clock.now() - begun.elapsed_s
        bench.on_event = lambda kind, text: writer.log(kind, text, bench.clock.now() - start_s)
        with closing(_advised(prepared, begun, control, adviser)) as samples:
            for sample in samples:
                writer.write(sample)
                yield sample
