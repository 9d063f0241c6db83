"""A scan of 4 x 4 points: recorded, read back, held against where the wall is, and reconstructed."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nlos.acquisition.direct_peak import direct_peak
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import free, pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.engine import record, scan
from nlos.acquisition.wall import WallGrid
from nlos.calibration.errors import InvalidData
from nlos.chain import reconstruct_file
from nlos.doctor.area import area_of, range_m
from nlos.doctor.findings import Finding, failed, passed, skipped, warned
from nlos.doctor.gates import axis_of, delay_unknown, expected_s
from nlos.drivers.bench import Bench
from nlos.drivers.tcspc.counter import HistogramAxis
from nlos.recipe import Recipe
from nlos.response import response_wanted
from nlos.results_folder import ResultsFolder

_HALF_M = 0.2
_SIDE = 4
_NEAR_S = 1.2e-9
_FAR_NS = 1.0
"""So far from where it should be, light may be that of a hidden surface, or the delay another one."""


def small_plan(bench: Bench, dwell_s: float) -> ScanPlan:
    """4 x 4 points around the middle of the wall, or, where that is not allowed, of the allowed area."""
    area = area_of(bench)
    half_m = min(-area.left_m, area.right_m, -area.bottom_m, area.top_m, _HALF_M)
    if half_m > 0:
        wall = WallGrid(2 * half_m, 2 * half_m, _SIDE, _SIDE)
        positions = pixels(wall, np.repeat(np.arange(_SIDE), _SIDE), np.tile(np.arange(_SIDE), _SIDE))
    else:
        part = area.within(_HALF_M)
        x_m = np.linspace(part.left_m, part.right_m, _SIDE)
        y_m = np.linspace(part.top_m, part.bottom_m, _SIDE)
        wall = WallGrid(3 * float(np.abs(x_m).max()), 3 * float(np.abs(y_m).max()), _SIDE, _SIDE)
        positions = free(np.tile(x_m, _SIDE), np.repeat(y_m, _SIDE))
    number = len(positions)
    return ScanPlan(wall, axis_of(bench), positions, np.full(number, dwell_s), np.zeros(number, np.int32))


def small_scan(bench: Bench) -> Iterator[Finding]:
    """4 x 4 points of 8 ms."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            yield from _scanned(bench, Path(folder))
    except OSError as error:
        said = f"could not be kept in the folder for temporary files ({error.__cause__ or error})"
        yield failed("scan", said, "Free disk space there, or name another folder by the environment variable TMPDIR.")


def _scanned(bench: Bench, folder: Path) -> Iterator[Finding]:
    plan = small_plan(bench, 8e-3)
    run = folder / "doctor.h5"
    samples: list[Sample] = []
    with RecordingWriter.create(run, plan, Header()) as writer:
        record(scan(plan, bench), writer, samples.append)
        writer.finish(Status.COMPLETE)
    with Recording.open(run) as recording:
        same = all(
            (a.histogram.counts == b.histogram.counts).all() for a, b in zip(samples, recording.samples(), strict=True)
        )
    counts = sum(sample.histogram.total_count for sample in samples)
    if not same or len(samples) != len(plan):
        yield failed("scan", "what was recorded is not what was measured", "Check memory and disk.")
        return
    yield passed("scan", f"{len(samples)} points, {counts} photons, recorded and read back")
    light = _direct_light(samples, bench)
    yield light
    yield from _reconstruction(run, folder, bench, light)


def _direct_light(samples: list[Sample], bench: Bench) -> Finding:
    """Whether the first arrival is about where the wall is."""
    axis = axis_of(bench)
    late_ns = _late_ns(samples, bench, axis)
    if len(late_ns) < len(samples) / 2:
        start_ns, end_ns = axis.offset_s * 1e9, (axis.offset_s + axis.bins * axis.bin_width_s) * 1e9
        said = (
            f"none stands out at {len(samples) - len(late_ns)} of {len(samples)} points, {start_ns:g} to {end_ns:g} ns"
        )
        return warned("direct light", said, delay_unknown(bench))
    late_ns.sort()
    middle, spread = late_ns[len(late_ns) // 2], late_ns[-2] - late_ns[1]
    said = f"{middle:+.2f} ns from where the wall is, the same within {spread:.2f} ns at all points"
    if spread > 0.5:
        return warned("direct light", said, "Check aim and wall_distance_m; run `nlos calibrate`.")
    if abs(middle) > _FAR_NS:
        return warned("direct light", said, delay_unknown(bench))
    return passed("direct light", said)


def _late_ns(samples: list[Sample], bench: Bench, axis: HistogramAxis) -> list[float]:
    """How much later than due the direct peaks come, where one stands out. Where a surface returns more light than the
    wall, the peak that most points have is looked for beside it."""
    due_s = [expected_s(bench, range_m(bench, (each.point.x_m, each.point.y_m))) for each in samples]
    found = [direct_peak(each.histogram.counts, axis) for each in samples]
    late_s = [np.nan if peak is None else peak.time_s - due for peak, due in zip(found, due_s, strict=True)]
    middle_s = float(np.nanmedian(late_s)) if any(found) else 0.0
    for k, sample in enumerate(samples):
        if late_s[k] > middle_s + _NEAR_S:
            first = max(0, round((due_s[k] + middle_s - _NEAR_S - axis.offset_s) / axis.bin_width_s))
            counts = sample.histogram.counts[first : first + round(2 * _NEAR_S / axis.bin_width_s)]
            start_s = axis.offset_s + first * axis.bin_width_s
            if (early := direct_peak(counts, HistogramAxis(len(counts), axis.bin_width_s, start_s))) is not None:
                late_s[k] = early.time_s - due_s[k]
    return [late * 1e9 for late in late_s if np.isfinite(late)]


def _reconstruction(run: Path, folder: Path, bench: Bench, light: Finding) -> Iterator[Finding]:
    try:
        # Without a response: that it is slow for so small a wall, which nobody chose, is no news of the bench.
        recipe = Recipe("lct", response=response_wanted("none"))
        done = reconstruct_file(run, recipe, ResultsFolder(folder / "doctor"))
    except InvalidData as error:
        if light.verdict == "PASS":
            yield warned("reconstruction", str(error), delay_unknown(bench))
        else:
            yield skipped("reconstruction", "no direct light to begin from: what to do about that cures this too")
        return
    yield passed("reconstruction", f"lct in {done.seconds:.2f} s, albedo up to {done.albedo.max():.3g}")
