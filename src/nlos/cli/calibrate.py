"""`nlos calibrate`: measures a bench's constants from recordings, says how good they are, draws every correction."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from datetime import UTC, datetime
from os.path import realpath
from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.importers.given import Given
from nlos.acquisition.recording.new_name import file_to_write
from nlos.bench_constants import folder_of, measured_later
from nlos.calibration.checked import response_checked
from nlos.calibration.constants import BenchConstants, Quantity, save
from nlos.calibration.errors import PoorCalibration
from nlos.calibration.geometry_fit import RULER_M
from nlos.calibration.measure import KnownBefore, measure_constants
from nlos.calibration.spots_sense import check_sense
from nlos.calibration_input import (
    common_bench,
    common_devices,
    load_run,
    read_spots,
    refuse_twice,
    refuse_unmeant_darkness,
)
from nlos.cli.calibration_lines import result_lines, warnings_of
from nlos.cli.contradictions import refuse_together
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.file_words import Detector
from nlos.cli.first_light import first_light as measured
from nlos.cli.progress import Progress, Stages
from nlos.cli.seconds import with_error
from nlos.cli.spots import place_scanner
from nlos.cli.targets import refuse_existing, refuse_own_input
from nlos.cli.terminal import terminal
from nlos.report.calibration_pictures import folder_of_pictures, pictures_of, refuse_to_replace
from nlos.writable import check_writable


def calibrate(
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="RUN...", help="Raw scans, and runs with the shutter closed.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="CONSTANTS.h5", help="Default: kept with the bench.")
    ] = None,
    dead_time_ns: Annotated[
        str | None,
        typer.Option(
            metavar="NS[+-ERROR]",
            help="Dead time of the detector, where no histogram over the laser's period shows it.",
        ),
    ] = None,
    response: Annotated[
        Path | None, typer.Option(metavar="FILE.h5", help="Impulse response; measured from the scan by default.")
    ] = None,
    spots: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Measured spots: columns x_deg, y_deg (commanded, optical), x_m, y_m."),
    ] = None,
    ruler_mm: Annotated[
        float | None,
        typer.Option(min=0.01, max=100.0, help="How well a spot's middle is read, one standard error. Default: 1."),
    ] = None,
    wall_size_m: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=100.0,
            help="Side of the wall, for files that do not store it; otherwise estimated from direct times.",
        ),
    ] = None,
    raw: Annotated[
        bool,
        typer.Option("--raw", help="Time 0 is not the wall: of files that do not say so, and count as rectified."),
    ] = False,
    detector: Detector = None,
    dark: Annotated[
        bool,
        typer.Option(
            "--dark", help="Runs without a wall in them were dark on purpose: the only one, or one of uneven bins."
        ),
    ] = False,
    first_light: Annotated[
        bool,
        typer.Option("--first-light", help="Before the first scan: delay, response, rates, window, from a few points."),
    ] = False,
    bench: Annotated[
        str | None, typer.Option(metavar="BENCH", help="Of --first-light. Default: the simulated bench.")
    ] = None,
    light: Annotated[bool, typer.Option("--light", help="Agree that --first-light opens the shutter.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Measures the bench's constants from recordings and says how good they are; --first-light what a bench file needs
    before there is a recording, written with `-o BENCH.yaml`."""
    of_runs = {
        "--dead-time-ns": dead_time_ns is not None, "--response": response is not None,
        "--wall-size-m": wall_size_m is not None, "--raw": raw, "--detector": detector is not None, "--dark": dark,
    }  # fmt: skip
    if ruler_mm is not None and spots is None:
        raise UsageError("--ruler-mm goes with --spots FILE: how well its places were read")
    ruler_m = RULER_M if ruler_mm is None else ruler_mm * 1e-3
    if first_light:
        refuse_together(
            "--first-light", {"RUN": bool(runs), **of_runs, "--spots": spots is not None},
            "it measures on the bench, before there is a recording", "Leave these out; they go with RUNs.",
        )  # fmt: skip
        measured(bench, light, output, overwrite)
        return
    if not runs and spots is not None:
        refuse_together(
            "--spots without a RUN", {**of_runs, "--light": light}, "tells the scanner's place from the spots alone",
            "Leave these out, or name a RUN.",
        )  # fmt: skip
        place_scanner(spots, ruler_m, bench, output, overwrite)
        return
    if not runs:
        raise UsageError("name a RUN to calibrate from, or use --first-light, or --spots FILE for the scanner's place")
    refuse_together(
        "RUN", {"--bench": bench is not None, "--light": light}, "a RUN names its bench itself, and needs no light",
        "Use them with --first-light.",
    )  # fmt: skip
    refuse_twice(runs, map(realpath, runs))
    if output is not None:
        _refuse_to_replace(output, [*runs, response, spots], overwrite)
    dead_time = None if dead_time_ns is None else with_error("--dead-time-ns", dead_time_ns)
    known = KnownBefore(
        None if dead_time is None else Quantity(dead_time[0] * 1e-9, dead_time[1] * 1e-9),
        None if response is None else response_checked(response),
        None if spots is None else read_spots(spots, ruler_m),
    )
    if known.spots is not None:
        check_sense(known.spots)
    wall_m = None if wall_size_m is None else (wall_size_m, wall_size_m)
    given = Given(wall_m, rectified=False if raw else None, detector=detector)
    _from_runs(runs, known, output, given=given, dark=dark, overwrite=overwrite)


def _from_runs(
    runs: list[Path],
    known: KnownBefore,
    output: Path | None,
    *,
    given: Given,
    dark: bool,
    overwrite: bool,
) -> None:
    measured_spots = known.spots
    loaded = []
    with Progress(len(runs), what="calibrate", unit="runs") as progress:
        for run in runs:
            progress.at(f"reading {run.name}")
            loaded.append(load_run(run, given))
            progress.step()
    refuse_twice(runs, [one.identity for one in loaded])
    devices = common_devices(runs, [one.devices for one in loaded])
    bench, facts = common_bench(runs, [one.bench_json for one in loaded])
    target = output or (folder_of(bench) if bench else Path("constants")) / f"{runs[0].stem}.h5"
    _refuse_to_replace(target, runs, overwrite)
    check_writable(file_to_write(target).absolute().parent)
    points = sum(len(one.raw.counts) for one in loaded)
    terminal.log(f"fitting the direct light of {points} points")
    with Stages("calibrate", "nlos.calibration"):
        found = measure_constants(
            [one.raw for one in loaded],
            devices=devices,
            sources=[str(run) for run in runs],
            measured_utc=datetime.now(UTC).isoformat(timespec="seconds"),
            aim=next((one.aim for one in loaded if one.aim is not None), None),
            known=replace(known, meant_dark=[dark or one.meant_dark for one in loaded]),
        )
    if found.raw is None and not dark:
        refuse_unmeant_darkness(runs, loaded)
    for line, values in result_lines(found, measured_spots):
        terminal.result(line, **values)
    said = warnings_of(found, measured_spots)
    for warning in said:
        terminal.log(f"warning: {warning}")
    terminal.document["warnings"] = said
    target.parent.mkdir(parents=True, exist_ok=True)
    with ExitStack() as together:  # constants and pictures are of one measurement, or there are neither
        with Stages("calibrate: drawing the corrections", "nlos.report"):
            drawn = pictures_of(found, folder_of_pictures(target), measured_spots)
            pictures = together.enter_context(drawn)
        poor = _poor(found.constants)
        if poor is None:
            save(replace(found.constants, bench=bench, bench_facts=facts), target, overwrite)
        elif target.exists():  # whose pictures those in the folder are
            raise poor
    for picture in pictures:
        terminal.result(str(picture))
    terminal.document["pictures"] = [str(picture) for picture in pictures]
    if poor is not None:
        raise poor
    kept = bench and target.parent.resolve() == folder_of(bench).resolve()
    whose = f"of bench {bench}, {_used_by(found.constants)}" if kept else "taken where --constants names it"
    terminal.result(f"{target}: {whose}", constants=str(target), bench=bench, kept_with_bench=bool(kept))
    if kept and (later := measured_later(folder_of(bench) / target.name, bench)) is not None:
        terminal.log(
            f"warning: {later} says that it was measured later and goes before these: this computer's clock was wrong "
            "then, or is now. Set it, and move that file away or calibrate once more"
        )


def _used_by(constants: "BenchConstants") -> str:
    """Who takes constants that are kept with their bench."""
    if constants.aims:
        return "taken from now on: `plan` and `scan` aim by them, `reconstruct` corrects by them"
    return (
        "taken from now on by `reconstruct`. `plan` and `scan` go on aiming by the bench file: constants without spots "
        "do not say where the beam lands (--spots FILE)"
    )


def _refuse_to_replace(target: Path, read: Sequence[Path | None], overwrite: bool) -> None:
    refuse_own_input(target, read, "a file that is calibrated from")
    refuse_existing(target, overwrite)
    refuse_to_replace(folder_of_pictures(target), overwrite)


def _poor(constants: "BenchConstants") -> Stopped | None:
    """What ends the command where the constants are not good enough to keep; what they are was printed before."""
    try:
        constants.check()
    except PoorCalibration as error:
        stopped = Stopped(ExitCode.DATA, f"nothing was saved: {error}")
        stopped.__cause__ = error
        return stopped
    return None
