"""The `tcspc488` in T3 mode (scheme S3): the same photons as in histogram mode, one by one, and what losses cost."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nlos.drivers.errors import CommandRejected, LimitError, SafetyTrip, SyncLost
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.tcspc.counter import (
    CountRates,
    Histogram,
    HistogramAxis,
    HistogramFlag,
    PointGates,
    StopAtCounts,
    Trigger,
)

NUMBERS = list(range(100, 112))
DWELL_S = 0.004
BLANKING_S = 0.0004


def fault(times: int = 1, skip: int = 0, place: str = "records", **parameters: Any) -> Fault:
    return Fault(name="U20", times=times, skip=skip, parameters={"place": place, **parameters})


def take(this: Any, trigger: Trigger) -> list[Histogram]:
    this.counter.arm(PointGates([DWELL_S] * 12, NUMBERS, trigger, BLANKING_S if trigger is Trigger.CLOCK else 0.0))
    histograms = []
    for k in range(12):
        if trigger is Trigger.HOST:
            this.counter.trigger()
        this.counter.wait_points(k + 1, 1.0)
        histograms += this.counter.read(k, 1)
    return histograms


@pytest.mark.parametrize("trigger", [Trigger.HOST, Trigger.CLOCK])
def test_the_same_photons_as_in_histogram_mode(rig: Callable, trigger: Trigger) -> None:
    listed, counted = rig(mode="t3"), rig()
    listed.light["rate_hz"] = counted.light["rate_hz"] = 200e3
    for this in (listed, counted):
        this.shutter.open()
    for one, other in zip(take(listed, trigger), take(counted, trigger), strict=True):
        np.testing.assert_array_equal(one.counts, other.counts)
        assert one.total_count == other.total_count
        assert one.live_time_s == pytest.approx(other.live_time_s)
        assert one.sync_count == other.sync_count
        if trigger is Trigger.CLOCK:
            assert one.gate_opened_s == pytest.approx(other.gate_opened_s, abs=2e-7)
        assert one.flags == HistogramFlag.NONE


def test_it_says_that_it_lists_and_refuses_what_only_histogram_mode_can(rig: Callable) -> None:
    this = rig(mode="t3")
    assert this.counter.list_mode
    this.counter.configure(HistogramAxis(512, 32e-12), StopAtCounts(5, 0, 512))
    with pytest.raises(LimitError, match="histogram mode"):
        this.counter.arm(PointGates([DWELL_S], [0]))
    this.counter.configure(HistogramAxis(65536, 32e-12))
    with pytest.raises(LimitError, match="32768 bins"):
        this.counter.arm(PointGates([DWELL_S], [0]))


def test_points_that_are_not_complete_are_not_read(rig: Callable) -> None:
    this = rig(mode="t3")
    this.counter.arm(PointGates([DWELL_S] * 2, [0, 1]))
    with pytest.raises(CommandRejected, match="not complete"):
        this.counter.read(0, 1)


@pytest.mark.parametrize("what", ["marker_order", "overflow_one", "overflow_zero"])
def test_disorder_and_single_wraps_change_nothing(rig: Callable, what: str) -> None:
    this = rig(mode="t3")
    this.bench.faults.add(fault(99, what=what))
    for number, histogram in zip(NUMBERS, take(this, Trigger.CLOCK), strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))


LOSSES = {
    "FIFO full": fault(what="fifo_full", skip=5),
    "block cut short": fault(place="block", skip=5),
    "answer lost": Fault(name="U1", skip=5),
    "answer garbled": Fault(name="U5", skip=5),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_a_loss_flags_all_points_that_were_not_complete_and_no_other(rig: Callable, loss: str) -> None:
    this = rig(mode="t3")
    this.counter.arm(PointGates([DWELL_S] * 12, NUMBERS, Trigger.CLOCK))
    this.bench.faults.add(LOSSES[loss])
    for k in range(12):
        status = this.counter.wait_points(k + 1, 2.0)
    assert not status.running
    histograms = this.counter.read(0, 12)
    lost = [HistogramFlag.DATA_LOST in each.flags for each in histograms]
    assert 0 < sum(lost) < 12
    assert status.lost == sum(lost)
    for number, histogram in zip(NUMBERS, histograms, strict=True):
        if HistogramFlag.DATA_LOST in histogram.flags:
            assert histogram.live_time_s == 0
            assert not histogram.counts.any()
        else:
            np.testing.assert_array_equal(histogram.counts, this.counts(number))
    for number, histogram in zip(NUMBERS, take(this, Trigger.CLOCK), strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))


def test_records_that_a_cable_changed_are_no_photons(rig: Callable) -> None:
    """One bit of each block: a photon in another bin, or a wrap of time that never was."""
    this = rig(mode="t3")
    this.counter.arm(PointGates([DWELL_S] * 12, NUMBERS, Trigger.CLOCK))
    tags = this.firmware.acquisition.tags
    told = tags.take
    tags.take = lambda most, now_s: (
        bytes((data := bytearray(told(most, now_s)))[:-1]) + bytes([data[-1] ^ 4] if data else [])
    )
    for k in range(12):
        this.counter.wait_points(k + 1, 2.0)
    for number, histogram in zip(NUMBERS, this.counter.read(0, 12), strict=True):
        if HistogramFlag.DATA_LOST not in histogram.flags:
            np.testing.assert_array_equal(histogram.counts, this.counts(number))
    assert HistogramFlag.DATA_LOST in histogram.flags


def test_a_trip_is_seen_in_t3_mode_too(rig: Callable) -> None:
    this = rig(mode="t3")
    this.shutter.open()
    this.bench.faults.add(Fault(name="U14", skip=3, parameters={"cause": "interlock"}))
    with pytest.raises(SafetyTrip, match="interlock"):
        take(this, Trigger.CLOCK)
    assert not this.bench.shutter_open


def test_many_photons_take_several_blocks(rig: Callable) -> None:
    this = rig(mode="t3", over_count={"rate_hz": 0})
    this.light["rate_hz"] = 9e6
    this.shutter.open()
    this.counter.arm(PointGates([0.02] * 3, [0, 1, 2], Trigger.CLOCK))
    this.bench.clock.sleep(0.1)
    this.counter.wait_points(3, 1.0)
    assert [int(each.counts[0]) for each in this.counter.read(0, 3)] == [180_000] * 3


def test_without_laser_pulses_there_is_no_time(rig: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    this = rig(mode="t3")
    monkeypatch.setattr(this.counter, "rates", lambda: CountRates(0.0, 100.0))
    with pytest.raises(SyncLost, match="no sync signal"):
        this.counter.arm(PointGates([DWELL_S], [0]))


@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_a_divided_sync_is_told_as_the_laser_s_own(rig: Callable, mode: str) -> None:
    """Rates, pulses and times: the instrument reckons the pulses that its divider leaves out."""
    taken = []
    for divider in (1, 8):
        this = rig(mode=mode, sync={"divider": divider})
        this.light["rate_hz"] = 200e3
        this.shutter.open()
        assert (b"INP:SYNC:DIV %d" % divider) in b"".join(data for _, way, data in this.wire if way == ">")
        assert this.counter.rates().sync_hz == 10e6
        taken.append(take(this, Trigger.HOST))
    for whole, divided in zip(*taken, strict=True):
        np.testing.assert_array_equal(whole.counts, divided.counts)
        assert whole.sync_count == divided.sync_count == 40_000
