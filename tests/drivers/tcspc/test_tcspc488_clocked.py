"""Scheme S2: the counter's pixel clock steps mirror and counter alike, and blocks are read while it runs."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plug, unplug
from nlos.drivers.simulated.triggerscope.firmware import TriggerScopeFirmware
from nlos.drivers.tcspc.counter import HistogramFlag, PointGates, Trigger

POINTS = [MirrorAngles(0.01 * k - 0.05, 0.004 * (k % 3)) for k in range(11)]
NUMBERS = [100 + k for k in range(11)]
BLANKING_S = 0.0006


@pytest.fixture
def stepped(rig: Callable) -> Iterator[Callable[..., tuple[Any, TriggerScope]]]:
    """stepped(*faults, **settings): the counter's rig, and a mirror on the same bench with its sequence loaded."""
    mirrors = []

    def make(*faults: Fault, **settings: Any) -> tuple[Any, TriggerScope]:
        this = rig(*faults, markers=True, **settings)
        mirror_settings = TriggerScopeSettings(model="triggerscope", port="sim://clocked")
        plug("clocked", TriggerScopeFirmware.matching(this.bench, mirror_settings), this.bench)
        mirror = TriggerScope.open(mirror_settings, this.bench.clock)
        mirrors.append(mirror)
        mirror.load(POINTS)
        mirror.start()
        return this, mirror

    yield make
    for mirror in mirrors:
        mirror.close()
        unplug("clocked")


def test_each_point_is_taken_with_the_beam_at_its_own_place(stepped: Callable) -> None:
    this, _ = stepped()
    this.shutter.open()
    this.seen.clear()
    this.counter.arm(PointGates([0.008] * 11, NUMBERS, Trigger.CLOCK, BLANKING_S))
    start_s = this.bench.clock.now()
    status = this.counter.wait_points(11, 1.0)
    assert (status.points_done, status.lost, status.markers) == (11, 0, 11)
    assert this.bench.clock.now() - start_s == pytest.approx(11 * (0.008 + BLANKING_S), abs=0.005)
    for target, (gate, beam, is_open) in zip(POINTS, this.seen, strict=True):
        assert is_open
        assert gate.dwell_s == pytest.approx(0.008)
        assert (beam.x_rad, beam.y_rad) == pytest.approx((target.x_rad, target.y_rad), abs=5e-5)
    for number, histogram in zip(NUMBERS, this.counter.read(0, 11), strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))
    opened_s = [gate.opened_s for gate, _, _ in this.seen]
    np.testing.assert_allclose(np.diff(opened_s), 0.008 + BLANKING_S, rtol=1e-9)


def test_every_dwell_of_a_list_is_kept_and_the_next_point_follows_at_once(stepped: Callable) -> None:
    this, _ = stepped()
    dwells_s = [0.001 * (k + 1) for k in range(11)]
    this.counter.arm(PointGates(dwells_s, NUMBERS, Trigger.CLOCK, BLANKING_S))
    start_s = this.bench.clock.now()
    this.counter.wait_points(11, 1.0)
    assert this.bench.clock.now() - start_s == pytest.approx(sum(dwells_s) + 11 * BLANKING_S, abs=0.005)
    assert [each.live_time_s for each in this.counter.read(0, 11)] == pytest.approx(dwells_s)


def test_points_are_read_while_later_ones_are_taken(stepped: Callable) -> None:
    this, _ = stepped()
    this.counter.arm(PointGates([0.02] * 11, NUMBERS, Trigger.CLOCK, BLANKING_S))
    read = []
    while len(read) < 11:
        done = this.counter.wait_points(len(read) + 1, 1.0).points_done
        read += this.counter.read(len(read), done - len(read))
        assert len(read) == 11 or this.counter.wait_points(1, 1.0).running
    for number, histogram in zip(NUMBERS, read, strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))


@pytest.mark.parametrize(("kind", "markers"), [("missed", 10), ("extra", 12)])
def test_a_step_too_few_or_too_many_shows_in_the_markers(stepped: Callable, kind: str, markers: int) -> None:
    this, _ = stepped()
    this.bench.faults.add(Fault(name="A6", skip=4, parameters={"kind": kind}))
    this.counter.arm(PointGates([0.002] * 11, NUMBERS, Trigger.CLOCK, BLANKING_S))
    assert this.counter.wait_points(11, 1.0).markers == markers


def test_an_edge_that_the_counter_overlooks_shows_in_markers_and_flags(stepped: Callable) -> None:
    this, _ = stepped()
    this.bench.faults.add(Fault(name="U15", skip=4, parameters={"place": "clock"}))
    this.counter.arm(PointGates([0.002] * 11, NUMBERS, Trigger.CLOCK, BLANKING_S))
    assert this.counter.wait_points(11, 1.0).markers == 12
    flags = [each.flags for each in this.counter.read(0, 11)]
    assert flags == [HistogramFlag.NONE] * 4 + [HistogramFlag.TRIGGER_MISSED] + [HistogramFlag.NONE] * 6


def test_points_taken_before_the_shutter_closed_saw_the_light(stepped: Callable) -> None:
    this, _ = stepped()
    this.bench.set_shutter(True)  # by another controller's line: the counter does not know
    this.seen.clear()
    this.counter.arm(PointGates([0.01] * 11, NUMBERS, Trigger.CLOCK))
    this.bench.clock.sleep(0.055)
    this.bench.set_shutter(False)
    this.bench.clock.sleep(0.1)
    this.counter.wait_points(11, 1.0)
    assert [is_open for _, _, is_open in this.seen] == [True] * 6 + [False] * 5


def test_the_mirror_steps_no_further_after_an_abort(stepped: Callable) -> None:
    this, _ = stepped()
    this.counter.arm(PointGates([0.01] * 11, NUMBERS, Trigger.CLOCK))
    this.bench.clock.sleep(0.055)
    this.counter.abort()
    beam = this.bench.beam
    this.bench.clock.sleep(1.0)
    assert this.bench.beam == beam
    assert (beam.x_rad, beam.y_rad) == pytest.approx((POINTS[5].x_rad, POINTS[5].y_rad), abs=5e-5)


def test_markers_are_none_where_they_are_not_wired(rig: Callable) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 3, [0, 1, 2], Trigger.CLOCK))
    assert this.counter.wait_points(3, 1.0).markers is None
