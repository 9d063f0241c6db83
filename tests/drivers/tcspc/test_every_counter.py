"""What every counter that a bench file may name does, each on its simulated instrument, in each of its modes, or on the
bench of `--bench`."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from nlos.drivers.errors import CommandRejected, DeviceError, DeviceTimeout, LimitError, SafetyTrip
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.table import SimulatedTable
from nlos.drivers.simulated.usb.backend import SimulatedUsb
from nlos.drivers.tcspc.counter import (
    Histogram,
    HistogramAxis,
    HistogramCounter,
    HistogramFlag,
    PointGates,
    StopAtCounts,
    Trigger,
)
from nlos.drivers.tcspc.known_counters import COUNTERS as REGISTRY
from nlos.drivers.tcspc.known_counters import CounterSettings, open_counter
from nlos.drivers.tcspc.tcspc488.histogram import Tcspc488
from nlos.drivers.tcspc.tcspc488.shutter import Tcspc488Shutter

SETTINGS: TypeAdapter[CounterSettings] = TypeAdapter(CounterSettings)
SYNC_HZ = 10e6
DWELL_S = 0.008
BLANKING_S = 0.0005
NUMBERS = [7, 3, 12, 4]
PICOQUANT = {"model": "picoquant", "library": "simulated"}
TIMETAGGER = {"model": "timetagger", "library": "simulated", "pixel_clock": 1}
COUNTERS = {
    "tcspc488": {"model": "tcspc488", "usb": "simulated", "markers": True},
    "tcspc488 t3": {"model": "tcspc488", "usb": "simulated", "markers": True, "mode": "t3"},
    "picoharp300": {**PICOQUANT, "device": "picoharp300"},
    "hydraharp400": {**PICOQUANT, "device": "hydraharp400"},
    "multiharp150": {**PICOQUANT, "device": "multiharp150"},
    "multiharp150 t3": {**PICOQUANT, "device": "multiharp150", "mode": "t3"},
    "timetagger": {**TIMETAGGER, "mode": "histogram"},
    "timetagger list": {**TIMETAGGER, "mode": "list"},
}
BINS = 512


MODELS = list(COUNTERS)
WIDTHS_PS = (32, 40, 16, 20, 64, 80)


@dataclass
class Lab:
    """A counter on a bench with light, whose pixel clock comes back as step markers, as from a mirror controller. On a
    real bench it is dark, and its own mirror steps."""

    bench: Any
    """A simulated table, or what a real one has of it."""
    counter: HistogramCounter
    axis: HistogramAxis
    sent: list[Any] = field(default_factory=list)
    sync_hz: float = SYNC_HZ
    mirror: GalvoMirror | None = None
    """The real bench's own."""
    steps: int = 0

    @property
    def lit(self) -> bool:
        return self.mirror is None

    def needs_light(self) -> None:
        if not self.lit:
            pytest.skip("it takes light; `nlos doctor --thorough` asks for it")

    def ready_to_step(self, count: int) -> None:
        if self.mirror is not None and self.counter.counts_markers:
            if self.mirror.max_sequence < count:
                pytest.skip(f"{self.mirror.identity.product} cannot step by itself")
            self.mirror.load([MirrorAngles(0.0, 0.0)] * count)
            self.mirror.start()

    def step(self, when_s: float) -> None:
        self.steps += 1
        self.bench.edge(f"marker_{2 - self.steps % 2}", when_s)

    def one_by_one(self, points: int = len(NUMBERS)) -> list[Histogram]:
        self.counter.arm(PointGates([DWELL_S] * points, NUMBERS[:points]))
        histograms = []
        for k in range(points):
            self.counter.trigger()
            status = self.counter.wait_points(k + 1, 1.0)
            assert status.points_done == k + 1
            histograms += self.counter.read(k, 1)
        return histograms


def real_lab(named: Any) -> Lab:
    """The named bench, dark, with the first time axis of ours that its counter takes."""
    bench = named.bench
    for width_ps in WIDTHS_PS:
        axis = HistogramAxis(BINS, width_ps * 1e-12, 8e-9)
        try:
            bench.counter.configure(axis)
        except LimitError:
            continue
        return Lab(named.table, bench.counter, axis, named.sent, bench.settings.laser.repetition_hz, bench.mirror)
    pytest.skip(f"{bench.counter.identity.product} takes none of these bin widths: {WIDTHS_PS} ps")


@pytest.fixture
def lab(request: pytest.FixtureRequest, named_bench: Any) -> Iterator[Lab]:
    if named_bench is not None:
        yield real_lab(named_bench)
        return
    settings = SETTINGS.validate_python(COUNTERS[request.param])
    light = SceneLight(
        SceneSettings(direct_cps=2e5), DetectorSettings(dead_time_ns=0.0), BeamPath(2.0), SYNC_HZ, seed=5
    )
    bench = SimulatedBench(light)
    bench.set_shutter(True)
    backend = REGISTRY[settings.model].firmware(settings, SimulatedTable(bench, SimulationSettings(), SYNC_HZ))
    if settings.cable == "usb":
        backend = SimulatedUsb([backend], bench.clock)
    width_ps = 40 if "multiharp" in request.param else 32
    this = Lab(bench, None, HistogramAxis(BINS, width_ps * 1e-12, 8e-9))  # type: ignore[arg-type]
    this.counter = open_counter(
        settings, bench.clock, backend, lambda device, way, data: this.sent.append(data) if way == ">" else None
    )
    this.counter.configure(this.axis)
    bench.wire("pixel_clock", this.step)
    yield this
    this.counter.close()


def test_it_says_who_it_is(lab: Lab) -> None:
    identity = lab.counter.identity
    assert identity.model in REGISTRY
    assert all((identity.vendor, identity.product, identity.serial, identity.firmware))
    assert lab.counter.max_points >= 1


def test_a_point_is_a_histogram_with_its_times(lab: Lab) -> None:
    histograms = lab.one_by_one()
    for histogram in histograms:
        assert histogram.counts.shape == (BINS,)
        assert histogram.counts.dtype == np.uint32
        assert histogram.counts.sum() > 100 or not lab.lit
        assert histogram.total_count >= histogram.counts.sum()
        assert histogram.live_time_s == pytest.approx(DWELL_S, rel=1e-3)
        assert histogram.sync_count == pytest.approx(DWELL_S * lab.sync_hz, rel=1e-2 if lab.mirror else 1e-3)
        assert histogram.bin_width_s == lab.axis.bin_width_s
        assert histogram.offset_s == lab.axis.offset_s
        assert histogram.flags == HistogramFlag.NONE
    opened_s = [histogram.gate_opened_s for histogram in histograms]
    assert all(np.diff(opened_s) >= DWELL_S * 0.99)


def test_reading_again_gives_the_same(lab: Lab) -> None:
    first = lab.one_by_one()
    for one, other in zip(first, lab.counter.read(0, len(NUMBERS)), strict=True):
        np.testing.assert_array_equal(one.counts, other.counts)


def test_what_it_cannot_do_exactly_is_refused_and_nothing_is_sent(lab: Lab) -> None:
    lab.sent.clear()
    for axis, dwell_s in [
        (HistogramAxis(0, 32e-12), DWELL_S),
        (HistogramAxis(10**7, 32e-12), DWELL_S),
        (HistogramAxis(BINS, 33.3e-12), DWELL_S),
        (HistogramAxis(BINS, lab.axis.bin_width_s, -1e-9), DWELL_S),
        (lab.axis, 0.0),
        (lab.axis, -1.0),
        (lab.axis, 1e9),
    ]:
        with pytest.raises(LimitError):
            lab.counter.check(axis, dwell_s)
    assert lab.sent == []
    lab.counter.check(lab.axis, DWELL_S)


def test_arming_takes_as_many_numbers_as_dwells_and_no_more_than_it_can(lab: Lab) -> None:
    for dwells_s, numbers in [([], []), ([DWELL_S], [1, 2]), ([DWELL_S] * 2, [1])]:
        with pytest.raises(LimitError):
            lab.counter.arm(PointGates(dwells_s, numbers))
    too_many = lab.counter.max_points + 1
    if too_many < 200_000:
        with pytest.raises(LimitError):
            lab.counter.arm(PointGates([DWELL_S] * too_many, range(too_many)))


def test_no_more_points_are_triggered_than_armed(lab: Lab) -> None:
    lab.one_by_one(2)
    with pytest.raises(CommandRejected):
        lab.counter.trigger()


def test_a_point_that_was_not_triggered_is_not_waited_for(lab: Lab) -> None:
    lab.counter.arm(PointGates([DWELL_S] * 2, [1, 2]))
    with pytest.raises(CommandRejected):
        lab.counter.wait_points(1, 0.5)


def test_a_point_that_takes_longer_than_it_may_is_a_timeout(lab: Lab) -> None:
    lab.counter.arm(PointGates([5.0] * 2, [1, 2]))
    lab.counter.trigger()
    start_s = lab.bench.clock.now()
    with pytest.raises(DeviceTimeout):
        lab.counter.wait_points(1, 0.5)
    assert 0.4 <= lab.bench.clock.now() - start_s <= 0.7


def test_points_that_are_not_complete_cannot_be_read(lab: Lab) -> None:
    lab.one_by_one(1)
    with pytest.raises(DeviceError):
        lab.counter.read(1, 1)
    lab.counter.arm(PointGates([DWELL_S] * 2, [1, 2]))
    with pytest.raises(DeviceError):
        lab.counter.read(0, 1)


def test_after_an_abort_it_starts_afresh(lab: Lab) -> None:
    lab.counter.arm(PointGates([DWELL_S] * 3, [1, 2, 3]))
    lab.counter.trigger()
    lab.bench.clock.sleep(DWELL_S / 2)
    lab.counter.abort()
    assert len(lab.one_by_one()) == len(NUMBERS)


def test_rates_are_those_of_the_inputs(lab: Lab) -> None:
    rates = lab.counter.rates()
    assert rates.sync_hz == pytest.approx(lab.sync_hz, rel=1e-2 if lab.mirror else 1e-3)
    assert rates.detector_hz == pytest.approx(2e5, rel=0.5) or not lab.lit


def test_its_pixel_clock_steps_once_per_point_and_points_come_in_their_order(lab: Lab) -> None:
    if not lab.counter.has_pixel_clock:
        with pytest.raises(LimitError):
            lab.counter.arm(PointGates([DWELL_S] * 4, NUMBERS, Trigger.CLOCK, BLANKING_S))
        return
    lab.ready_to_step(4)
    lab.bench.clock.sleep(1.0)  # what was before it is armed is none of its time
    lab.counter.arm(PointGates([DWELL_S] * 4, NUMBERS, Trigger.CLOCK, BLANKING_S))
    start_s = lab.bench.clock.now()
    status = lab.counter.wait_points(4, 1.0)
    assert status.points_done == 4
    assert status.lost == 0
    assert status.markers in (4, None)
    assert (status.markers is not None) == lab.counter.counts_markers
    assert lab.bench.clock.now() - start_s == pytest.approx(4 * (DWELL_S + BLANKING_S), abs=0.07)
    histograms = lab.counter.read(0, 4)
    assert [histogram.counts.sum() > 100 or not lab.lit for histogram in histograms] == [True] * 4
    opened_s = [histogram.gate_opened_s for histogram in histograms]
    np.testing.assert_allclose(np.diff(opened_s), DWELL_S + BLANKING_S, rtol=1e-3)
    assert 0 <= opened_s[0] < 0.1


def test_asking_for_rates_while_points_are_taken_changes_nothing(lab: Lab) -> None:
    if not lab.counter.has_pixel_clock:
        pytest.skip("its points are started by the host, one at a time")
    lab.needs_light()
    lab.counter.arm(PointGates([DWELL_S] * 4, NUMBERS, Trigger.CLOCK, BLANKING_S))
    for count in range(1, 5):
        assert lab.counter.rates().sync_hz == pytest.approx(SYNC_HZ, rel=1e-3)
        status = lab.counter.wait_points(count, 1.0)
    assert status.markers in (4, None)
    assert [histogram.total_count > 1000 for histogram in lab.counter.read(0, 4)] == [True] * 4


def test_a_watchdog_that_is_not_kicked_shuts_the_light(lab: Lab) -> None:
    if not lab.counter.has_watchdog:
        with pytest.raises(LimitError, match="no watchdog"):
            lab.counter.arm_watchdog(0.5)
        return
    lab.needs_light()
    assert isinstance(lab.counter, Tcspc488)
    shutter = Tcspc488Shutter(lab.counter)
    lab.counter.arm_watchdog(0.5)
    shutter.open()
    for _ in range(3):  # longer than its time in all, never in one piece
        lab.bench.clock.sleep(0.4)
        lab.counter.kick()
    assert lab.bench.shutter_open
    lab.bench.clock.sleep(0.6)
    assert not lab.bench.shutter_open
    with pytest.raises(SafetyTrip, match="watchdog"):
        lab.counter.configure(lab.axis)
    assert not shutter.state().commanded_open


def test_closing_twice_is_quiet(lab: Lab) -> None:
    lab.counter.arm(PointGates([DWELL_S], [0]))
    lab.counter.trigger()
    lab.counter.close()
    lab.counter.close()


@pytest.mark.parametrize("offset_s", [0.0, 10e-9, 12.8e-9, 10.0071e-9])
@pytest.mark.parametrize("width_ps", [7, 13, 16, 20, 25, 32, 50, 100])
def test_the_nearest_axis_can_be_set_and_holds_the_window(lab: Lab, width_ps: int, offset_s: float) -> None:
    asked = HistogramAxis(BINS, width_ps * 1e-12, offset_s)
    lab.sent.clear()
    axis = lab.counter.nearest_axis(asked)
    assert lab.sent == []
    lab.counter.check(axis, DWELL_S)
    assert abs(np.log2(axis.bin_width_s / asked.bin_width_s)) <= 0.5 + 1e-9
    assert axis.offset_s <= offset_s + 1e-15
    assert axis.offset_s + axis.bins * axis.bin_width_s >= offset_s + BINS * asked.bin_width_s - 1e-3 * axis.bin_width_s
    assert lab.counter.nearest_axis(axis) == axis
    assert lab.counter.nearest_axis(lab.axis) == lab.axis


def test_a_width_that_is_near_none_of_its_own_is_refused(lab: Lab) -> None:
    with pytest.raises(LimitError, match="bin_width_ps"):
        lab.counter.nearest_axis(HistogramAxis(BINS, 0.1e-12))


def test_what_ends_points_early_is_checked_before_anything_is_sent(lab: Lab) -> None:
    stop = StopAtCounts(10, 0, BINS)
    lab.sent.clear()
    try:
        lab.counter.check(lab.axis, DWELL_S, stop)
    except LimitError:
        assert lab.sent == []
        return
    lab.counter.configure(lab.axis, stop)
    assert len(lab.one_by_one(1)) == 1
