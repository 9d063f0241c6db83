"""The `tcspc488` driver point by point (scheme S1): what it sends, what it checks, what it refuses."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nlos.drivers.errors import (
    CommandRejected,
    DeviceNotFound,
    DeviceTimeout,
    LimitError,
    ProtocolError,
    SafetyTrip,
    WrongDevice,
)
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.tcspc.counter import HistogramAxis, HistogramFlag, PointGates, StopAtCounts
from nlos.drivers.tcspc.tcspc488.counter import open_tcspc488
from nlos.drivers.tcspc.tcspc488.messages import decode_rates
from nlos.drivers.tcspc.tcspc488.records import RecordHead, decode_record, encode_record, record_bytes
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings

NUMBERS = [5, 3, 70_000, 4, 1]


@pytest.mark.parametrize("answer", ["", "1e7", "1e7,50", "1e7:5,50,3", "nan,50,3", "1e7,-5,3", "1e7,inf,3", "1,2,3,4"])
def test_rates_that_are_no_rates_are_refused(answer: str) -> None:
    with pytest.raises(ProtocolError, match="INP:RATE"):
        decode_rates("tcspc488", answer)
    assert decode_rates("tcspc488", "1e7,50,3").detector_hz == 50


def scan(rig: object, dwell_s: float = 0.008) -> list:
    counter = rig.counter  # type: ignore[attr-defined]
    counter.arm(PointGates([dwell_s] * len(NUMBERS), NUMBERS))
    histograms = []
    for k in range(len(NUMBERS)):
        counter.trigger()
        counter.wait_points(k + 1, 1.0)
        histograms += counter.read(k, 1)
    return histograms


def test_points_come_back_with_their_own_counts_and_times(rig: Callable) -> None:
    this = rig()
    start_s = this.bench.clock.now()
    histograms = scan(this)
    assert this.bench.clock.now() - start_s == pytest.approx(5 * 0.008, rel=1e-6)
    for number, histogram in zip(NUMBERS, histograms, strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))
        assert histogram.counts.dtype == np.uint32
        assert histogram.live_time_s == pytest.approx(0.008)
        assert histogram.sync_count == 80_000
        assert histogram.total_count == number
        assert histogram.flags == HistogramFlag.NONE
        assert histogram.bin_width_s == 32e-12
    opened_s = [histogram.gate_opened_s for histogram in histograms]
    np.testing.assert_allclose(np.diff(opened_s), 0.008, rtol=1e-6)


def test_one_question_per_point_suffices(rig: Callable) -> None:
    this = rig()
    this.counter.arm(PointGates([0.008] * 3, [0, 1, 2]))
    this.wire.clear()
    this.counter.trigger()
    this.counter.wait_points(1, 1.0)
    this.counter.read(0, 1)
    sent = [data for _, way, data in this.wire if way == ">"]
    assert len(sent) == 3  # trigger, question, request for its answer
    assert sent[0][0] == 128
    assert b"ACQ:STAT?;:ACQ:DATA? 0,1;:SYST:ERR?" in sent[1]


def test_points_can_be_read_again_and_in_blocks(rig: Callable) -> None:
    this = rig()
    first = scan(this)
    again = this.counter.read(0, 5)
    for one, two in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.counts, two.counts)


def test_dwells_may_differ_from_point_to_point(rig: Callable) -> None:
    this = rig()
    dwells_s = [0.001, 0.02, 0.003]
    this.counter.arm(PointGates(dwells_s, [0, 1, 2]))
    for k in range(3):
        this.counter.trigger()
        this.counter.wait_points(k + 1, 1.0)
    assert [each.live_time_s for each in this.counter.read(0, 3)] == pytest.approx(dwells_s)


@pytest.mark.parametrize(("bins", "counts"), [(64, "u16"), (512, "u16"), (65536, "u32"), (65536, "u16")])
def test_both_formats_and_the_extreme_lengths(rig: Callable, bins: int, counts: str) -> None:
    this = rig(bins=bins, counts=counts)
    for number, histogram in zip(NUMBERS, scan(this), strict=True):
        expected = np.minimum(this.counts(number), 0xFFFF if counts == "u16" else 0xFFFFFFFF)
        np.testing.assert_array_equal(histogram.counts, expected)
        saturated = counts == "u16" and number > 0xFFFF
        assert (HistogramFlag.SATURATED in histogram.flags) == saturated


@pytest.mark.parametrize("packet_bytes", [64, 512, 1024])
def test_every_packet_size(rig: Callable, packet_bytes: int) -> None:
    this = rig(packet_bytes=packet_bytes, bins=111)
    for number, histogram in zip(NUMBERS, scan(this), strict=True):
        np.testing.assert_array_equal(histogram.counts, this.counts(number))


def test_what_cannot_be_set_exactly_is_refused_before_anything_is_sent(rig: Callable) -> None:
    counter = rig().counter
    good = HistogramAxis(512, 32e-12)
    for axis, dwell_s, words in [
        (HistogramAxis(63, 32e-12), 1e-3, "63 bins"),
        (HistogramAxis(70_000, 32e-12), 1e-3, "70000 bins"),
        (HistogramAxis(512, 30e-12), 1e-3, "power of two"),
        (HistogramAxis(512, 2e-12), 1e-3, "power of two"),
        (HistogramAxis(512, 32e-12, -1e-9), 1e-3, "offset"),
        (HistogramAxis(512, 32e-12, 0.5e-12), 1e-3, "offset"),
        (good, 0.0, "timed exactly"),
        (good, 11.0, "timed exactly"),
        (good, 1.5e-6, "timed exactly"),
    ]:
        with pytest.raises(LimitError, match=words):
            counter.check(axis, dwell_s)
    counter.check(good, 8e-3)
    for dwells_s, numbers in [([], []), ([1e-3], [1, 2]), ([1e-3] * 70_000, list(range(70_000)))]:
        with pytest.raises(LimitError, match="dwells"):
            counter.arm(PointGates(dwells_s, numbers))
    with pytest.raises(LimitError, match="cannot stop"):
        counter.configure(good, StopAtCounts(5, 10, 600))


def test_nothing_is_triggered_beyond_what_is_armed(rig: Callable) -> None:
    counter = rig().counter
    counter.arm(PointGates([1e-3], [0]))
    counter.trigger()
    with pytest.raises(CommandRejected, match="armed points"):
        counter.trigger()


def test_a_trigger_that_the_instrument_did_not_hear_ends_at_the_deadline(rig: Callable) -> None:
    this = rig()
    this.counter.arm(PointGates([1e-3] * 2, [0, 1]))
    this.firmware.trigger = lambda now_s: None
    this.counter.trigger()
    start_s = this.bench.clock.now()
    with pytest.raises(DeviceTimeout, match="0 of 1 points"):
        this.counter.wait_points(1, 0.5)
    assert this.bench.clock.now() - start_s == pytest.approx(0.5, rel=0.2)
    with pytest.raises(CommandRejected, match="not complete"):
        this.counter.read(0, 1)


def test_rates_are_waited_for(rig: Callable) -> None:
    rates = rig().counter.rates()
    assert rates.sync_hz == pytest.approx(10e6)
    assert rates.detector_hz == 0


def test_the_stop_window_reaches_the_light(rig: Callable) -> None:
    this = rig()
    this.counter.configure(HistogramAxis(512, 32e-12), StopAtCounts(25, 40, 60))
    this.counter.arm(PointGates([1e-3], [0]))
    this.counter.trigger()
    this.counter.wait_points(1, 1.0)
    gate = this.seen[-1][0]
    assert (gate.stop_counts, gate.stop_window) == (25, (40, 60))


def test_another_instrument_under_the_same_ids_is_refused(rig: Callable) -> None:
    this = rig()
    this.counter.close()
    this.firmware._parser._handlers["*IDN?"] = lambda argument: b"ACME,SCOPE,1,1"
    this.firmware._parser._found.clear()
    settings = Tcspc488Settings(model="tcspc488", usb="simulated")
    with pytest.raises(WrongDevice, match="ACME"):
        open_tcspc488(settings, this.bench.clock, this.usb)


def test_nothing_plugged_in_says_so(rig: Callable) -> None:
    this = rig()
    settings = Tcspc488Settings(model="tcspc488", usb="simulated")
    with pytest.raises(DeviceNotFound, match="plugged in"):
        open_tcspc488(settings, this.bench.clock, SimulatedUsb([], this.bench.clock))
    with pytest.raises(LimitError, match="bench file"):
        open_tcspc488(settings, this.bench.clock)


def test_closing_twice_and_after_an_unplug_is_quiet(rig: Callable) -> None:
    this = rig()
    this.usb.unplug("SIM0001")
    this.counter.close()
    this.counter.close()


def test_the_shutter_is_read_back_and_obeys_the_interlock(rig: Callable) -> None:
    this = rig()
    shutter = this.shutter
    shutter.open()
    assert this.bench.shutter_open
    assert shutter.state().feedback_open
    shutter.close()
    assert not this.bench.shutter_open
    this.bench.interlock_closed = False
    with pytest.raises(SafetyTrip, match="interlock"):
        shutter.open()


RECORDS = st.tuples(
    st.integers(0, 2**32 - 1), st.integers(0, 2**63), st.integers(0, 10**7), st.integers(0, 2**32 - 1),
    st.integers(0, 2**32 - 1), st.integers(0, 127), st.integers(64, 200), st.booleans(),
)  # fmt: skip


@given(RECORDS, st.randoms(use_true_random=False))
def test_a_record_comes_back_and_no_changed_bit_goes_unnoticed(record: tuple, random: object) -> None:
    number, opened_ns, live_us, total, syncs, flags, bins, wide = record
    counts = np.arange(bins, dtype=np.uint32)
    data = encode_record(RecordHead(number, opened_ns, live_us, total, syncs, flags), counts, wide)
    assert len(data) == record_bytes(bins, wide)
    axis = HistogramAxis(bins, 32e-12)
    histogram = decode_record(memoryview(data), number, axis, wide)
    np.testing.assert_array_equal(histogram.counts, counts)
    assert (histogram.total_count, histogram.sync_count, int(histogram.flags)) == (total, syncs, flags)
    spoilt = bytearray(data)
    spoilt[random.randrange(len(data))] ^= 1 << random.randrange(8)  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match=r"record"):
        decode_record(memoryview(bytes(spoilt)), number, axis, wide)
    with pytest.raises(ValueError, match=r"record"):
        decode_record(memoryview(data), number ^ 1, axis, wide)
