"""Faults U11 to U19 between a `tcspc488` and its driver: what is raised, what is kept, what is repaired."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from nlos.drivers.errors import (
    CommandRejected,
    DataCorrupt,
    DeviceBusy,
    DeviceError,
    DeviceLost,
    DeviceReset,
    ProtocolError,
    SafetyTrip,
    SyncLost,
    WrongDevice,
)
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag, PointGates, Trigger
from nlos.drivers.tcspc.tcspc488.counter import open_tcspc488
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings

NUMBERS = list(range(10, 20))


def fault(name: str, times: int = 1, skip: int = 0, **parameters: Any) -> Fault:
    return Fault(name=name, times=times, skip=skip, parameters=parameters)


def take(this: Any, first: int = 0, last: int = 10) -> list[Histogram]:
    histograms = []
    for k in range(first, last):
        this.counter.trigger()
        this.counter.wait_points(k + 1, 1.0)
        histograms += this.counter.read(k, 1)
    return histograms


def take_all(this: Any, trigger: Trigger) -> None:
    if trigger is Trigger.HOST:
        take(this)
    else:
        this.counter.wait_points(10, 1.0)


def check(this: Any, histograms: list[Histogram]) -> None:
    for number, histogram in zip(NUMBERS, histograms, strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))
        assert HistogramFlag.DATA_LOST not in histogram.flags


HARMLESS = {
    "U1": fault("U1"),
    "U2": fault("U2"),
    "U3 in": fault("U3", place="in"),
    "U3 out": fault("U3", place="out", skip=1),
    "U5": fault("U5", field="tag"),
    "U6 split": fault("U6", times=99, what="split", size=7),
    "U6 cut": fault("U6", what="cut"),
    "U6 early end": fault("U6", what="early_end"),
    "U7": fault("U7", times=99),
    "U8": fault("U8", times=9, bytes=3),
    "U10": fault("U10"),
    **{f"U12 {what}": fault("U12", what=what) for what in
       ("crc", "magic", "number", "duplicate", "header", "length", "indefinite")},
    "U16": fault("U16", times=99),
    "U19": fault("U19", times=999, delay_s=0.005),
}  # fmt: skip


@pytest.mark.parametrize("name", HARMLESS)
@pytest.mark.parametrize("skip", [0, 4])
def test_what_can_be_asked_again_is_and_the_counts_are_right(rig: Callable, name: str, skip: int) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    one = HARMLESS[name]
    this.bench.faults.add(one.model_copy(update={"skip": one.skip + skip}))
    try:
        histograms = take(this)
    except DeviceError:
        assert name == "U3 out"  # a trigger that was refused is not sent twice: that might open two gates
        return
    check(this, histograms)


@pytest.mark.parametrize("what", ["crc", "magic", "number", "duplicate"])
def test_a_record_damaged_twice_is_flagged_and_the_scan_goes_on(rig: Callable, what: str) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    this.bench.faults.add(fault("U12", times=2, skip=3, what=what))
    histograms = take(this)
    assert histograms[3].flags == HistogramFlag.DATA_LOST
    assert histograms[3].live_time_s == 0
    assert not histograms[3].counts.any()
    del histograms[3]
    for number, histogram in zip([10, 11, 12, 14, 15, 16, 17, 18, 19], histograms, strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))


def test_a_block_that_stays_unreadable_is_data_corrupt(rig: Callable) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    this.bench.faults.add(fault("U12", times=99, what="header"))
    with pytest.raises(DataCorrupt):
        take(this)


@pytest.mark.parametrize("place", ["read", "write"])
@pytest.mark.parametrize("skip", [0, 1, 2, 5])
def test_a_pulled_cable_keeps_what_was_read_and_the_instrument_opens_again(
    rig: Callable, place: str, skip: int
) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    kept = take(this, 0, 3)
    this.bench.faults.add(fault("U11", skip=skip, place=place, replug_after_s=0.5))
    with pytest.raises(DeviceLost, match="cable"):
        kept += take(this, 3)
    this.counter.close()
    this.bench.clock.sleep(1.0)
    again = open_tcspc488(Tcspc488Settings(model="tcspc488", usb="SIM0001"), this.bench.clock, this.usb)
    again.configure(HistogramAxis(512, 32e-12))
    left = NUMBERS[len(kept) :]
    again.arm(PointGates([0.002] * len(left), left))
    this.counter = again
    kept += take(this, 0, len(left))
    check(this, kept)


def test_a_queued_error_is_reported_by_the_next_command(rig: Callable) -> None:
    this = rig()
    this.bench.faults.add(fault("U13", errors=1, code=-222))
    with pytest.raises(CommandRejected, match="-222 Data out of range"):
        this.counter.abort()
    this.counter.abort()
    this.bench.faults.add(fault("U13", errors=20, code=-200))
    with pytest.raises(CommandRejected, match="-350 Queue overflow"):
        this.counter.abort()
    this.counter.abort()


CAUSES = {"over_count": (SafetyTrip, "rate"), "interlock": (SafetyTrip, "interlock"), "sync": (SyncLost, "sync"),
          "watchdog": (SafetyTrip, "watchdog")}  # fmt: skip


@pytest.mark.parametrize("cause", CAUSES)
@pytest.mark.parametrize("trigger", [Trigger.HOST, Trigger.CLOCK])
def test_a_trip_shuts_the_light_and_stays_until_it_is_cleared(rig: Callable, cause: str, trigger: Trigger) -> None:
    this = rig()
    error, words = CAUSES[cause]
    this.shutter.open()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS, trigger))
    this.bench.faults.add(fault("U14", skip=4, cause=cause))
    with pytest.raises(error, match=words):
        take_all(this, trigger)
    assert not this.bench.shutter_open
    np.testing.assert_array_equal(this.counter.read(3, 1)[0].counts, this.counts(13))
    with pytest.raises(SafetyTrip):
        this.shutter.open()
    with pytest.raises(SafetyTrip):
        this.counter.arm(PointGates([0.002], [0]))
    this.counter.clear_trip()
    this.shutter.open()
    assert this.bench.shutter_open
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    check(this, take(this))


def test_too_much_light_trips_within_its_time(rig: Callable) -> None:
    this = rig(over_count={"rate_hz": 1_000_000, "time_ms": 10})
    this.shutter.open()
    this.counter.arm(PointGates([0.004] * 100, list(range(100)), Trigger.CLOCK))
    this.counter.wait_points(20, 1.0)
    this.light["rate_hz"] = 2e6
    start_s = this.bench.clock.now()
    with pytest.raises(SafetyTrip, match="rate"):
        this.counter.wait_points(100, 1.0)
    assert this.bench.clock.now() - start_s <= 0.02


def test_the_interlock_shuts_the_light_at_once(rig: Callable) -> None:
    this = rig()
    this.shutter.open()
    this.counter.arm(PointGates([0.1] * 3, [0, 1, 2]))
    this.counter.trigger()
    this.bench.interlock_closed = False
    start_s = this.bench.clock.now()
    with pytest.raises(SafetyTrip, match="interlock"):
        this.counter.wait_points(1, 1.0)
    assert this.bench.clock.now() - start_s <= 0.02
    assert not this.bench.shutter_open


def test_the_watchdog_shuts_the_light_of_a_host_that_fell_silent(rig: Callable) -> None:
    this = rig()
    this.counter.arm_watchdog(0.5)
    this.shutter.open()
    this.bench.clock.sleep(0.6)
    with pytest.raises(SafetyTrip, match="watchdog"):
        this.counter.kick()
    assert not this.bench.shutter_open


@pytest.mark.parametrize("dwell_s", [0.008, 0.3, 3.0])
@pytest.mark.parametrize("trigger", [Trigger.HOST, Trigger.CLOCK])
def test_waiting_kicks_the_watchdog(rig: Callable, dwell_s: float, trigger: Trigger) -> None:
    this = rig()
    this.counter.arm_watchdog(0.2)
    this.shutter.open()
    this.counter.arm(PointGates([dwell_s] * 2, [0, 1], trigger))
    for k in range(2):
        if trigger is Trigger.HOST:
            this.counter.trigger()
        this.counter.wait_points(k + 1, 10.0)
    assert this.bench.shutter_open


def test_a_trip_is_seen_and_answered_while_a_long_block_is_read(rig: Callable) -> None:
    this = rig(latency_s=0.00025, bytes_per_s=25e6)
    this.shutter.open()
    this.counter.arm(PointGates([0.001] * 2000, list(range(2000)), Trigger.CLOCK))
    this.counter.wait_points(1500, 3.0)
    start_s = this.bench.clock.now()
    this.bench.faults.add(Fault(name="U14", after_s=start_s + 0.03, parameters={"cause": "over_count"}))
    this.wire.clear()
    with pytest.raises(SafetyTrip):
        this.counter.read(0, 1500)
    tripped_s = start_s + 0.03
    commands_s = [when_s for when_s, way, data in this.wire if way == ">" and b"OUTP:SHUT CLOS" in data]
    assert tripped_s <= commands_s[0] <= tripped_s + 0.02
    assert max(len(data) for _, way, data in this.wire if way == "<") <= 256 * 1024 + 1024
    assert len(this.counter.read(0, 1500)) == 1500


@pytest.mark.parametrize(("what", "flag"), [
    ("missed", HistogramFlag.TRIGGER_MISSED), ("late", HistogramFlag.TRIGGER_LATE), ("overrun", HistogramFlag.OVERRUN),
])  # fmt: skip
def test_trigger_and_slot_faults_are_flags_of_their_points(rig: Callable, what: str, flag: HistogramFlag) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    this.bench.faults.add(fault("U15", skip=6, what=what))
    histograms = take(this)
    assert [k for k, each in enumerate(histograms) if each.flags] == [6]
    assert histograms[6].flags == flag


def test_points_overwritten_before_they_were_read_come_back_empty_and_flagged(rig: Callable) -> None:
    this = rig(bins=64, over_count={"rate_hz": 0})
    this.counter.arm(PointGates([10e-6] * 4200, list(range(4200)), Trigger.CLOCK))
    status = this.counter.wait_points(4200, 1.0)
    assert status.lost == 104
    histograms = this.counter.read(0, 200)
    lost = HistogramFlag.DATA_LOST | HistogramFlag.OVERRUN
    assert [each.flags for each in histograms[:104]] == [lost] * 104
    assert [each.counts.sum() for each in histograms[104:]] == list(range(104, 200))


@pytest.mark.parametrize(("what", "error"), [
    ("busy", DeviceBusy), ("access", DeviceBusy),
])  # fmt: skip
def test_an_instrument_that_may_not_be_opened_says_so(rig: Callable, what: str, error: type[DeviceError]) -> None:
    this = rig()
    this.counter.close()
    this.bench.faults.add(fault("U17", what=what))
    with pytest.raises(error):
        open_tcspc488(Tcspc488Settings(model="tcspc488", usb="simulated"), this.bench.clock, this.usb)


def test_an_instrument_that_restarted_between_scans_gets_its_settings_back(rig: Callable) -> None:
    this = rig()
    this.bench.faults.add(fault("U18"))
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    check(this, take(this))
    assert "restarted" in this.counter.warnings[0]


def test_an_instrument_that_restarted_between_scans_watches_over_the_light_again(rig: Callable) -> None:
    this = rig()
    this.counter.arm_watchdog(0.5)
    this.bench.faults.add(fault("U18"))
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    this.shutter.open()
    this.bench.clock.sleep(0.6)
    assert not this.bench.shutter_open


@pytest.mark.parametrize("kept", [b"0", b"5"])
def test_a_watchdog_that_was_not_set_as_asked_is_noticed(rig: Callable, kept: bytes) -> None:
    this = rig()
    handler = this.firmware._parser._handlers["SYST:WDOG"]
    this.firmware._parser._handlers["SYST:WDOG"] = lambda argument: handler(kept)
    this.firmware._parser._found.clear()
    with pytest.raises(ProtocolError, match=r"watchdog was set to 0\.5 s and says"):
        this.counter.arm_watchdog(0.5)


def test_a_restart_that_closed_the_shutter_stops_the_scan(rig: Callable) -> None:
    this = rig()
    this.shutter.open()
    this.bench.faults.add(fault("U18"))
    with pytest.raises(DeviceReset, match="shutter"):
        this.counter.arm(PointGates([0.002] * 10, NUMBERS))


def test_an_instrument_that_comes_back_as_another_is_refused(rig: Callable) -> None:
    this = rig()
    this.bench.faults.add(fault("U18", new_identity=True))
    with pytest.raises(WrongDevice):
        this.counter.arm(PointGates([0.002] * 10, NUMBERS))


@pytest.mark.parametrize("trigger", [Trigger.HOST, Trigger.CLOCK])
def test_a_restart_during_a_scan_is_device_reset(rig: Callable, trigger: Trigger) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS, trigger))
    this.bench.faults.add(fault("U18", skip=3 if trigger is Trigger.HOST else 0))
    with pytest.raises(DeviceReset):
        take_all(this, trigger)


def test_garbled_settings_are_noticed_before_the_gate_opens(rig: Callable) -> None:
    this = rig()
    handler = this.firmware._parser._handlers["ACQ:DWEL"]
    this.firmware._parser._handlers["ACQ:DWEL"] = lambda argument: handler(b"9999")
    this.firmware._parser._found.clear()
    with pytest.raises(DeviceReset, match="ACQ:DWEL"):
        this.counter.arm(PointGates([0.002] * 10, NUMBERS))


@pytest.mark.parametrize("header", ["ACQ:NUMB:LIST", "ACQ:DWEL:LIST"])
def test_a_list_that_was_not_kept_is_noticed_before_the_gate_opens(rig: Callable, header: str) -> None:
    this = rig()
    this.firmware._parser._handlers[header] = lambda argument: None
    this.firmware._parser._found.clear()
    with pytest.raises(DeviceReset, match=header):
        this.counter.arm(PointGates([0.002, 0.003], NUMBERS[:2]))


def test_an_unknown_state_is_a_protocol_error(rig: Callable) -> None:
    this = rig()
    this.counter.arm(PointGates([0.002] * 10, NUMBERS))
    this.firmware._parser._handlers["ACQ:STAT?"] = lambda argument: b"PARTY,1,2,3,4"
    this.firmware._parser._found.clear()
    with pytest.raises(ProtocolError, match="PARTY"):
        take(this)
