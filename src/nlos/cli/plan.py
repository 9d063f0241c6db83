"""`nlos plan`: checks everything that a scan would, moves nothing, and says how long it will take."""

import os
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from nlos.acquisition.planning.direct_light import expected_direct, window_warnings
from nlos.acquisition.planning.preflight import (
    Expectation,
    ExpectedRates,
    aim_of,
    beam_within_px,
    check_disk,
    check_light,
    checked_angles,
    disk_bytes,
    expectation,
    fitted,
    refitted,
)
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Choice, Scheme, choose
from nlos.acquisition.planning.timing import Links, Pace, learned_links, links_of, moves_s
from nlos.acquisition.recording.new_name import file_to_write
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.response import Response as InstrumentResponse
from nlos.acquisition.response import gaussian
from nlos.acquisition.scanning.light_watch import SHUT_WITHIN_S
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.beam_seen import judge_beam
from nlos.cli.benches import load_bench, measured_constants, opened, twin
from nlos.cli.file_words import Response
from nlos.cli.named_files import BenchWord, ScanWord
from nlos.cli.targets import check_place, picture_target, recording_target
from nlos.cli.terminal import terminal
from nlos.configs.load import load
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.trip_latch import check_before_light
from nlos.response import resolution_across_m, response_of, response_wanted
from nlos.run_defaults import dated_name
from nlos.writable import check_writable

if TYPE_CHECKING:
    from nlos.acquisition.planning.aim import Aiming
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.drivers.bench import Bench
    from nlos.drivers.bench_settings import BenchSettings


def plan(
    scan: ScanWord,
    bench: BenchWord = None,
    like: Annotated[
        Path | None,
        typer.Option(metavar="RUN.h5", help="An earlier scan of this bench, to predict photons and pace from."),
    ] = None,
    constants: Annotated[
        Path | None,
        typer.Option(metavar="CONSTANTS.h5", help="Constants to aim by, or none. Default: the bench's newest."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(metavar="F.png", help="Draw the mirror's path, coloured by time.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="RUN.h5", help="Where the scan will write. Default: as `nlos scan`."),
    ] = None,
    response: Response = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Checks everything that `scan` would, a trip that stands and the disk, too; duration with its parts, disk, photons
    to expect. Moves nothing: a real bench is not even opened, its simulated twin is asked."""
    if picture is not None:
        check_place(picture_target(picture), overwrite, "--picture")
    if output is not None:
        recording_target(output)
    told = response_wanted(response)
    wanted, table = load("scan", scan, ScanSettings), load_bench(bench)
    asked = wanted.settings.plan()
    foreign = table.settings.foreign_first_light()
    table = replace(table, settings=table.settings.with_own_first_light())
    with opened(twin(table), quiet=True) as open_bench:
        planned = fitted(asked, open_bench)
        # Of a real bench a twin is open: its constants are known by the bench's name, serial numbers by scan alone.
        known = measured_constants(constants, open_bench, table.settings)
        measured = None if known is None else known.geometry
        aim = aim_of(open_bench) if measured is None else measured
        angles = checked_angles(planned, open_bench, aim)
        rates, links = None, None
        if like is not None:
            rates, links = _learned(like, open_bench, aim)
        elif table.settings.simulated and open_bench.simulated is not None:
            rates = ExpectedRates.of_simulation(planned, open_bench, angles)
        choice = choose(planned, open_bench, angles, links, aim=aim)
        within_px = beam_within_px(planned, open_bench, angles)
        direct = expected_direct(planned, open_bench.settings, aim)
        beam = judge_beam(table.settings, aim, by_spots=measured is not None)
        expected = told.response if not told.auto else response_of(known) or _simulated(table.settings)
    _tell(planned, choice, refitted(asked.axis, planned.axis))
    _tell_shutter(table.settings)
    _tell_beam(within_px, planned, choice)
    _tell_resolution(planned, expected)
    there = _stands_there(output, overwrite)
    doubts = (foreign, *window_warnings(planned, direct), beam.wrong, beam.warning, there)
    warnings = [each for each in doubts if each]
    for warning in warnings:
        terminal.log(f"warning: {warning}")
    terminal.document["warnings"] = warnings
    if rates is not None:
        _tell_light(expectation(planned, rates))
    target = output or dated_name(table.settings, wanted.path.stem, "", datetime.now())
    _check_before_light(table.settings, planned, wanted.settings, target)
    if rates is not None:
        check_light(rates, table.settings.laser.repetition_hz)
    if picture is not None:
        from nlos.report.figures import path_picture

        picture.absolute().parent.mkdir(exist_ok=True)
        path_picture(planned.only(planned.expected()), picture, new=not overwrite)
        terminal.result(f"{picture}: the path over the wall and the dwell of every point", picture=str(picture))


def _stands_there(output: Path | None, overwrite: bool) -> str:
    """What to say of a recording that `scan` would refuse to replace: `plan` cannot know that it will be resumed."""
    if output is None or overwrite or not os.path.lexists(output):
        return ""
    return f"{output}: exists. `nlos scan` will ask for another name, for --resume or for --overwrite."


def _check_before_light(bench: "BenchSettings", planned: "ScanPlan", asked: ScanSettings, target: Path) -> None:
    """What has nothing to do with the plan, and would refuse its scan all the same."""
    check_before_light(bench)
    check_writable(file_to_write(target).absolute().parent)
    check_disk(planned, target, round(asked.alarms.min_free_mb * 1e6))


def _learned(like: Path, bench: "Bench", aim: "Aiming") -> "tuple[ExpectedRates, Links]":
    """Photon rates, and the cables' times if the past scan was stepped by the host."""
    links = links_of(bench)
    with open_checked(like) as recording:
        rates = ExpectedRates.of_recording(recording)
        if any(event.kind == "scheme" and event.text.startswith("S1") for event in recording.events()):
            positions = recording.plan.positions
            aimed = aim.angles_rad(positions.x_m, positions.y_m)
            angles = [MirrorAngles(x, y) for x, y in zip(*(each.tolist() for each in aimed), strict=True)]
            links = learned_links(links, list(recording.samples()), Pace(recording.plan, moves_s(bench, angles)))
    return rates, links


def _tell_light(expected: "Expectation") -> None:
    counts = {"direct": expected.direct, "indirect": expected.indirect, "background": expected.background}
    terminal.result(
        "photons    "
        + ", ".join(f"{name} {count:.3g}" for name, count in counts.items())
        + f" a point; signal-to-noise of the indirect light {expected.signal_to_noise:.1f}",
        counts_per_point=counts, signal_to_noise=expected.signal_to_noise,
    )  # fmt: skip


def _tell_shutter(bench: "BenchSettings") -> None:
    if bench.shutter_on == "nothing":
        terminal.result(
            "light      as the laser is: no shutter that a trip or an alarm could close", shut_within_s=None
        )
    else:
        terminal.result(f"light      off within {SHUT_WITHIN_S:g} s of a trip or an alarm", shut_within_s=SHUT_WITHIN_S)


def _tell_beam(settled_px: float, plan: "ScanPlan", choice: "Choice") -> None:
    if choice.scheme is Scheme.SWEPT and plan.within_px is not None:
        within_px = plan.within_px
        how = "in the middle of its dwell; the lag is measured first, and nothing is swept where that does not hold"
    else:
        within_px, how = settled_px, "when its gate opens, as the mirror's settling is stated"
    terminal.result(f"beam       within {within_px:.2g} pixel of each point {how}", beam_within_px=within_px)


def _simulated(settings: "BenchSettings") -> "InstrumentResponse | None":
    """Of the simulated detector, where the bench is drawn; a lab's is not known before it is measured."""
    if not settings.simulated or settings.simulation is None:
        return None
    return gaussian(settings.simulation.detector.jitter_fwhm_ps * 1e-12, "the simulated detector's")


def _tell_resolution(plan: "ScanPlan", response: "InstrumentResponse | None") -> None:
    """What the scan can tell apart, at depths of half the wall's longer side and of all of it."""
    wall, bin_s = plan.wall, plan.axis.bin_width_s
    pixel_m = max(wall.width_m / wall.cols, wall.height_m / wall.rows)
    if response is None:
        words = "the response is not known, see `nlos calibrate` or use --response"
        terminal.result(f"resolution {pixel_m * 1e3:.1f} mm across at best, a pixel; {words}", pixel_m=pixel_m)
        return
    fwhm_s = response.fwhm_s
    depths_m = (wall.longer_m / 2, wall.longer_m)
    across_m = [max(pixel_m, resolution_across_m(fwhm_s, wall.longer_m, depth_m)) for depth_m in depths_m]
    along_m = SPEED_OF_LIGHT_M_PER_S / 2 * max(fwhm_s, bin_s)
    terminal.result(
        "resolution "
        + ", ".join(f"{m * 1e3:.1f} mm across at {d:g} m" for m, d in zip(across_m, depths_m, strict=True))
        + f", {along_m * 1e3:.1f} mm in depth: response {fwhm_s * 1e12:.0f} ps ({response.source}), "
        f"pixels {pixel_m * 1e3:.1f} mm, bins {bin_s * 1e12:g} ps",
        resolution_across_m=across_m, at_depths_m=list(depths_m), resolution_depth_m=along_m, pixel_m=pixel_m,
        response_fwhm_s=fwhm_s,
    )  # fmt: skip


def _tell_budget(plan: "ScanPlan", choice: "Choice") -> None:
    """What a plan of candidates comes to if nobody advises otherwise, which is all that can be known before."""
    budget, most, wall = plan.budget, plan.most_samples, plan.wall
    assert budget is not None
    dwells_ms = np.unique(plan.dwell_s) * 1e3
    beside_ms = (choice.forecast.total_s - choice.forecast.dwell_s) / most * 1e3
    terminal.result(
        f"points     at most {most} of {len(plan)} candidates on {wall.width_m:g} x {wall.height_m:g} m, in batches of "
        f"{budget.batch}: chosen on the way by dwell ({', '.join(f'{each:g}' for each in dwells_ms)} ms) and place",
        points=most, candidates=len(plan), batch=budget.batch, dwells_ms=dwells_ms.tolist(),
    )  # fmt: skip
    terminal.result(
        f"time       {budget.total_us / 1e6:g} s of dwell and {budget.step_us / 1e3:g} ms a point beside it; what "
        f"follows is for coarse to fine at {dwells_ms[0]:g} ms, where this bench takes {beside_ms:.2g} ms a point",
        budget_s=budget.total_us / 1e6, step_s=budget.step_us / 1e6, expected_step_s=beside_ms / 1e3,
    )  # fmt: skip


def _tell(plan: "ScanPlan", choice: "Choice", other_axis: str) -> None:
    forecast = choice.forecast
    low_s, high_s = forecast.band_s
    disk = disk_bytes(plan)
    parts = {"dwell_s": forecast.dwell_s, "settle_s": forecast.settle_s, "links_s": forecast.links_s,
             "upload_s": forecast.upload_s}  # fmt: skip
    wall, axis = plan.wall, plan.axis
    if plan.budget is None:
        terminal.result(f"points     {len(plan)} on {wall.width_m:g} x {wall.height_m:g} m", points=len(plan))
    else:
        _tell_budget(plan, choice)
    if plan.frames > 1:
        each = len(plan) / plan.frames
        again = f", the same again after {plan.cycle}" if plan.cycle > 1 else ""
        most = f"until stopped, at most {plan.frames}" if plan.until_stopped else f"{plan.frames}"
        terminal.result(
            f"frames     {most} of {each:g} points{again}; {plan.frames / forecast.total_s:.3g} a second, "
            f"light measured {forecast.dwell_s / forecast.total_s:.0%} of the time",
            frames=plan.frames, until_stopped=plan.until_stopped, cycle=plan.cycle,
            frames_per_s=plan.frames / forecast.total_s, duty=forecast.dwell_s / forecast.total_s,
        )  # fmt: skip
    terminal.result(
        f"histogram  {axis.bins} bins of {axis.bin_width_s * 1e12:g} ps from {axis.offset_s * 1e9:g} ns"
        + (f": {other_axis}" if other_axis else ""),
        bins=axis.bins, bin_width_s=axis.bin_width_s, offset_s=axis.offset_s,
    )  # fmt: skip
    terminal.result(
        f"scheme     {choice.scheme.words}: {choice.why}",
        scheme=choice.scheme.value,
        why=choice.why,
    )
    took = f"{forecast.total_s:.1f} s ({low_s:.1f} to {high_s:.1f} s)"
    if plan.until_stopped:
        took = f"until stopped, at most {forecast.total_s:.1f} s"
    terminal.result(
        f"duration   {took}: "
        + ", ".join(f"{name.removesuffix('_s')} {seconds:.1f} s" for name, seconds in parts.items()),
        duration_s=forecast.total_s, band_s=[low_s, high_s], parts=parts,
    )  # fmt: skip
    until = ""
    if plan.until_stopped:
        until = f" at most, {disk / forecast.total_s * 60 / 1e6:.3g} MB a minute, and as much again while it ends"
    terminal.result(f"disk       {disk / 1e6:.1f} MB{until}", disk_bytes=disk)
