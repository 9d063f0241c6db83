"""What a Time Tagger is told before it measures, by the vendor's reference: in force, from a clean state, no more."""

from typing import Any

import numpy as np
import pytest

from nlos.drivers.errors import DeviceLost, DeviceNotFound, DeviceTimeout, LimitError, SyncLost
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.timetagger import measurements
from nlos.drivers.tcspc.counter import HistogramAxis, HistogramFlag, PointGates, Trigger
from nlos.drivers.tcspc.timetagger.counter import TimeTagger
from tests.drivers.tcspc.test_timetagger import ARRIVALS_PS, AXIS, WIDTH_PS, Replaced, rig, taken

SETTINGS = ("setConditionalFilter", "clearConditionalFilter", "setDelaySoftware", "setInputDelay", "setTriggerLevel")
BEGINS = ("startFor", "xtra_setAuxOut(1, True)")
MODES = ["histogram", "list"]


def stepped(
    bench: Any, counter: TimeTagger, points: int = 3, axis: HistogramAxis = AXIS, late_s: Any = (0.0,), blanking_s=0.002
) -> Any:
    """Points stepped by the instrument's own clock, as a mirror controller's markers tell of them, each so late."""
    steps = [0]

    def step(when_s: float) -> None:
        steps[0] += 1
        bench.edge(f"marker_{2 - steps[0] % 2}", when_s + late_s[steps[0] % len(late_s)])

    bench.wire("pixel_clock", step)
    counter.configure(axis)
    counter.arm(PointGates([0.02] * points, list(range(points)), Trigger.CLOCK, blanking_s))
    status = counter.wait_points(points, 2.0)
    return status, counter.read(0, points), steps


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("clocked", [False, True])
def test_nothing_is_measured_before_what_was_set_is_in_force(mode: str, clocked: bool) -> None:
    """`sync()` returns once it is; tags of before are still on their way until then."""
    said: list[str] = []
    package, settings, bench = rig(mode=mode, **({"pixel_clock": 1} if clocked else {}))
    counter = TimeTagger.open(settings, bench.clock, package, lambda device, way, data: said.append(data.decode()))
    stepped(bench, counter) if clocked else taken(counter, bench)
    pending = ""
    for call in said:
        if call.startswith(SETTINGS):
            pending = call
        elif call.startswith("sync"):
            pending = ""
        elif call.startswith(BEGINS):
            assert not pending, f"{call} after {pending}"
    assert any(call.startswith(BEGINS[clocked]) for call in said)
    if clocked:  # photons of before the first step are none of a scan's
        assert said.index("sync()", said.index("clear()")) < said.index("xtra_setAuxOut(1, True)")
    counter.close()


@pytest.mark.parametrize("mode", MODES)
def test_a_delay_that_another_program_left_moves_no_photon(mode: str) -> None:
    package, settings, bench = rig(mode=mode)
    other = package.createTimeTagger()
    other.setDelaySoftware(settings.detector.channel, 7_000)
    other.setDelaySoftware(settings.sync.channel, -3_000)
    package.freeTimeTagger(other)
    counter = TimeTagger.open(settings, bench.clock, package)
    seen = taken(counter, bench)[0]
    counter.close()
    assert np.flatnonzero(seen.counts).tolist() == [each // WIDTH_PS for each in ARRIVALS_PS]


@pytest.mark.parametrize("level_mv", [-2000, 2000])
def test_a_level_that_is_beyond_either_end_is_refused(level_mv: int) -> None:
    package, settings, bench = rig(sync={"channel": 1, "level_mv": level_mv})
    with pytest.raises(LimitError, match=f"input 1 takes no level of {level_mv} mV"):
        TimeTagger.open(settings, bench.clock, package)


def test_a_laser_that_is_off_is_a_lost_sync_and_no_division_by_it() -> None:
    package, settings, bench = rig(sync={"channel": 1, "level_mv": 1200})
    package._panel.laser_crosses = lambda: False
    counter = TimeTagger.open(settings, bench.clock, package)
    with pytest.raises(SyncLost, match="sees no sync signal"):
        taken(counter, bench)
    counter.close()


def test_a_rate_meter_that_never_ends_is_waited_for_no_longer_than_said(monkeypatch: pytest.MonkeyPatch) -> None:
    package, settings, bench = rig()
    counter = TimeTagger.open(settings, bench.clock, package)
    monkeypatch.setattr(measurements.Countrate, "isRunning", lambda self: True)
    began_s = bench.clock.now()
    with pytest.raises(DeviceTimeout, match="still counts"):
        counter.rates()
    assert bench.clock.now() - began_s < 1.0
    counter.close()


def test_a_connection_that_is_gone_is_called_so_and_another_instrument_is_not_taken() -> None:
    package, settings, bench = rig()

    def gone() -> int:
        raise RuntimeError("The Time Tagger is not connected any more")

    counter = TimeTagger.open(settings, bench.clock, Replaced(package, getOverflowsAndClear=gone))
    with pytest.raises(DeviceLost, match="not connected"):
        taken(counter, bench)
    counter.close()
    package, settings, bench = rig(serial="1234000ABC")
    with pytest.raises(DeviceNotFound, match=r"1234000ABC answers \(there is SIM2100001\)"):
        TimeTagger.open(settings, bench.clock, package)
    assert not package.held


@pytest.mark.parametrize("mode", MODES)
def test_tags_that_were_lost_before_a_sequence_are_none_of_its(mode: str) -> None:
    package, settings, bench = rig(mode=mode, pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    bench.faults.add(Fault(name="T1", after_s=bench.clock.now() + 0.01))  # while the laser's rate is measured
    _, seen, _ = stepped(bench, counter)
    counter.close()
    assert [each.flags for each in seen] == [HistogramFlag.NONE] * 3
    assert [each.live_time_s for each in seen] == [0.02] * 3
    assert all(each.total_count > 0 for each in seen)


@pytest.mark.parametrize("mode", MODES)
def test_its_clock_stands_still_once_its_points_are_taken_or_given_up(mode: str) -> None:
    package, settings, bench = rig(mode=mode, pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    _, _, steps = stepped(bench, counter)
    taken_with = steps[0]
    bench.clock.sleep(1.0)
    assert bench.shutter_open  # whatever runs by itself has come up to now
    assert steps[0] == taken_with
    counter.arm(PointGates([0.02] * 3, [0, 1, 2], Trigger.CLOCK, 0.002))
    bench.clock.sleep(0.03)
    counter.abort()
    given_up_with = steps[0]
    assert taken_with < given_up_with < taken_with + 3
    bench.clock.sleep(1.0)
    assert bench.shutter_open
    assert steps[0] == given_up_with
    counter.close()


@pytest.mark.parametrize("mode", MODES)
def test_as_many_points_as_a_period_has_bins_are_told_from_bins(mode: str) -> None:
    package, settings, bench = rig(mode=mode, pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    _, seen, _ = stepped(bench, counter, 8, axis=HistogramAxis(8, 12.5e-9))
    counter.close()
    assert [tuple(np.flatnonzero(each.counts)) for each in seen] == [(0, 7)] * 8


def test_a_filter_that_another_program_left_is_none_of_the_laser() -> None:
    package, settings, bench = rig()
    other = package.createTimeTagger()
    other.setConditionalFilter([settings.detector.channel], [settings.sync.channel])
    package.freeTimeTagger(other)
    counter = TimeTagger.open(settings, bench.clock, package)
    assert counter.rates().sync_hz == pytest.approx(10e6)
    counter.close()


@pytest.mark.parametrize("times_hz", [0.997, 1.003])
def test_photons_that_would_be_three_bins_off_by_the_lasers_drift_are_not_kept(times_hz: float) -> None:
    package, settings, bench = rig()
    counter = TimeTagger.open(settings, bench.clock, package)
    bench.faults.add(Fault(name="T4", after_s=bench.clock.now() + 0.11, parameters={"times_hz": times_hz}))
    with pytest.raises(SyncLost, match="when points began"):
        taken(counter, bench)
    counter.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("first", "bins", "kept"), [(0, 1500, 80), (900, 400, 40), (0, 20, 40)])
def test_a_window_of_any_length_has_all_its_bins_and_no_photon_twice(
    mode: str, first: int, bins: int, kept: int
) -> None:
    """Longer than the laser's period, beyond its end, and a short one: the total is that of the whole period."""
    package, settings, bench = rig(mode=mode)
    counter = TimeTagger.open(settings, bench.clock, package)
    counter.configure(HistogramAxis(bins, AXIS.bin_width_s, first * AXIS.bin_width_s))
    counter.arm(PointGates([0.004], [0]))
    counter.trigger()
    counter.wait_points(1, 1.0)
    (seen,) = counter.read(0, 1)
    counter.close()
    assert (len(seen.counts), int(seen.counts.sum()), seen.total_count) == (bins, kept, 80)


@pytest.mark.parametrize("mode", MODES)
def test_a_laser_that_drifts_while_its_clock_steps_is_a_lost_sync(mode: str) -> None:
    package, settings, bench = rig(mode=mode, pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    bench.faults.add(Fault(name="T4", after_s=bench.clock.now() + 0.13, parameters={"times_hz": 0.98}))
    with pytest.raises(SyncLost, match="when points began"):
        stepped(bench, counter)
    counter.close()


@pytest.mark.parametrize("mode", MODES)
def test_armed_anew_in_the_middle_of_a_sequence_its_clock_stands_still(mode: str) -> None:
    package, settings, bench = rig(mode=mode, pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    _, _, steps = stepped(bench, counter)
    counter.arm(PointGates([0.02] * 3, [0, 1, 2], Trigger.CLOCK, 0.002))
    bench.clock.sleep(0.03)
    seen = taken(counter, bench)
    given_up_with = steps[0]
    bench.clock.sleep(1.0)
    assert bench.shutter_open
    assert steps[0] == given_up_with
    assert [each.live_time_s for each in seen] == [0.004] * 3
    counter.close()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("late_s", [(0.0,), (8e-6, 0.0), (1e-7, 3e-6, 0.0, 9e-6)])
def test_points_without_blanking_keep_their_photons_whenever_steps_come(mode: str, late_s: tuple[float, ...]) -> None:
    """A mirror controller polls its trigger input: one step of two is early against the one before."""
    package, settings, bench = rig(mode=mode, pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    status, seen, _ = stepped(bench, counter, 12, late_s=late_s, blanking_s=0.0)
    counter.close()
    assert (status.markers, status.steps_due, status.lost) == (12, 12, 0)
    assert [each.flags for each in seen] == [HistogramFlag.NONE] * 12
    for each in seen:
        assert 0.998 * 0.02 <= each.live_time_s <= 0.02
        assert each.total_count > 200


def test_tags_that_the_stream_misses_while_the_clock_steps_are_lost_to_the_points_under_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    package, settings, bench = rig(mode="list", pixel_clock=1)
    counter = TimeTagger.open(settings, bench.clock, package)
    reads = [0]

    def kinds(buffer: measurements.TagBuffer) -> Any:
        found = np.zeros(len(buffer.getTimestamps()), np.uint8)
        reads[0] += len(found) > 0
        found[:1] = reads[0] == 1  # not a tag: an overflow begins, or ends, or so many were missed
        return found

    monkeypatch.setattr(measurements.TagBuffer, "getEventTypes", kinds)
    _, seen, _ = stepped(bench, counter)
    counter.close()
    assert [HistogramFlag.DATA_LOST in each.flags for each in seen].count(True) > 0
    assert all(HistogramFlag.DATA_LOST in each.flags or each.total_count > 0 for each in seen)
