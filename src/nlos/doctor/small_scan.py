"""A scan of 4 x 4 points: recorded, read back, held against where the wall is, and reconstructed."""

import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np

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
from nlos.doctor.findings import Finding, failed, passed, warned
from nlos.doctor.gates import axis_of, expected_s
from nlos.drivers.bench import Bench

_HALF_M = 0.2
_SIDE = 4


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
    with tempfile.TemporaryDirectory() as folder:
        yield from _scanned(bench, Path(folder))


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
    yield _direct_light(samples, bench)
    if find_spec("torch") is not None:
        yield from _reconstruction(run, folder)


def _direct_light(samples: list[Sample], bench: Bench) -> Finding:
    """Whether the first arrival is about where the wall is."""
    late_ns = []
    for sample in samples:
        h, p = sample.histogram, sample.point
        # The first peak, not the highest: a hidden surface may return more light than the wall's spot.
        first = int((h.counts >= max(0.3 * h.counts.max(), 1)).argmax())
        arrival_s = h.offset_s + (first + 0.5) * h.bin_width_s
        late_ns.append((arrival_s - expected_s(range_m(bench, (p.x_m, p.y_m)))) * 1e9)
    late_ns.sort()
    middle, spread = late_ns[len(late_ns) // 2], late_ns[-2] - late_ns[1]
    said = f"{middle:+.2f} ns from where the wall is, the same within {spread:.2f} ns at all points"
    if spread > 0.5:
        return warned("direct light", said, "Check aim and wall_distance_m; run `nlos calibrate`.")
    return passed("direct light", said)


def _reconstruction(run: Path, folder: Path) -> Iterator[Finding]:
    try:
        done = reconstruct_file(run, "lct", {}, folder / "doctor")
    except InvalidData as error:
        yield warned("reconstruction", str(error), "The wall may not be in the histograms' time window.")
        return
    yield passed("reconstruction", f"lct in {done.seconds:.2f} s, albedo up to {done.albedo.max():.3g}")
