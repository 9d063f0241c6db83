"""`nlos calibrate`: measures a bench's constants from recordings, says how good they are, draws every correction."""

from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from nlos.bench_constants import folder_of
from nlos.calibration.checked import response_checked
from nlos.calibration.constants import BenchConstants, Quantity, save
from nlos.calibration.errors import PoorCalibration
from nlos.calibration.measure import Measurement, measure_constants
from nlos.calibration.spots_fit import poorly_determined
from nlos.calibration.spots_sense import check_sense
from nlos.calibration_input import common_bench, common_devices, load_run, read_spots, refuse_unmeant_darkness
from nlos.cli.contradictions import refuse_together
from nlos.cli.exit_codes import ExitCode, Stopped, UsageError
from nlos.cli.first_light import first_light as measured
from nlos.cli.progress import Progress
from nlos.cli.spots import fitted_lines, place_scanner, undetermined_line
from nlos.cli.terminal import terminal
from nlos.report.calibration_pictures import write_pictures
from nlos.report.spots_picture import spots_picture

MM_PER_PS = 0.299792458 / 2
"""Depth of a picosecond there and back."""


def calibrate(
    runs: Annotated[
        list[Path] | None, typer.Argument(metavar="RUN...", help="Raw scans, and runs with the shutter closed.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="CONSTANTS.h5", help="Default: kept with the bench.")
    ] = None,
    dead_time_ns: Annotated[
        float | None,
        typer.Option(min=0, help="Dead time of the detector, where no histogram over the whole laser period shows it."),
    ] = None,
    response: Annotated[
        Path | None, typer.Option(metavar="FILE.h5", help="Impulse response; measured from the scan by default.")
    ] = None,
    spots: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Measured spots: columns x_deg, y_deg (commanded, optical), x_m, y_m."),
    ] = None,
    wall_size_m: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=100.0,
            help="Side of the wall, for files that do not store it; otherwise estimated from direct times.",
        ),
    ] = None,
    dark: Annotated[
        bool, typer.Option("--dark", help="These runs were meant to be dark, even if there is only one.")
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
        "--wall-size-m": wall_size_m is not None, "--dark": dark,
    }  # fmt: skip
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
        place_scanner(spots, bench, output, overwrite)
        return
    if not runs:
        raise UsageError("name a RUN to calibrate from, or use --first-light, or --spots FILE for the scanner's place")
    refuse_together(
        "RUN", {"--bench": bench is not None, "--light": light}, "a RUN names its bench itself, and needs no light",
        "Use them with --first-light.",
    )  # fmt: skip
    _from_runs(runs, output, dead_time_ns, response, spots, wall_size_m, dark, overwrite)


def _from_runs(
    runs: list[Path],
    output: Path | None,
    dead_time_ns: float | None,
    response: Path | None,
    spots: Path | None,
    wall_size_m: float | None,
    dark: bool,
    overwrite: bool,
) -> None:
    if output is not None:
        _refuse_to_replace(output, overwrite)
    loaded = []
    with Progress(len(runs), what="calibrate", unit="runs") as progress:
        for run in runs:
            progress.at(f"reading {run.name}")
            loaded.append(load_run(run, wall_size_m))
            progress.step()
    devices = common_devices(runs, [one.devices for one in loaded])
    bench, facts = common_bench(runs, [one.bench_json for one in loaded])
    target = output or (folder_of(bench) if bench else Path("constants")) / f"{runs[0].stem}.h5"
    _refuse_to_replace(target, overwrite)
    measured_spots = None if spots is None else read_spots(spots)
    if measured_spots is not None:
        check_sense(measured_spots)
    found = measure_constants(
        [one.raw for one in loaded],
        devices=devices,
        sources=[str(run) for run in runs],
        measured_utc=datetime.now(UTC).isoformat(timespec="seconds"),
        aim=next((one.aim for one in loaded if one.aim is not None), None),
        dead_time=None if dead_time_ns is None else Quantity(dead_time_ns * 1e-9, 0.0),
        response=None if response is None else response_checked(response),
        spots=measured_spots,
    )
    if found.raw is None and not dark:
        refuse_unmeant_darkness(runs, loaded)
    for line, values in _lines(found):
        terminal.result(line, **values)
    target.parent.mkdir(parents=True, exist_ok=True)
    pictures = write_pictures(found, target.with_suffix(""))
    if measured_spots is not None and found.geometry is not None and found.raw is not None:
        pictures.append(target.with_suffix("") / "spots.png")
        spots_picture(pictures[-1], found.geometry, measured_spots, (found.raw.x_m, found.raw.y_m))
    for picture in pictures:
        terminal.result(str(picture))
    terminal.document["pictures"] = [str(picture) for picture in pictures]
    _refuse_poor(found.constants)
    save(replace(found.constants, bench=bench, bench_facts=facts), target, overwrite)
    kept = bench and target.parent.resolve() == folder_of(bench).resolve()
    whose = f"of bench {bench}, taken from now on" if kept else "taken where --constants names it"
    terminal.result(f"{target}: {whose}", constants=str(target), bench=bench, kept_with_bench=bool(kept))


def _refuse_to_replace(target: Path, overwrite: bool) -> None:
    if target.exists() and not overwrite:
        raise FileExistsError(f"{target}: exists. Choose another name with -o, or use --overwrite.")


def _refuse_poor(constants: "BenchConstants") -> None:
    """Ends the command when the constants are not good enough to keep; what they are was printed before."""
    try:
        constants.check()
    except PoorCalibration as error:
        raise Stopped(ExitCode.DATA, f"nothing was saved: {error}") from error


def _lines(found: "Measurement") -> "list[tuple[str, dict[str, object]]]":
    """What is printed, each line with its part of the JSON document."""
    constants, lines = found.constants, []
    if found.corrected is not None:
        report = found.corrected.report()
        lines += _timing_lines(report, constants)
    else:
        lines.append(("no laser light in these runs: taken as runs with the shutter closed", {}))
    if found.geometry is not None:
        lines += _geometry_lines(found)
    for name, unit, scale in (
        ("dark_hz", "clicks/s with the shutter closed (dark counts and room light)", 1.0),
        ("ambient_hz", "clicks/s more between the pulses of a scan", 1.0),
        ("dead_time_s", "ns dead time", 1e9),
        ("afterpulse_probability", "% afterpulses", 100.0),
    ):
        quantity = getattr(constants, name)
        if quantity is not None:
            text = f"{quantity.value * scale:.2f} +- {quantity.error * scale:.2f} {unit}"
            lines.append((text, {name: quantity.value, f"{name}_error": quantity.error}))
    return lines


def _timing_lines(report: Mapping[str, object], constants: "BenchConstants") -> "list[tuple[str, dict[str, object]]]":
    rms_ps = report["offset_rms_ps"]
    assert isinstance(rms_ps, float)
    assert constants.arrivals is not None
    position, error = constants.arrivals.scanner_position_m, constants.arrivals.covariance.diagonal() ** 0.5
    delay_ns, delay_error_ns = constants.arrivals.delay_s * 1e9, error[3] * 1e9
    return [
        (
            f"time offsets: {rms_ps:.2f} ps = {rms_ps * MM_PER_PS:.3f} mm RMS about the wall's fit "
            f"({report['offset_rms_bins']:.3f} bins; {report['points_off_the_wall_fit']} of {report['points']} points "
            f"off the fit, {report['points_without_direct_peak']} without a direct peak)",
            {key: report[key] for key in report if key.startswith(("offset", "points"))},
        ),
        (
            f"scanner at {position[0]:+.4f}, {position[1]:+.4f}, {position[2]:.4f} m of the wall's centre "
            f"(+- {error[0] * 1e3:.1f}, {error[1] * 1e3:.1f}, {error[2] * 1e3:.1f} mm), "
            f"delay {delay_ns:.4f} +- {delay_error_ns:.4f} ns",
            {
                "scanner_position_m": position.tolist(), "scanner_position_error_m": error[:3].tolist(),
                "electronic_delay_ns": delay_ns, "electronic_delay_error_ns": delay_error_ns,
            },
        ),
        (
            f"impulse response {report['response_fwhm_ps']:.0f} ps FWHM; direct light masked for "
            f"{report['direct_masked_ns']:.2f} ns, its tail decays in {report['direct_tail_ps']:.0f} ps",
            {key: report[key] for key in ("response_fwhm_ps", "direct_masked_ns", "direct_tail_ps")},
        ),
    ]  # fmt: skip


def _geometry_lines(found: "Measurement") -> "list[tuple[str, dict[str, object]]]":
    fit = found.geometry
    assert fit is not None
    height_mm = fit.height_m[fit.accepted] * 1e3
    rms_mm = float(np.sqrt(np.mean(height_mm**2)))
    degrees = {name: np.rad2deg(getattr(fit.geometry, name)) for name in ("wall_pitch_rad", "wall_yaw_rad")}
    errors = {name: np.rad2deg(fit.errors.get(name, 0.0)) for name in degrees}
    lines: list[tuple[str, dict[str, object]]] = [
        (
            f"wall at {fit.geometry.wall_distance_m:.4f} +- {fit.errors.get('wall_distance_m', 0.0):.4f} m, pitch "
            f"{degrees['wall_pitch_rad']:+.3f} +- {errors['wall_pitch_rad']:.3f} deg, yaw "
            f"{degrees['wall_yaw_rad']:+.3f} +- {errors['wall_yaw_rad']:.3f} deg; "
            f"{rms_mm:.3f} mm = {rms_mm / MM_PER_PS:.2f} ps RMS off the plane",
            {
                "wall_distance_m": fit.geometry.wall_distance_m,
                "wall_pitch_deg": float(degrees["wall_pitch_rad"]),
                "wall_yaw_deg": float(degrees["wall_yaw_rad"]),
                "geometry": vars(fit.geometry),
                "geometry_errors": dict(fit.errors),
                "wall_rms_mm": rms_mm,
                "wall_rms_ps": rms_mm / MM_PER_PS,
            },
        )
    ]
    if len(fit.spot_residual_m):
        spots_mm = float(np.sqrt(np.mean(fit.spot_residual_m**2))) * 1e3
        lines += fitted_lines(fit)
        lines.append((f"spots {spots_mm:.2f} mm RMS off the model", {"spots_rms_mm": spots_mm}))
    loose = {name: (getattr(fit.geometry, name), fit.errors[name]) for name in poorly_determined(fit)}
    for name, (value, error) in {**fit.undetermined, **loose}.items():
        kept = "; kept as the scan was aimed" if name in fit.undetermined else ""
        lines.append((f"warning: {undetermined_line(name, value, error)}{kept}", {}))
    lines[0][1]["undetermined"] = sorted({**fit.undetermined, **loose})
    return lines
