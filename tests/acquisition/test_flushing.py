"""A sample is acknowledged within a second, however long the next one is in coming."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.drivers.clock import VirtualClock
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

EMPTY = 0.008, 80_000, 64, HistogramFlag.NONE, 0.0


@pytest.mark.parametrize(("dwell_ms", "due"), [(8, [0, 0, 0, 4]), (400, [0, 2, 2, 4]), (3000, [1, 2, 3, 4])])
def test_a_sample_is_not_kept_waiting_by_the_next(
    small_plan: Callable[..., ScanPlan], run_path: Path, dwell_ms: float, due: list[int]
) -> None:
    """One every 0.33 s, of plans in which the next could take longer."""
    plan, clock, acknowledged = small_plan(dwell_ms=dwell_ms), VirtualClock(), []
    with RecordingWriter.create(run_path, plan, Header(), clock=clock) as writer:
        for number in range(4):
            clock.sleep(0.33)
            counts = np.ones(plan.axis.bins, dtype=np.uint32)
            histogram = Histogram(counts, plan.axis.bin_width_s, plan.axis.offset_s, *EMPTY)
            writer.write(Sample(plan[number], histogram, number * 0.33))
            acknowledged.append(writer.acknowledged)
    assert acknowledged == due
