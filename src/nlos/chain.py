"""From a file or arrays to a picture: read, calibrate, reconstruct, write. What every way to a picture shares."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.importers.given import NOTHING, Given
from nlos.acquisition.importers.unchanged import unchanged
from nlos.bench_constants import correcting_constants
from nlos.calibration.correct import CorrectedPoints, correct, correct_points, on_grid
from nlos.calibration.errors import NoDirectPeak, NothingBehind, ShutterClosed
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.raw_points import RawPoints, from_transient
from nlos.calibration_told import IF_RECTIFIED, tell_calibration
from nlos.cli.escaped import escaped
from nlos.direct_cut import cut_direct, tell_of_tail, without_first
from nlos.direct_times import DirectTimes
from nlos.light_left_out import tell_of_light_left_out
from nlos.loaded import LoadedScan, load_scan, refuse_full, said_rectified
from nlos.recipe import Recipe
from nlos.recon.depth_range import within_depths
from nlos.recon.errors import InvalidData, InvalidSettings, NoLight
from nlos.recon.gridding import grid_samples
from nlos.recon.methods import find
from nlos.recon.reconstruct import reconstruct
from nlos.recon.results import write_results
from nlos.response import known_response, say_response, with_response
from nlos.results_folder import ResultsFolder
from nlos.said_once import Tell
from nlos.seemingly_raw import tell_if_not_rectified

if TYPE_CHECKING:
    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.impulse_response import ImpulseResponse
    from nlos.recon.volume import Reconstruction

log = logging.getLogger(__name__)

FIRST_STAGE, STAGES = "reading", 4
"""A file is read, calibrated, reconstructed and drawn."""


def constants_for(scan: LoadedScan, given: Path | None, tell: Tell = log.log) -> "BenchConstants | None":
    """The constants named, or the newest of this scan's bench that hold for it. Raises `ForeignConstants`."""
    known = correcting_constants(given, scan.bench_json, scan.devices, scan.transient.time.bin_width_s)
    if known is None:
        return None
    tell(logging.INFO, "%s", known.said())
    if known.warning:
        tell(logging.WARNING, "%s", known.warning)
    return known.constants


def arrivals_of(scan: LoadedScan, constants: "BenchConstants | None" = None) -> DirectTimes | None:
    """When direct light arrives at each point, by a whole scan: what its single frames are aligned by. None where the
    file says it or only constants know."""
    if scan.rectified or scan.no_direct_light:
        return None
    raw, places = _raw(scan), None
    if scan.points is not None:
        places = {place: k for k, place in enumerate(zip(raw.x_m.tolist(), raw.y_m.tolist(), strict=True))}
    done = correct_points(raw, constants)
    tell_calibration(done, log.log)
    offsets = done.offsets
    return None if offsets is None else DirectTimes(offsets, done.known(offsets.offset_bins), places)


def calibrate_scan(
    scan: LoadedScan,
    use_file_offsets: bool = False,
    constants: "BenchConstants | None" = None,
    arrivals: DirectTimes | None = None,
    hear: "Callable[[CorrectedPoints], None]" = lambda done: None,
    tell: Tell = log.log,
) -> "Transient":
    """The transient that the physics can use: time 0 at the direct arrival, direct light removed, and what is known of
    the instrument's response. `arrivals`: of the direct light, where they are known. `hear` is told what was found of
    a scan that had to be aligned, `tell` how well, in words: `SaidOnce` for one that is looked at again and again.

    A rectified file that states its cut gets that cut; in one that states none, direct light is looked for.
    """
    transient, own = _calibrated(scan, use_file_offsets, constants, arrivals, hear, tell)
    return replace(transient, response=known_response(scan, constants, own))


def _calibrated(
    scan: LoadedScan,
    use_file_offsets: bool,
    constants: "BenchConstants | None",
    arrivals: DirectTimes | None,
    hear: "Callable[[CorrectedPoints], None]",
    tell: Tell,
) -> "tuple[Transient, ImpulseResponse | None]":
    """And the response that the scan's own direct light showed, where it was looked for."""
    transient = scan.transient
    _refuse_late(scan)
    refuse_full(scan)
    if use_file_offsets:
        scan = _shifted_by_file(scan)
    use_file_offsets = use_file_offsets or (scan.no_direct_light and not scan.rectified)
    if scan.points is not None:
        points = _raw(scan)
        if scan.rectified and scan.direct_cut_bins is not None:
            points = replace(points, counts=without_first(points.counts.T, scan.direct_cut_bins).T)
        with _or_rectified(_rectified_told(scan)):
            done = correct_points(
                points, constants, rectified=scan.rectified, remove_direct=scan.direct_cut_bins is None,
                known=None if scan.rectified or arrivals is None else arrivals.of(points),
            )  # fmt: skip
        if scan.rectified:
            tell_if_not_rectified(scan, points, done, tell)
            tell_of_tail(points.counts.T, scan.direct_cut_bins or 0, points.time.bin_width_s, tell)
        elif arrivals is None:
            hear(done)
            tell_calibration(done, tell)
        gridded = grid_samples(
            scan.points.x_m, scan.points.y_m, done.counts, done.exposure_s, transient.wall, done.time
        )
        return gridded, _own(done) if arrivals is None else arrivals.response
    if scan.rectified and scan.direct_cut_bins is not None:
        kept = cut_direct(transient, scan.direct_cut_bins)
        tell_of_tail(kept.counts, scan.direct_cut_bins, kept.time.bin_width_s, tell)
        return kept, None
    if scan.rectified:
        tell_of_tail(transient.counts, 0, transient.time.bin_width_s, tell)
        done_so = correct(transient, rectified=True)
        tell_if_not_rectified(scan, from_transient(transient), done_so.points, tell)
        return done_so.transient, None
    if use_file_offsets or arrivals is not None:
        of_a_whole = None if use_file_offsets else arrivals
        by_file = None if scan.offset_bins is None else KnownDirect(scan.offset_bins)
        known = by_file if of_a_whole is None else of_a_whole.known
        done_by = correct(transient, constants, known=known, sync_count=scan.sync_count, total_count=scan.total_count)
        if of_a_whole is None:
            tell_of_light_left_out(done_by.points, tell)
        response = None if of_a_whole is None else of_a_whole.response
        aligned = done_by.transient
        return cut_direct(aligned, scan.direct_cut_bins) if scan.direct_cut_bins else aligned, response
    with _or_rectified(_rectified_told(scan)):
        corrected = on_grid(correct_points(_raw(scan), constants), transient.wall)
    hear(corrected.points)
    tell_calibration(corrected.points, tell)
    return corrected.transient, _own(corrected.points)


def _raw(scan: LoadedScan) -> RawPoints:
    """Its points as they were taken, or those of its grid in row order."""
    raw = scan.points or from_transient(scan.transient, scan.sync_count, scan.total_count)
    return replace(raw, scanner_m=scan.scanner_m)


def _refuse_late(scan: LoadedScan) -> None:
    """Raises `InvalidData` for a rectified scan whose record begins later than it is long: most of a time axis from 0
    on would be empty, and of a wrong unit all that there is memory for."""
    time = scan.transient.time
    if scan.rectified and scan.direct_cut_bins is None and time.start_s >= time.bins * time.bin_width_s:
        raise InvalidData(
            f"offset_s: the first bin begins {time.start_s * 1e9:.4g} ns after light is at the wall, and all "
            f"{time.bins} bins last {time.bins * time.bin_width_s * 1e9:.4g} ns: most of a time axis from 0 "
            "on would be empty. Is offset_s in seconds? If so, store empty bins before them, and offset_s = 0."
        )


def _shifted_by_file(scan: LoadedScan) -> LoadedScan:
    """One whose file's offsets are to be used: raw, unless somebody said that it is not. Raises `InvalidSettings` where
    it has none, or nothing to shift by them."""
    if scan.points is not None:
        raise InvalidSettings("offsets=file: the points are at free positions, offsets are of a grid. Leave it out.")
    if scan.offset_bins is None:
        raise InvalidSettings("offsets=file: the file has no time_offset_bins. Leave it out.")
    if scan.rectified and not scan.rectified_assumed:
        raise InvalidSettings("offsets=file: time 0 is the wall already, there is nothing to shift. Use --raw as well.")
    if scan.rectified:
        log.info("offsets=file: time_offset_bins are used and the scan is taken for raw, as nobody said that it is not")
        return replace(said_rectified(scan, False), direct_cut_bins=scan.direct_cut_bins)
    return scan


def _own(points: "CorrectedPoints") -> "ImpulseResponse | None":
    return None if points.offsets is None else points.offsets.response


def _rectified_told(scan: LoadedScan) -> bool:
    return scan.rectified or bool(scan.devices)


@contextmanager
def _or_rectified(told: bool) -> Iterator[None]:
    """Where another program's scan cannot be aligned, it may need no alignment: the error says how to say so."""
    try:
        yield
    except (NoDirectPeak, NothingBehind, NoLight) as error:
        if told or isinstance(error, ShutterClosed):
            raise
        raise type(error)(f"{error} {IF_RECTIFIED}") from error


def reconstruct_scan(
    scan: LoadedScan,
    recipe: Recipe,
    *,
    stage: Callable[[str], None] = lambda name: None,
    whole: LoadedScan | None = None,
) -> "Reconstruction":
    """A scan calibrated and reconstructed, a frame by the direct light of the `whole` one; the falloff that its file
    states is used unless the settings say another."""
    return _pictured(_calibrated_for(scan, recipe, stage, whole), stage)


@dataclass(frozen=True)
class _Calibrated:
    """What a picture is made of. What was recorded is not in it: a method needs the memory."""

    transient: "Transient"
    recipe: Recipe
    falloff: int | None
    left_aside: int
    rectified_told: bool
    """Whether a user, or the file, knows if it is rectified."""


def _calibrated_for(
    scan: LoadedScan, recipe: Recipe, stage: Callable[[str], None], whole: LoadedScan | None
) -> _Calibrated:
    chosen = dict(recipe.settings)
    offsets = chosen.pop("offsets", None)
    if offsets not in (None, "file"):
        raise InvalidSettings(f"offsets={offsets}: only `offsets=file` is known")
    if scan.falloff is not None and "falloff" in find(recipe.method).Settings.model_fields:
        chosen.setdefault("falloff", scan.falloff)
    stage("calibrating")
    known = constants_for(scan, recipe.constants)
    arrivals = None if whole is None else arrivals_of(whole, known)
    transient = calibrate_scan(scan, offsets == "file", known, arrivals)
    recipe = replace(recipe, settings=chosen)
    return _Calibrated(transient, recipe, scan.falloff, scan.left_aside, _rectified_told(scan))


def _pictured(done: _Calibrated, stage: Callable[[str], None]) -> "Reconstruction":
    wall, time = done.transient.wall, done.transient.time
    stage(f"{done.recipe.method} on {wall.rows} x {wall.cols} x {time.bins}")
    with _or_rectified(done.rectified_told):
        made = reconstruct_transient(done.transient, done.recipe, done.falloff)
    return replace(made, left_aside=done.left_aside)


def reconstruct_transient(transient: "Transient", recipe: Recipe, falloff: float | None = None) -> "Reconstruction":
    """What is calibrated already, time 0 at the wall, reconstructed. `falloff`: as the scan's file states it."""
    transient = with_response(transient, recipe.response)
    say_response(transient)
    if unlike := _unlike_trained(recipe.settings.get("weights"), transient, falloff):
        log.warning("%s", unlike)
    return reconstruct(transient, recipe.method, recipe.settings, recipe.device, elsewhere=True)


def _unlike_trained(weights: object, transient: "Transient", falloff: float | None) -> str:
    """Where the scan lies outside of what weights of one's own were trained on, in words."""
    if weights is None:
        return ""
    from nlos.recon.weights.outside import outside_range

    return outside_range(weights, transient, falloff)


def reconstruct_file(
    run: Path,
    recipe: Recipe,
    results: ResultsFolder,
    *,
    given: Given = NOTHING,
    frame: int | None = None,
    stage: Callable[[str], None] = lambda name: None,
) -> "Reconstruction":
    """One file to one folder of results. What is `given` goes before what the file says. Of several frames all are
    added up, or `frame` is taken alone. `stage` is told what begins, `STAGES` times."""
    results.check()
    stage(FIRST_STAGE)
    frames = None if frame is None else range(frame, frame + 1)
    with unchanged(run, grows=True):
        scan, whole = load_scan(run, given, frames), None if frame is None else load_scan(run, given)
    done = _calibrated_for(scan, recipe.limited_to(results.depth_m), stage, whole)
    del scan, whole
    made = _pictured(done, stage)
    limited = made if results.depth_m is None else within_depths(made, *results.depth_m)
    result = replace(limited, scan=escaped(run.name), frame=frame)
    stage("drawing")
    write_results(results.path, result, overwrite=results.overwrite, keep_volume=results.volume, html=results.html)
    return result
