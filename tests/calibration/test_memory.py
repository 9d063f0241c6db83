"""A large scan is calibrated in little more memory than what it holds, and comes out the same."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import pytest

from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.calibration.correct import correct, correct_points
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.measure import measure_constants
from nlos.calibration.raw_points import RawPoints, from_samples, from_transient
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

Made = TypeVar("Made")
SIDE, BINS, WIDTH_S = 56, 640, 32e-12
C = 299_792_458.0


@pytest.fixture(scope="module")
def transient() -> Transient:
    """Direct pulses from a wall, a plane behind the corner, even light, and a point in eight that was not measured."""
    random, wall = np.random.default_rng(4), WallGrid(1.0, 1.0, SIDE, SIDE)
    x, y = np.meshgrid(wall.x_m(), wall.y_m())
    arrival = (2 * np.sqrt(x**2 + (y - 0.2) ** 2 + 1.2**2) / C - 4e-9) / WIDTH_S
    bins = np.arange(BINS)[:, None, None] + 0.5
    expected = 0.1 + 300 * np.exp(-((bins - arrival) ** 2) / 2) + 2 * np.exp(-((bins - arrival - 240) ** 2) / 800)
    exposure_s = np.where(random.random((SIDE, SIDE)) < 0.125, 0.0, 0.01)
    counts = random.poisson(expected).astype(np.float32) * (exposure_s > 0)
    return Transient(counts, exposure_s, wall, TimeAxis(BINS, WIDTH_S))


def _peak(work: Callable[[], Made]) -> tuple[float, Made]:
    """Over the bytes of the record in 32 bits, of what is taken beside what was there before."""
    tracemalloc.start()
    try:
        made = work()
        return tracemalloc.get_traced_memory()[1] / (4 * SIDE * SIDE * BINS), made
    finally:
        tracemalloc.stop()


def _samples(transient: Transient) -> list[Sample]:
    raw = from_transient(transient)
    counts = np.ascontiguousarray(raw.counts).astype(np.uint32)
    return [
        Sample(
            ScanPoint(n, None, None, raw.x_m[n], raw.y_m[n], 0.01),
            Histogram(counts[n], WIDTH_S, 0.0, 0.01, 10**6, int(counts[n].sum()), HistogramFlag.NONE, 0.0),
            0.01 * n,
        )
        for n in np.flatnonzero(raw.exposure_s > 0)
    ]


def test_samples_are_held_once_and_constants_measured_beside_them(transient: Transient) -> None:
    samples = _samples(transient)
    peak, raw = _peak(lambda: from_samples(samples, visits=True))
    assert (raw.counts == [sample.histogram.counts for sample in samples]).all()
    assert peak < 1.2  # 2.9 where all samples are stacked, and half of them in 16 bits

    def measured() -> object:
        return measure_constants([raw], devices={}, sources=[], measured_utc="2026-01-01")

    measured()  # imports what it needs
    peak, _ = _peak(measured)
    assert peak < 3.0  # counts, their variance and which are usable are 2.25 of what is behind the direct light


def test_a_grid_is_corrected_without_a_second_cube(transient: Transient) -> None:
    correct(transient)
    peak, done = _peak(lambda: correct(transient))
    assert peak < 3.0
    raw = from_transient(transient)
    rows = correct_points(replace(raw, counts=np.ascontiguousarray(raw.counts)))
    np.testing.assert_allclose(done.transient.counts.reshape(rows.time.bins, -1).T, rows.counts, rtol=1e-5, atol=1e-5)
    assert (done.points.usable == rows.usable).all()


def test_as_many_points_as_bins_each_have_their_own_background() -> None:
    points = bins = 256
    level = np.where(np.arange(points) % 2, 1.0, 30.0)[:, None]
    counts = np.random.default_rng(1).poisson(np.broadcast_to(level, (points, bins + 100))).astype(np.uint32)
    place, ones = np.linspace(-1, 1, points), np.ones(points)
    raw = RawPoints(counts, place, place, ones, 0 * ones, 0 * ones, TimeAxis(bins + 100, WIDTH_S))
    done = correct_points(raw, known=KnownDirect(100 * ones), remove_direct=False)
    assert done.counts.shape == (points, bins)
    assert np.abs(done.counts.mean(axis=1)).max() < 3.0
