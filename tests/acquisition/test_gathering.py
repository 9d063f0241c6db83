"""Samples added up as they come are what the recording of them says, in whatever order and however often they came."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.acquisition.scanning.free_points import FreePoints
from nlos.acquisition.scanning.gathering import Gathering
from nlos.drivers.bench import BenchSettings, open_bench

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"exposure": {"kind": "two_pass", "counts": 100000, "again_ms": 20}},
        {"exposure": {"kind": "stop_at_counts", "counts": 5, "from_ns": 10.0, "to_ns": 26.0}},
    ],
    ids=["uniform", "two passes", "stopped at counts"],
)
def test_what_is_gathered_is_what_the_file_says(
    bench_settings: Benches, small_plan: Plans, run_path: Path, changes: dict[str, Any]
) -> None:
    plan = small_plan(3, 5, **changes)
    with open_bench(bench_settings()) as bench, RecordingWriter.create(run_path, plan, Header()) as writer:
        record(scan(plan, bench), writer)
    with Recording.open(run_path) as recording:
        samples, said = list(recording.samples()), recording.transient()
    mixed, gathered, free = [*samples, *samples[:7]], Gathering(plan), FreePoints(plan)
    random.Random(1).shuffle(mixed)
    new = [(gathered.add(sample), free.add(sample)) for sample in mixed]
    assert sum(each for each, _ in new) == sum(each for _, each in new) == len(gathered) == len(free) == len(samples)
    assert np.array_equal(gathered.transient().counts, said.counts)
    np.testing.assert_allclose(gathered.transient().exposure_s, said.exposure_s, rtol=1e-6)
    assert gathered.transient().time == said.time
    sums = [(gathered.sync_count, "sync_count"), (gathered.total_count, "total_count")]
    for sum_, name in sums:
        expected = np.zeros((3, 5))
        for sample in samples:
            expected[sample.point.row, sample.point.col] += getattr(sample.histogram, name)
        assert np.array_equal(sum_, expected)
    for sample in samples:
        number = np.array([sample.point.number])
        place, there = int(gathered.place_of(number)[0]), int(free.place_of(number)[0])
        assert (free.x_m[there], free.y_m[there]) == (sample.point.x_m, sample.point.y_m)
        assert np.array_equal(gathered.place_counts(place), free.place_counts(there))
        assert np.array_equal(gathered.place_counts(place), said.counts[:, sample.point.row, sample.point.col])
        rate_hz = gathered.total_count[sample.point.row, sample.point.col] / said.exposure_s[*divmod(place, 5)]
        assert gathered.place_rates_hz()[place] == pytest.approx(rate_hz, rel=1e-6)
        assert free.place_rates_hz()[there] == pytest.approx(rate_hz, rel=1e-6)
