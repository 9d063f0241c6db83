"""The PicoQuant adapter against a stand-in library with the vendor's calls, in both modes, on all three instruments."""

import ctypes
import functools
import threading
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.clock import VirtualClock
from nlos.drivers.errors import (
    CommandRejected,
    DeviceBusy,
    DeviceFault,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    LimitError,
    SyncLost,
    WrongDevice,
)
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.bench import Gate, SimulatedBench
from nlos.drivers.simulated.faults import Fault, FaultPlan
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.tcspc.counter import (
    Histogram,
    HistogramAxis,
    HistogramFlag,
    PointGates,
    StopAtCounts,
    Trigger,
)
from nlos.drivers.tcspc.picoquant import library
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import FAMILIES, PicoquantSettings
from nlos.drivers.tcspc.picoquant.histogram import Picoquant
from nlos.drivers.tcspc.picoquant.library import VendorLibrary, load_library
from nlos.drivers.tcspc.picoquant.setup import axis_codes

AXES = {
    "picoharp300": HistogramAxis(512, 32e-12, 8e-9),
    "hydraharp400": HistogramAxis(512, 32e-12, 8e-9),
    "multiharp150": HistogramAxis(512, 40e-12, 8e-9),
}


def table(*faults: Fault, direct_cps: float = 1e5) -> SimulatedBench:
    detector = DetectorSettings(dead_time_ns=0.0)
    light = SceneLight(SceneSettings(direct_cps=direct_cps), detector, BeamPath(2.0), 10e6, seed=3)
    bench = SimulatedBench(light, faults=FaultPlan(faults))
    bench.set_shutter(True)
    return bench


def settings(device: str, **more: Any) -> PicoquantSettings:
    return PicoquantSettings.model_validate({"model": "picoquant", "device": device, "library": "simulated", **more})


def opened(device: str, *faults: Fault, mode: str = "histogram", **more: Any) -> tuple[Picoquant, SimulatedBench]:
    bench = table(*faults)
    counter = open_picoquant(settings(device, mode=mode, **more), bench.clock, PicoquantLibrary(bench, device, 10e6))
    counter.configure(AXES[device])
    return counter, bench


# What the sync input takes behind its divider: SetSyncDiv in the manuals of PHLib, HHLib and MHLib, version 3.
@pytest.mark.parametrize("mode", ["histogram", "t3"])
@pytest.mark.parametrize(
    ("device", "sync_hz", "fits", "misfits"),
    [
        ("picoharp300", 0.1e6, [1], [2, 8]), ("picoharp300", 10e6, [1, 2, 4, 8], []),
        ("picoharp300", 40e6, [4, 8], [1, 2]), ("picoharp300", 78e6, [8], [1, 2, 4]),
        ("hydraharp400", 0.9e6, [1], [2]), ("hydraharp400", 1e6, [1, 16], []),
        ("hydraharp400", 40e6, [4, 8, 16], [1, 2]), ("hydraharp400", 80e6, [8, 16], [4]),
        ("multiharp150", 40e6, [1, 16], []), ("multiharp150", 80e6, [2], [1]), ("multiharp150", 0.1e6, [1], [16]),
    ],
)  # fmt: skip
def test_a_laser_that_does_not_go_with_the_sync_divider_is_refused_in_the_dark(
    device: str, sync_hz: float, fits: list[int], misfits: list[int], mode: str
) -> None:
    for divider in (*fits, *misfits):
        bench = table()
        library = PicoquantLibrary(bench, device, sync_hz)
        counter = open_picoquant(settings(device, mode=mode, sync_divider=divider), bench.clock, library)
        if divider in fits:
            counter.configure(AXES[device])
            counter.arm(PointGates([8e-3], [0]))
            assert counter.rates().sync_hz == sync_hz
        else:
            with pytest.raises(LimitError, match=f"{sync_hz / 1e6:.6g} MHz.*sync_divider {divider}"):
                counter.configure(AXES[device])
        counter.close()


def one_by_one(counter: Picoquant, points: int = 3) -> list[Histogram]:
    counter.arm(PointGates([8e-3] * points, list(range(points))))
    for point in range(points):
        counter.trigger()
        assert counter.wait_points(point + 1, 1.0).points_done == point + 1
    return counter.read(0, points)


@pytest.mark.parametrize("device", FAMILIES)
def test_a_histogram_holds_what_the_detector_saw(device: str) -> None:
    counter, bench = opened(device)
    histogram = one_by_one(counter)[1]
    axis = AXES[device]
    length = 65536 if device == "picoharp300" else 4096 if device == "multiharp150" else 1024
    expected = bench.expose(Gate(0.0, 8e-3, length, axis.bin_width_s, axis.offset_s, turn=1))
    assert (histogram.counts == expected.counts[:512]).all()
    assert histogram.total_count == expected.counts.sum()
    assert histogram.live_time_s == pytest.approx(8e-3)
    assert histogram.sync_count == 80_000
    assert counter.rates().detector_hz == pytest.approx(1e5, rel=0.1)
    counter.close()
    counter.close()


@pytest.mark.parametrize("device", FAMILIES)
def test_a_point_in_list_mode_holds_as_many_photons_as_in_histogram_mode(device: str) -> None:
    counter, _ = opened(device, mode="t3")
    histogram = one_by_one(counter)[2]
    assert histogram.total_count == pytest.approx(800, abs=150)
    assert histogram.counts.argmax() == pytest.approx((4.0 / 299792458.0 - 8e-9) / AXES[device].bin_width_s, abs=2)
    assert histogram.counts.sum() > 700


@pytest.mark.parametrize("device", FAMILIES)
def test_too_long_a_wait_stops_the_measurement(device: str) -> None:
    counter, _ = opened(device)
    counter.arm(PointGates([1.0], [0]))
    counter.trigger()
    with pytest.raises(DeviceTimeout, match="0 of 1"):
        counter.wait_points(1, 0.1)
    assert one_by_one(counter)[0].total_count > 0


def clocked(counter: Picoquant, bench: SimulatedBench, points: int) -> list[Histogram]:
    """Steps a mirror that marks its steps on marker inputs 1 and 2 alternately and needs 0.3 ms to settle."""
    steps: list[float] = []

    def step(when_s: float) -> None:
        place = len(steps)
        steps.append(when_s)
        bench.steer(MirrorAngles(0.01 * (place % points), 0.0), when_s, 3e-4)
        bench.edge(f"marker_{1 + place % 2}", when_s)

    bench.wire("pixel_clock", step)
    counter.arm(PointGates([8e-3] * points, list(range(points)), Trigger.CLOCK, blanking_s=4e-4))
    status = counter.wait_points(points, 5.0)
    assert status.points_done == points
    assert not status.running
    return counter.read(0, points)


def test_a_clocked_scan_sorts_photons_by_the_mirrors_markers() -> None:
    counter, bench = opened("multiharp150", mode="t3")
    histograms = clocked(counter, bench, 12)
    for point, histogram in enumerate(histograms):
        range_m = 2.0 / np.cos(0.01 * point)
        assert histogram.counts.argmax() == pytest.approx((2 * range_m / 299792458.0 - 8e-9) / 40e-12, abs=2)
        assert histogram.total_count == pytest.approx(800, abs=150)
        assert histogram.live_time_s == 8e-3
        assert histogram.gate_opened_s == pytest.approx(4e-4 + 8.4e-3 * point, abs=1e-6)
    assert counter.wait_points(12, 0.1).markers == 12
    again, other = opened("multiharp150", mode="t3")
    assert all((a.counts == b.counts).all() for a, b in zip(clocked(again, other, 12), histograms, strict=True))


def test_a_marker_that_stands_late_in_the_stream_changes_nothing() -> None:
    straight = clocked(*opened("multiharp150", mode="t3"), points=6)
    late = clocked(
        *opened("multiharp150", Fault(name="U20", skip=2, times=3, parameters={"late_pulses": 300}), mode="t3"),
        points=6,
    )
    assert all((a.counts == b.counts).all() for a, b in zip(straight, late, strict=True))


def test_a_missing_marker_is_seen_in_the_count() -> None:
    counter, bench = opened("multiharp150", mode="t3")
    steps: list[float] = []

    def step(when_s: float) -> None:
        steps.append(when_s)
        if len(steps) != 4:
            bench.edge(f"marker_{1 + len(steps) % 2}", when_s)

    bench.wire("pixel_clock", step)
    counter.arm(PointGates([2e-3] * 8, list(range(8)), Trigger.CLOCK, blanking_s=4e-4))
    assert counter.wait_points(8, 5.0).markers == 7


def test_a_full_fifo_ends_the_segment_and_flags_what_is_missing() -> None:
    counter, bench = opened("multiharp150", Fault(name="V2", after_s=0.65), mode="t3")
    histograms = clocked(counter, bench, 12)
    lost = [bool(histogram.flags & HistogramFlag.DATA_LOST) for histogram in histograms]
    assert lost == sorted(lost)
    assert lost[-1]
    assert not lost[0]
    gone = [histogram for histogram, is_gone in zip(histograms, lost, strict=True) if is_gone]
    assert all((each.live_time_s, each.total_count, each.counts.sum()) == (0, 0, 0) for each in gone)  # no rate of them


@pytest.mark.parametrize("device", FAMILIES)
def test_a_point_started_by_the_host_that_lost_photons_has_no_counts_and_no_live_time(device: str) -> None:
    counter, _ = opened(device, Fault(name="V2"), mode="t3")
    histograms = one_by_one(counter)
    lost = [HistogramFlag.DATA_LOST in each.flags for each in histograms]
    assert any(lost)
    assert not all(lost)
    for each, gone in zip(histograms, lost, strict=True):
        assert (each.live_time_s > 0, each.sync_count > 0, each.total_count > 0, each.counts.any()) == (not gone,) * 4


@pytest.mark.parametrize("mode", ["histogram", "t3"])
@pytest.mark.parametrize("device", FAMILIES)
def test_a_lost_sync_and_a_system_error_end_the_scan(device: str, mode: str) -> None:
    """The PicoHarp has no flag for the first: its rate meter tells, within 100 ms."""
    for fault, error in (("V3", SyncLost), ("V4", DeviceFault)):
        counter, _ = opened(device, Fault(name=fault), mode=mode)
        with pytest.raises(error):
            one_by_one(counter, 30)


@pytest.mark.parametrize("missing", ["GetLibraryVersion", "SetSyncDiv", "GetFlags"])
def test_a_library_without_a_function_is_another_one(missing: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(PicoquantLibrary, f"_{missing}")
    with pytest.raises(WrongDevice, match=rf"has no MH_{missing}: .* Install MultiHarp software"):
        one_by_one(opened("multiharp150")[0])


def test_a_zero_crossing_that_the_instrument_lacks_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"detector\.zero_cross_mv 30 is above 20 mV of a PicoHarp 300"):
        settings("picoharp300", detector={"zero_cross_mv": 30})
    assert settings("hydraharp400", detector={"zero_cross_mv": 30}).detector.zero_cross_mv == 30


@pytest.mark.parametrize(
    ("device", "given", "why"),
    [
        ("picoharp300", {"input": 2}, "input 2: a PicoHarp 300 has input 1 alone"),
        ("picoharp300", {"detector": {"offset_ps": 500}}, "moves its sync alone; set sync.offset_ps"),
        ("hydraharp400", {"sync": {"edge": "rising"}}, "sync.edge rising: the discriminators .* take negative pulses"),
        ("multiharp150", {"detector": {"zero_cross_mv": 5}}, "detector.zero_cross_mv: .* has edge triggers"),
    ],
)
def test_a_setting_that_no_call_would_take_is_refused(device: str, given: dict[str, Any], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        settings(device, **given)
    assert settings(device, **settings(device).model_dump(exclude={"model", "device", "library"})) == settings(device)


def test_a_library_that_hangs_as_it_lets_go_is_left_to_itself(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    goes_on = threading.Event()
    monkeypatch.setattr(library, "_CLOSES_WITHIN_S", 0.05)
    monkeypatch.setattr(PicoquantLibrary, "_CloseDevice", lambda *_: int(goes_on.wait(60)) - 1)
    counter, _ = opened("multiharp150")
    counter.close()
    assert not goes_on.is_set()
    assert "MH_CloseDevice hangs and is waited for no more" in caplog.text
    goes_on.set()


def test_a_transient_usb_error_is_tried_again_once_where_that_is_harmless() -> None:
    place = {"place": "GetHistogram", "code": -37}
    counter, _ = opened("picoharp300", Fault(name="V1", skip=1, parameters=place))
    assert len(one_by_one(counter)) == 3
    counter, _ = opened("picoharp300", Fault(name="V1", times=2, parameters=place))
    with pytest.raises(DeviceLost, match="USB_BULKRD_FAIL"):
        one_by_one(counter)


@pytest.mark.parametrize(("device", "call"), [("picoharp300", "StartMeas"), ("multiharp150", "ReadFiFo")])
def test_starting_and_reading_the_fifo_are_never_repeated(device: str, call: str) -> None:
    calls: list[bytes] = []
    bench = table(Fault(name="V1", parameters={"place": call, "code": -36}))
    counter = open_picoquant(
        settings(device, mode="t3"),
        bench.clock,
        PicoquantLibrary(bench, device, 10e6),
        lambda _device, way, data: calls.append(data) if way == ">" else None,
    )
    counter.configure(AXES[device])
    with pytest.raises(DeviceLost, match="VCMD"):
        one_by_one(counter, 1)
    assert sum(f"_{call}(".encode() in data for data in calls) == 1


def test_an_absent_library_says_what_to_install_and_where() -> None:
    for family in FAMILIES.values():
        with pytest.raises(DeviceNotFound, match=family.linux_library) as raised:
            load_library("picoquant", family, "vendor")
        assert family.package in raised.value.remedy
        assert "library" in raised.value.remedy
    with pytest.raises(DeviceNotFound, match="nowhere"):
        open_picoquant(settings("multiharp150", library="/nowhere/lib.so"), VirtualClock())


@pytest.mark.parametrize("device", FAMILIES)
@pytest.mark.parametrize("version", ["2.0", "3.0", "3.1", "4.0", "5.0", ""])
def test_versions_of_the_library_that_are_known_are_taken_and_no_other(device: str, version: str) -> None:
    bench = table()
    library = PicoquantLibrary(bench, device, 10e6, version=version)
    if version[:1] == "3" or (version, device) == ("4.0", "multiharp150"):
        open_picoquant(settings(device), bench.clock, library).close()
        return
    with pytest.raises(WrongDevice, match=f"version '{version}'"):
        open_picoquant(settings(device), bench.clock, library)


def test_a_serial_number_may_have_31_characters() -> None:
    bench = table()
    library = PicoquantLibrary(bench, "multiharp150", 10e6, serial="1" * 31)
    counter = open_picoquant(settings("multiharp150"), bench.clock, library)
    assert counter.identity.serial == "1" * 31
    with pytest.raises(MemoryError, match="MH_OpenDevice writes 32 bytes into a buffer of 16"):
        library.MH_OpenDevice(0, ctypes.create_string_buffer(16))


@pytest.mark.parametrize("device", FAMILIES)
@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_a_nim_detector_is_seen_as_the_inputs_come(device: str, mode: str) -> None:
    counter, _ = opened(device, mode=mode)
    assert counter.rates().sync_hz == 10e6
    assert counter.rates().detector_hz > 5e4
    assert one_by_one(counter)[0].total_count > 500


@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_ttl_behind_an_attenuator_is_seen_at_300_mv_and_not_at_1000(mode: str) -> None:
    rising = {"level_mv": 300, "edge": "rising"}
    counter, _ = opened("multiharp150", mode=mode, sync=rising, detector=rising)
    assert counter.rates().sync_hz == 10e6
    assert one_by_one(counter)[0].total_count > 500
    counter, _ = opened("multiharp150", mode=mode, detector={"level_mv": 1000, "edge": "rising"})
    assert counter.rates().detector_hz == 0


@pytest.mark.parametrize("device", FAMILIES)
@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_a_level_that_no_pulse_reaches_counts_nothing(device: str, mode: str) -> None:
    beyond = {"level_mv": 100 if device == "multiharp150" else 800}
    counter, _ = opened(device, mode=mode, detector=beyond)
    assert counter.rates().detector_hz == 0
    assert one_by_one(counter)[0].total_count == 0
    counter, _ = opened(device, mode=mode, sync=beyond)
    with pytest.raises(SyncLost, match="no sync signal"):
        one_by_one(counter)


@pytest.mark.parametrize(("device", "level_mv"), [("picoharp300", -50), ("picoharp300", 801), ("hydraharp400", 1001)])
def test_a_level_that_the_instrument_lacks_is_refused(device: str, level_mv: int) -> None:
    with pytest.raises(ValidationError, match=f"detector.level_mv {level_mv} is outside 0 to"):
        settings(device, detector={"level_mv": level_mv})


def test_the_instrument_is_found_by_its_serial_number_or_not_at_all() -> None:
    bench = table()
    library = PicoquantLibrary(bench, "multiharp150", 10e6, serial="1050007")
    with pytest.raises(DeviceNotFound, match="there is 1050007"):
        open_picoquant(settings("multiharp150", serial="1050008"), bench.clock, library)
    counter = open_picoquant(settings("multiharp150", serial="1050007"), bench.clock, library)
    assert counter.identity.serial == "1050007"
    with pytest.raises(DeviceBusy, match="LOCKED"):
        open_picoquant(settings("multiharp150"), bench.clock, library)
    counter.close()
    open_picoquant(settings("multiharp150"), bench.clock, library).close()


CODES = {
    DeviceNotFound: (-1,),
    DeviceBusy: (-2, -11),
    DeviceLost: (-10, -20, -32, -36, -38),
    CommandRejected: (-16, -18, -22, -23),
    LimitError: (-17,),
    DeviceFault: (-28, -99),
}


@pytest.mark.parametrize(("error", "code"), [(error, code) for error, codes in CODES.items() for code in codes])
def test_every_code_has_a_name(error: type[Exception], code: int) -> None:
    bench = table()
    functions = PicoquantLibrary(bench, "multiharp150", 10e6)
    library = VendorLibrary("picoquant", FAMILIES["multiharp150"], functions, bench.clock)
    found = library.error("StartMeas", code)
    assert type(found) is error
    assert f"({code})" in str(found)


def test_the_wire_log_shows_what_each_call_was_given_and_gave_back() -> None:
    bench, log = table(), []
    functions = PicoquantLibrary(bench, "multiharp150", 10e6)
    counter = open_picoquant(
        settings("multiharp150"), bench.clock, functions, lambda device, way, data: log.append((way, data))
    )
    log.clear()
    counter.rates()
    assert log[:2] == [(">", b"MH_GetSyncRate(0, 0)"), ("<", b"0 (0, 10000000)")]


def test_calls_out_of_order_are_refused_by_the_stand_in() -> None:
    library = PicoquantLibrary(table(), "hydraharp400", 10e6)
    assert library.HH_SetBinning(0, 1) == -20
    assert library.HH_OpenDevice(0, ctypes.create_string_buffer(64)) == 0
    assert library.HH_OpenDevice(1, ctypes.create_string_buffer(64)) == -1
    assert library.HH_SetBinning(0, 1) == -22
    assert library.HH_Initialize(0, 0, 0) == 0
    assert library.HH_StartMeas(0, 10) == -23
    assert library.HH_Calibrate(0) == 0
    assert library.HH_StartMeas(0, 10) == 0
    assert library.HH_GetHistogram(0, (ctypes.c_uint * 65_536)(), 0, 0) == -16
    with pytest.raises(AttributeError, match="undefined symbol"):
        library.MH_StartMeas(0, 10)


def test_a_second_start_is_refused_but_by_a_hydraharp() -> None:
    """Two demos of HHLib's start twice."""
    for device, code in (("multiharp150", -16), ("picoharp300", -16), ("hydraharp400", 0)):
        library, family = PicoquantLibrary(table(), device, 10e6), FAMILIES[device]
        call = functools.partial(getattr, library)
        assert call(f"{family.prefix}_OpenDevice")(0, ctypes.create_string_buffer(64)) == 0
        assert call(f"{family.prefix}_Initialize")(0, 0) == 0
        assert call(f"{family.prefix}_Calibrate")(0) == 0
        assert [call(f"{family.prefix}_StartMeas")(0, 10) for _ in range(2)] == [0, code]


@given(st.sampled_from(sorted(FAMILIES)), st.integers(0, 12), st.integers(64, 70_000), st.integers(0, 2_000))
def test_an_axis_is_set_exactly_or_refused(device: str, power: int, bins: int, offset_ns: int) -> None:
    family = FAMILIES[device]
    axis = HistogramAxis(bins, 5e-12 * 2**power, offset_ns * 1e-9)
    try:
        codes = axis_codes("picoquant", family, 5e-12, axis, t3=False)
    except LimitError:
        assert bins > 65536 or power >= family.most_binning_codes
        return
    assert 5e-12 * 2**codes.binning == pytest.approx(axis.bin_width_s)
    assert codes.offset * family.offset_unit_s == pytest.approx(offset_ns * 1e-9)
    assert codes.length >= bins


@pytest.mark.parametrize(
    ("axis", "dwell_s", "message"),
    [
        (HistogramAxis(512, 30e-12), 8e-3, "power of two"),
        (HistogramAxis(512, 40e-12, 10.5e-9), 8e-3, "whole number of 1 ns"),
        (HistogramAxis(70_000, 40e-12), 8e-3, "65536"),
        (HistogramAxis(512, 40e-12), 1.5e-3, "milliseconds"),
    ],
)
def test_what_the_hardware_cannot_do_is_refused_before_anything_is_sent(
    axis: HistogramAxis, dwell_s: float, message: str
) -> None:
    counter, _ = opened("multiharp150")
    with pytest.raises(LimitError, match=message):
        counter.check(axis, dwell_s)


def test_what_the_instrument_lacks_is_said() -> None:
    counter, _ = opened("hydraharp400")
    with pytest.raises(LimitError, match="two_pass"):
        counter.configure(AXES["hydraharp400"], StopAtCounts(100, 0, 512))
    with pytest.raises(LimitError, match="mode: t3"):
        counter.arm(PointGates([8e-3], [0], Trigger.CLOCK))
    with pytest.raises(LimitError, match="no watchdog"):
        counter.arm_watchdog(2.0)
    counter, _ = opened("hydraharp400", mode="t3")
    with pytest.raises(LimitError, match="no trigger output"):
        counter.arm(PointGates([8e-3], [0], Trigger.CLOCK))
    counter, _ = opened("multiharp150", mode="t3")
    with pytest.raises(LimitError, match="uniform dwell"):
        counter.arm(PointGates([8e-3, 9e-3], [0, 1], Trigger.CLOCK))


def test_a_point_of_records_may_last_less_than_a_millisecond() -> None:
    bench, dwells_s = table(direct_cps=2e6), [1e-3, 0.25e-3, 0.5e-3, 1.4e-3, 2e-3]
    counter = open_picoquant(
        settings("multiharp150", mode="t3"), bench.clock, PicoquantLibrary(bench, "multiharp150", 10e6)
    )
    counter.configure(AXES["multiharp150"])
    counter.arm(PointGates(dwells_s, range(5)))
    for point in range(5):
        counter.trigger()
        counter.wait_points(point + 1, 1.0)
    taken = counter.read(0, 5)
    assert [each.live_time_s for each in taken] == pytest.approx(dwells_s)
    assert [each.sync_count for each in taken] == [10_000, 2500, 5000, 14_000, 20_000]
    rates = np.array([each.total_count for each in taken]) / dwells_s
    np.testing.assert_allclose(rates, 2e6, rtol=0.12)  # as photons drawn go: 500 in the shortest
    assert all(each.counts.sum() <= each.total_count for each in taken)


def test_a_bench_with_a_multiharp_scans_by_its_clock() -> None:
    with open_bench(load("bench", "multiharp", BenchSettings).settings) as bench:
        bench.counter.configure(AXES["multiharp150"])
        sequence = [MirrorAngles(0.005 * point, -0.005 * point) for point in range(20)]
        bench.mirror.load(sequence)
        bench.mirror.start()
        bench.shutter.open()
        bench.counter.arm(PointGates([4e-3] * 20, list(range(20)), Trigger.CLOCK, blanking_s=5e-4))
        status = bench.counter.wait_points(20, 5.0)
        bench.mirror.stop()
        bench.shutter.close()
        assert (status.points_done, status.markers) == (20, 20)
        peaks = [histogram.counts.argmax() for histogram in bench.counter.read(0, 20)]
        ranges = [2.0 / np.cos(angles.x_rad) / np.cos(angles.y_rad) for angles in sequence]
        expected = [((2 * range_m / 299792458.0) + 0.35e-9 - 8e-9) / 40e-12 for range_m in ranges]
        assert peaks == pytest.approx(expected, abs=2)


def test_photons_that_never_end_end_the_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """Light may be on while a library delivers records for ever."""
    counter, bench = opened("hydraharp400", mode="t3")
    stopped: list[str] = []
    read, attempt = counter._while_running, counter._library.attempt

    def endless() -> int:
        bench.clock.sleep(0.01)
        return read() + 1

    def noted(name: str, *arguments: Any) -> int:
        stopped.append(name)
        return attempt(name, *arguments)

    monkeypatch.setattr(counter, "_while_running", endless)
    monkeypatch.setattr(counter._library, "attempt", noted)
    began_s = bench.clock.now()
    with pytest.raises(DeviceTimeout, match="photons still come"):
        one_by_one(counter, 1)
    assert bench.clock.now() - began_s < 2.0
    assert "StopMeas" in stopped


@pytest.mark.parametrize("mode", ["histogram", "t3"])
@pytest.mark.parametrize("device", FAMILIES)
def test_a_laser_that_changes_its_rate_shows_in_the_points_that_follow(
    device: str, mode: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    counter, bench = opened(device, mode=mode)
    rate_hz, begun_s = counter._sync_rate_hz, bench.clock.now()
    monkeypatch.setattr(counter, "_sync_rate_hz", lambda: rate_hz() / (1 if bench.clock.now() - begun_s < 0.1 else 2))
    pulses = [each.sync_count / each.live_time_s for each in one_by_one(counter, 40)]
    assert pulses[0] == pytest.approx(10e6, rel=1e-3)
    assert pulses[-1] == pytest.approx(5e6, rel=1e-3)


@pytest.mark.parametrize("device", FAMILIES)
@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_rates_are_asked_for_once_the_instrument_has_counted(device: str, mode: str) -> None:
    """A HydraHarp's meters hold nothing for 400 ms: a scan that began at once was told that there is no laser."""
    counter, _ = opened(device, mode=mode)
    assert counter.rates().sync_hz == 10e6
    assert one_by_one(counter, 1)[0].sync_count == 80_000


@pytest.mark.parametrize("device", ["hydraharp400", "multiharp150"])
@pytest.mark.parametrize("mode", ["histogram", "t3"])
def test_an_input_that_no_detector_is_wired_to_counts_nothing(device: str, mode: str) -> None:
    counter, _ = opened(device, mode=mode, input=2)
    assert counter.rates().detector_hz == 0
    taken = one_by_one(counter)
    assert [each.total_count for each in taken] == [0] * 3
    assert not any(each.counts.any() for each in taken)
