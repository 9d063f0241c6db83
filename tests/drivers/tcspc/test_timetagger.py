"""A Time Tagger whose model or cabling differs from the one of the other tests: delays, levels, AUX OUT."""

from contextlib import AbstractContextManager, nullcontext
from itertools import count
from typing import Any

import numpy as np
import pytest

from nlos.drivers.errors import DeviceFault, LimitError, SyncLost, WrongDevice
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.timetagger import measurements
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag, PointGates, Trigger
from nlos.drivers.tcspc.timetagger import clocked
from nlos.drivers.tcspc.timetagger.counter import TimeTagger
from nlos.drivers.tcspc.timetagger.model import TIMETAGGER
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings

PERIOD_PS, WIDTH_PS = 100_000, 100
AXIS = HistogramAxis(PERIOD_PS // WIDTH_PS, WIDTH_PS * 1e-12)
ARRIVALS_PS = (1_050, 98_050)
"""After the laser pulse: one early, one late in its period."""


def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
    counts = np.zeros(gate.bins, np.uint32)
    for arrival_ps in ARRIVALS_PS:
        place = int((arrival_ps * 1e-12 - gate.offset_s) / gate.bin_width_s)
        if 0 <= place < gate.bins:
            counts[place] = 40
    return Exposure(counts, gate.dwell_s, round(gate.dwell_s / (PERIOD_PS * 1e-12)), int(counts.sum()), False)


def rig(**given: Any) -> tuple[Any, TimeTaggerSettings, SimulatedBench]:
    settings = TimeTaggerSettings.model_validate({"model": "timetagger", "library": "simulated", **given})
    bench = SimulatedBench(light)
    bench.set_shutter(True)
    table = SimulatedTable(bench, SimulationSettings(), 1 / (PERIOD_PS * 1e-12))
    return TIMETAGGER.firmware(settings, table), settings, bench


class Replaced:
    """The package, of whose instrument some methods are others."""

    def __init__(self, package: Any, **methods: Any) -> None:
        self._package, self._methods = package, methods

    def __getattr__(self, name: str) -> Any:
        return getattr(self._package, name)

    def createTimeTagger(self, serial: str) -> Any:
        instrument = self._package.createTimeTagger(serial)
        for name, method in self._methods.items():
            setattr(instrument, name, method)
        return instrument


@pytest.mark.parametrize("mode", ["histogram", "list"])
@pytest.mark.parametrize(("sync_ps", "detector_ps"), [(0, 0), (0, 5_000), (0, -5_000), (-2_000, 3_000), (90_000, 0)])
def test_delays_move_photons_around_the_period_and_lose_none(mode: str, sync_ps: int, detector_ps: int) -> None:
    package, settings, bench = rig(
        mode=mode, sync={"channel": 1, "delay_ps": sync_ps}, detector={"channel": 2, "delay_ps": detector_ps}
    )
    counter = TimeTagger.open(settings, bench.clock, package)
    counter.configure(AXIS)
    counter.arm(PointGates([0.004], [0]))
    counter.trigger()
    counter.wait_points(1, 1.0)
    (seen,) = counter.read(0, 1)
    counter.close()
    due = sorted((arrival + detector_ps - sync_ps) % PERIOD_PS // WIDTH_PS for arrival in ARRIVALS_PS)
    assert np.flatnonzero(seen.counts).tolist() == due
    assert seen.counts[due].tolist() == [40, 40]


@pytest.mark.parametrize("mode", ["histogram", "list"])
def test_a_window_that_begins_late_holds_what_comes_in_it_and_the_total_all(mode: str) -> None:
    package, settings, bench = rig(mode=mode)
    counter = TimeTagger.open(settings, bench.clock, package)
    counter.configure(HistogramAxis(25, WIDTH_PS * 1e-12, 975 * WIDTH_PS * 1e-12))
    counter.arm(PointGates([0.004], [0]))
    counter.trigger()
    counter.wait_points(1, 1.0)
    (seen,) = counter.read(0, 1)
    counter.close()
    assert np.flatnonzero(seen.counts).tolist() == [980 - 975]
    assert seen.counts.sum() == 40
    assert seen.total_count == 80


def test_a_model_that_delays_behind_its_filter_is_refused_delays_and_nothing_else() -> None:
    """A Time Tagger 20 has no other delays than those of the computer."""
    package, settings, bench = rig(detector={"channel": 2, "delay_ps": 5_000})
    panel = package._panel

    def behind(channel: int, delay: int) -> None:
        panel.software_ps[channel] = delay

    older = Replaced(package, setInputDelay=behind)
    with pytest.raises(LimitError, match=r"input 2 only behind its filter.*delay_ps: 0"):
        TimeTagger.open(settings, bench.clock, older)
    TimeTagger.open(rig()[1], bench.clock, older).close()


def test_a_level_that_the_package_moves_into_its_range_is_refused() -> None:
    package, settings, bench = rig(detector={"channel": 2, "level_mv": -2000})
    with pytest.raises(LimitError, match="input 2 takes no level of -2000 mV: it made -1500 mV of it"):
        TimeTagger.open(settings, bench.clock, package)
    assert not package.held


def test_a_model_without_aux_out_says_so_as_it_is_opened() -> None:
    package, settings, bench = rig(pixel_clock=1)

    def without(channel: int, enabled: bool) -> None:
        raise RuntimeError("Aux Out signal generator is only supported on the Time Tagger X series.")

    with pytest.raises(DeviceFault, match="only supported on the Time Tagger X"):
        TimeTagger.open(settings, bench.clock, Replaced(package, xtra_setAuxOut=without))


def test_a_package_whose_aux_out_takes_a_divider_is_called_another_version() -> None:
    """As older packages have it: `xtra_setAuxOutSignal(channel, divider)`."""
    package, settings, bench = rig(pixel_clock=1)

    def divided(channel: int, divider: int) -> None:
        if not isinstance(divider, int):
            raise TypeError("in method 'TimeTagger_xtra_setAuxOutSignal', argument 3 of type 'int'")

    counter = TimeTagger.open(settings, bench.clock, Replaced(package, xtra_setAuxOutSignal=divided))
    counter.configure(AXIS)
    with pytest.raises(WrongDevice, match=r"other arguments for xtra_setAuxOutSignal .*argument 3 of type 'int'"):
        counter.arm(PointGates([0.02] * 3, [0, 1, 2], Trigger.CLOCK, 0.002))
    counter.close()


def taken(counter: TimeTagger, bench: SimulatedBench, points: int = 3) -> list[Histogram]:
    """Started by the host, 4 ms each."""
    counter.configure(AXIS)
    counter.arm(PointGates([0.004] * points, list(range(points))))
    for point in range(points):
        counter.trigger()
        counter.wait_points(point + 1, 1.0)
    return counter.read(0, points)


@pytest.mark.parametrize("mode", ["histogram", "list"])
def test_a_laser_that_changes_its_rate_while_points_are_taken_is_named_with_both_rates(mode: str) -> None:
    package, settings, bench = rig(mode=mode)
    counter = TimeTagger.open(settings, bench.clock, package)
    assert [point.total_count for point in taken(counter, bench)] == [80] * 3
    bench.faults.add(Fault(name="T4", after_s=bench.clock.now() + 0.11, parameters={"times_hz": 0.98}))
    with pytest.raises(
        SyncLost, match=r"input 1 \(sync\) had 10000000 Hz .* (97999..|9800000) Hz .* up to 2041 ps off"
    ):
        taken(counter, bench)
    assert len(taken(counter, bench)) == 3  # of one rate again
    counter.close()


@pytest.mark.parametrize(("off_hz", "lost"), [(0, False), (200, False), (-200, False), (220, True), (-220, True)])
def test_a_rate_is_told_to_a_pulse_in_each_of_its_gates(off_hz: int, lost: bool) -> None:
    """One pulse in 10 ms is 100 Hz, one in 100 ms 10 Hz; a bin of 1 ps a period is 100 Hz of 10 MHz: 210 in all."""
    package, settings, bench = rig()
    counter = TimeTagger.open(settings, bench.clock, package)
    ends: AbstractContextManager[Any] = pytest.raises(SyncLost) if lost else nullcontext()
    with ends:
        counter.tagger.check_sync(10e6 + off_hz, 1)
    counter.close()


def test_a_laser_that_drifts_by_less_than_a_bin_a_period_is_as_it_was() -> None:
    package, settings, bench = rig()
    counter = TimeTagger.open(settings, bench.clock, package)
    bench.faults.add(Fault(name="T4", after_s=bench.clock.now() + 0.11, parameters={"times_hz": 0.9995}))
    assert [point.total_count for point in taken(counter, bench)] == [80] * 3
    counter.close()


@pytest.mark.parametrize("mode", ["histogram", "list"])
def test_a_point_whose_tags_were_lost_has_no_counts_and_no_live_time(mode: str) -> None:
    package, settings, bench = rig(mode=mode)
    counter = TimeTagger.open(settings, bench.clock, package)
    counter.tagger.overflowed()
    bench.faults.add(Fault(name="T1", after_s=bench.clock.now() + 0.11))
    seen = taken(counter, bench)
    counter.close()
    lost = [HistogramFlag.DATA_LOST in each.flags for each in seen]
    assert lost == [False, False, True]  # from 108 to 112 ms: the rate takes 100, each point 4
    for each, gone in zip(seen, lost, strict=True):
        assert (each.live_time_s, each.total_count, each.counts.sum()) == ((0.0, 0, 0) if gone else (0.004, 80, 80))


class Asked(measurements.TimeTagStream):
    """Counts how often its buffer is emptied."""

    times = 0

    def getData(self) -> measurements.TagBuffer:
        Asked.times += 1
        return super().getData()


def test_tags_are_fetched_while_a_point_lasts() -> None:
    """The vendor's `TimeTagStream` drops what finds its buffer full, and says nothing."""
    package, settings, bench = rig(mode="list")
    package.TimeTagStream = Asked
    counter = TimeTagger.open(settings, bench.clock, package)
    counter.configure(AXIS)
    counter.arm(PointGates([0.2], [0]))
    before = Asked.times
    counter.trigger()
    counter.wait_points(1, 1.0)
    (seen,) = counter.read(0, 1)
    counter.close()
    assert Asked.times - before >= 20
    assert (seen.total_count, seen.live_time_s) == (80, 0.2)


def test_a_buffer_of_tags_that_was_full_makes_a_point_a_lost_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clocked, "_MOST_TAGS", 100)
    package, settings, bench = rig(mode="list")
    counter = TimeTagger.open(settings, bench.clock, package)
    (seen,) = taken(counter, bench, 1)
    counter.close()
    assert (seen.flags, seen.live_time_s, seen.total_count) == (HistogramFlag.DATA_LOST, 0.0, 0)


@pytest.mark.parametrize("mode", ["histogram", "list"])
def test_tags_lost_while_the_lasers_rate_was_measured_are_of_no_point(mode: str) -> None:
    """Every pulse of a fast laser is counted then, more than a USB cable carries."""
    package, settings, bench = rig(mode=mode)
    counter = TimeTagger.open(settings, bench.clock, package)
    bench.faults.add(Fault(name="T1"))
    assert [(each.flags, each.total_count) for each in taken(counter, bench)] == [(HistogramFlag.NONE, 80)] * 3
    counter.close()


def test_a_loss_that_only_the_stream_of_tags_tells_of_is_a_points_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    package, settings, bench = rig(mode="list")
    counter = TimeTagger.open(settings, bench.clock, package)
    reads = count(1)

    def kinds(buffer: measurements.TagBuffer) -> Any:
        found = np.zeros(len(buffer.getTimestamps()), np.uint8)
        found[:1] = next(reads) == 2  # not a tag: an overflow begins, or ends, or so many were missed
        return found

    monkeypatch.setattr(measurements.TagBuffer, "getEventTypes", kinds)
    seen = taken(counter, bench)
    counter.close()
    assert [HistogramFlag.DATA_LOST in each.flags for each in seen] == [False, True, False]
    assert [(each.total_count, each.live_time_s) for each in seen] == [(80, 0.004), (0, 0.0), (80, 0.004)]
