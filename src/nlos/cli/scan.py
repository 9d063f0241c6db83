"""`nlos scan`: acquires a plan on a bench into a recording that nothing can take away."""

import json
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.cli.benches import load_bench, measured_constants, opened
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.interrupts import Interrupts
from nlos.cli.method_settings import Weights, chosen_method
from nlos.cli.progress import Progress
from nlos.cli.scan_ending import ScanEnding
from nlos.cli.targets import recording_target
from nlos.cli.terminal import terminal
from nlos.live.good_enough import Enough, parse_until
from nlos.live.process import methods_for, start_live

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.recording.provenance import Header
    from nlos.acquisition.recording.salvage import Resumed
    from nlos.acquisition.scanning.alarms import AlarmSettings
    from nlos.acquisition.scanning.lag import Lag
    from nlos.drivers.bench import Bench


def scan(
    scan: Annotated[str, typer.Argument(metavar="SCAN", help="A YAML file, or the name of one in configs/scan.")],
    bench: Annotated[str | None, typer.Option(metavar="BENCH", help="Default: the simulated bench.")] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="RUN.h5")] = None,
    reconstruct: Annotated[str | None, typer.Option(metavar="METHOD", help="Method name; see `nlos methods`.")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Acquire only what is missing.")] = False,
    scene: Annotated[
        Path | None, typer.Option(metavar="RUN.h5", help="Replay a recorded scan as the simulated bench's light.")
    ] = None,
    constants: Annotated[
        Path | None,
        typer.Option(metavar="CONSTANTS.h5", help="Constants to aim by. Default: the newest in constants/ that fits."),
    ] = None,
    no_shutter: Annotated[bool, typer.Option("--no-shutter", help="Allow a bench without a shutter.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Show the scan on a read-only page, served by a separate process.")
    ] = False,
    until: Annotated[
        str | None,
        typer.Option(
            metavar="stable[:LEVEL]",
            help="Stop (or start the second pass) once the picture changes and errs by less than LEVEL.",
        ),
    ] = None,
    weights: Weights = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Acquires. Ctrl-C closes the shutter and pauses; Enter goes on, a second Ctrl-C ends the scan cleanly."""
    from nlos.acquisition.planning.scan_settings import ScanSettings
    from nlos.acquisition.recording.provenance import Header
    from nlos.acquisition.recording.salvage import settle
    from nlos.configs.load import load

    wanted, table = load("scan", scan, ScanSettings), load_bench(bench)
    if table.settings.shutter.model == "none" and not no_shutter:
        raise UsageError(
            f"{table.path}: this bench has no shutter, so nothing here can shut off the light. "
            "Say --no-shutter if something else does."
        )
    seeing: dict[str, object] = {}
    if weights is not None:
        reconstruct, seeing = chosen_method(weights, reconstruct, {})
    if reconstruct is not None:
        from nlos.recon.methods import find

        find(reconstruct)
    level = None if until is None else parse_until(until)
    if live or level is not None:
        methods_for(reconstruct)
    plan = wanted.settings.plan()
    target = output or Path(f"{wanted.path.stem}-{datetime.now(UTC):%Y%m%d-%H%M%S}.h5")
    recording_target(target)
    if resume and settle(target, plan):  # no device is even opened
        terminal.result(f"{target}: is complete, nothing was left to take", recording=str(target), taken=0)
        return
    if target.exists() and not (overwrite or resume):
        raise FileExistsError(f"{target}: exists. Choose another name with -o, or say --resume or --overwrite.")
    header = Header(
        scan_text=wanted.text,
        scan_json=wanted.settings.model_dump_json(),
        bench_text=table.text,
        bench_json=table.settings.model_dump_json(),
    )
    target.parent.mkdir(exist_ok=True)
    with Interrupts().caught() as interrupts, opened(table, scene) as open_bench:
        _acquire(
            plan, header, open_bench, target, resume, overwrite, interrupts, wanted.settings.alarms,
            reconstruct, seeing, live, level, constants,
        )  # fmt: skip
    if reconstruct is not None:
        _reconstruct(target, reconstruct, seeing, overwrite)


def _acquire(
    plan: "ScanPlan",
    header: "Header",
    bench: "Bench",
    target: Path,
    resume: bool,
    overwrite: bool,
    interrupts: Interrupts,
    alarms: "AlarmSettings",
    watched_by: str | None,
    seeing: dict[str, object],
    live: bool,
    level: float | None,
    constants: Path | None,
) -> None:
    """Checks, then scans into `target`. Whatever happens, the shutter is closed before the recording is."""
    from dataclasses import replace

    from nlos.acquisition.planning.preflight import aim_of, check_disk, checked_angles
    from nlos.acquisition.planning.schemes import choose
    from nlos.acquisition.scanning.alarms import Alarms
    from nlos.acquisition.scanning.control import ScanControl
    from nlos.acquisition.scanning.engine import scan as run
    from nlos.drivers.exit_paths import undisturbed

    bench.shutter.check_trip()
    roles = {"mirror": bench.mirror.identity, "counter": bench.counter.identity}
    known = measured_constants(constants, roles)
    aim = known.geometry if known is not None and known.geometry is not None else aim_of(bench)
    lag = _known_lag(target) if resume and plan.within_px is not None else None
    choice = choose(plan, bench, checked_angles(plan, bench, aim), lag=lag)
    forecast_s = choice.forecast.total_s
    terminal.log(f"scheme {choice.scheme.value}, {forecast_s:.1f} s expected; {choice.why}")
    check_disk(plan, target, round(alarms.min_free_mb * 1e6))
    watch = Alarms(alarms, bench.settings.laser.repetition_hz, target.parent)
    watch.wait_for_rates(bench)
    used = "{}" if known is None else json.dumps(known.summary(), default=str)
    header = replace(header, devices=roles, warnings=tuple(bench.warnings), constants_json=used).stamped()
    enough = None
    if level is not None:  # it reads what is there, so before the file is opened for writing
        enough = Enough(
            target, plan, {role: f"{who.model} {who.serial}".strip() for role, who in roles.items()}, level,
            methods_for(watched_by)[-1], bench.report, watched=not bench.settings.simulated, resumed=resume,
            settings=seeing,
        )  # fmt: skip
    with ExitStack() as stack:
        with undisturbed():  # a recording that is begun is ended, whenever a signal comes
            begun = _begin(target, plan, header, resume, overwrite)
            writer = begun.writer
            if writer is None:
                return
            progress = Progress(len(plan), len(begun.taken))
            control = ScanControl(lambda why: _ask(interrupts, progress, why))
            ending = stack.enter_context(ScanEnding(bench, writer, control))
        interrupts.pauses(control)
        if live or (level is not None and not bench.settings.simulated):
            start_live(target, watched_by, seeing.get("weights"))
        start_s = bench.clock.now() - begun.elapsed_s
        stack.enter_context(progress)
        samples = run(
            plan, bench, aim=aim, taken=begun.taken, control=control, alarms=watch, decide=enough,
            elapsed_s=begun.elapsed_s, lag=lag,
        )  # fmt: skip
        bench.on_event = lambda kind, text: writer.log(kind, text, bench.clock.now() - start_s)
        with closing(samples):
            for sample in samples:
                writer.write(sample)
                progress.step()
                if enough is not None:
                    enough.add(sample)
    duration_s = bench.clock.now() - start_s
    terminal.result(
        f"{target}: {writer.acknowledged} of {len(plan)} points in {duration_s:.1f} s of bench time "
        f"({forecast_s:.1f} s predicted)",
        recording=str(target), taken=writer.acknowledged - len(begun.taken), points=writer.acknowledged,
        planned=len(plan), bench_s=duration_s, predicted_s=forecast_s,
        scheme=choice.scheme.value, status="complete" if ending.complete else "interrupted",
    )  # fmt: skip
    if not ending.complete and (interrupts.seen or enough is None or not enough.reached):
        raise Stopped(ExitCode.INTERRUPTED, f"ended by Ctrl-C. {ending.safe}")


def _begin(target: Path, plan: "ScanPlan", header: "Header", resume: bool, overwrite: bool) -> "Resumed":
    from nlos.acquisition.recording.salvage import Resumed
    from nlos.acquisition.recording.salvage import resume as go_on
    from nlos.acquisition.recording.writer import RecordingWriter

    if resume:
        return go_on(target, plan, header)
    return Resumed(RecordingWriter.create(target, plan, header, overwrite=overwrite), {}, 0.0)


def _known_lag(target: Path) -> "Lag | None":
    """What a recording that is resumed was swept by; its lines go on by the same."""
    from nlos.acquisition.errors import InvalidData
    from nlos.acquisition.recording.recording import Recording
    from nlos.acquisition.scanning.lag import Lag

    if not target.exists():
        return None
    try:
        with Recording.open(target) as recording:
            said = [event.text for event in recording.events() if event.kind == "lag"]
            return Lag.of_text(said[0]) if said else None
    except InvalidData:
        return None


def _ask(interrupts: Interrupts, progress: Progress, why: str) -> bool:
    progress.hide()
    going = interrupts.ask(why)
    if going:
        progress.show()
    return going


def _reconstruct(run: Path, method: str, settings: dict[str, object], overwrite: bool) -> None:
    """The picture of a scan that has just ended. Raises `Stopped`: whatever fails here, the scan is safe."""
    from nlos.chain import reconstruct_file
    from nlos.recon.results import files_in

    folder = run.with_suffix("")
    done = reconstruct_file(run, method, settings, folder, overwrite=overwrite)
    terminal.result(f"{folder}: {', '.join(files_in(folder))} ({method}, {done.seconds:.2f} s)")
    terminal.document["reconstruction"] = {
        "folder": str(folder), "method": method, "seconds": done.seconds, "files": files_in(folder),
    }  # fmt: skip
