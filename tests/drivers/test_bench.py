"""The bench as a whole: what opens when, what a trip, a pulled cable or a silent host do, and what is told to whom."""

import json
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from nlos.configs.load import ConfigError, load, names, parse
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.bench_settings import AllowedArea
from nlos.drivers.errors import DeviceBusy, DeviceError, LimitError, SafetyTrip
from nlos.drivers.exit_paths import light_may_be_on
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.silence import COROUTINES
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import unplug
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag, PointGates

AXES = {
    "tcspc488": HistogramAxis(512, 32e-12, 10e-9),
    "picoquant": HistogramAxis(512, 40e-12, 10e-9),
    "timetagger": HistogramAxis(512, 40e-12, 10e-9),
}


def settings(**simulation: Any) -> BenchSettings:
    default = load("bench", "simulated", BenchSettings).settings
    assert default.simulation is not None
    return default.model_copy(update={"simulation": default.simulation.model_copy(update=simulation)})


@contextmanager
def bench(**simulation: Any) -> Iterator[tuple[Bench, list[tuple[str, str]]]]:
    events: list[tuple[str, str]] = []
    with open_bench(settings(**simulation)) as opened:
        opened.on_event = lambda kind, text: events.append((kind, text))
        yield opened, events


def measure(opened: Bench, points: int = 3) -> list[Histogram]:
    opened.counter.configure(AXES[opened.settings.counter.model])
    opened.counter.arm(PointGates([8e-3] * points, list(range(points))))
    histograms = []
    for point in range(points):
        opened.mirror.move_to(MirrorAngles(0.02 * point, -0.01))
        opened.counter.trigger()
        opened.counter.wait_points(point + 1, 1.0)
        histograms += opened.counter.read(point, 1)
    return histograms


@pytest.mark.parametrize("name", names("bench"))
def test_every_bench_file_opens_if_simulated_and_is_valid_if_not(name: str) -> None:
    read = load("bench", name, BenchSettings).settings
    if not read.simulated:
        return
    with open_bench(read) as opened:
        assert {identity.model for identity in opened.identities} == {read.mirror.model, read.counter.model}
        opened.shutter.open()
        assert measure(opened)[0].total_count > 0


def test_the_shutter_is_closed_before_the_mirror_is_opened() -> None:
    sent: list[tuple[str, bytes]] = []
    with open_bench(settings(), wire_log=lambda device, way, data: sent.append((device, data)) if way == ">" else None):
        pass
    closed = next(k for k, (_, data) in enumerate(sent) if b"OUTP:SHUT CLOS" in data)
    moved = next(k for k, (device, _) in enumerate(sent) if device == "triggerscope")
    assert closed < moved


def test_two_scans_hold_the_same_photons_and_light_needs_an_open_shutter() -> None:
    taken = []
    for _ in range(2):
        with bench() as (opened, _events):
            dark = measure(opened)
            opened.shutter.open()
            taken.append(measure(opened))
    assert all(histogram.total_count < 20 for histogram in dark)
    for first, second in zip(*taken, strict=True):
        assert first.total_count > 200
        assert (first.counts == second.counts).all()


def test_every_change_of_the_shutter_is_told_with_its_reason() -> None:
    def work(opened: Bench) -> float:
        opened.shutter.open()
        opened.shutter.close("for lunch")
        opened.shutter.open()
        return 1 / 0

    with pytest.raises(ZeroDivisionError), bench() as (opened, events):
        work(opened)
    assert [text for kind, text in events if kind == "shutter"] == [
        "opened",
        "closed: for lunch",
        "opened",
        "closed: ZeroDivisionError division by zero",
    ]


def test_events_wait_until_somebody_listens() -> None:
    events: list[tuple[str, str]] = []
    with open_bench(settings()) as opened:
        opened.shutter.open()
        assert events == []
        opened.on_event = lambda kind, text: events.append((kind, text))
        assert events == [("shutter", "opened")]


def test_a_silent_host_loses_the_light() -> None:
    with bench() as (opened, _events):
        opened.shutter.open()
        assert opened.simulated is not None
        opened.clock.sleep(1.9)
        opened.counter.kick()
        opened.clock.sleep(1.9)
        opened.counter.kick()
        opened.clock.sleep(2.5)
        with pytest.raises(SafetyTrip):
            measure(opened)
        assert not opened.simulated.shutter_open


def test_the_watchdog_rests_while_the_shutter_is_closed() -> None:
    with bench() as (opened, _events):
        opened.shutter.open()
        opened.shutter.close()
        opened.clock.sleep(3600.0)
        opened.shutter.open()
        assert measure(opened)[0].total_count > 200


def test_an_open_interlock_keeps_the_shutter_closed() -> None:
    with bench() as (opened, events):
        assert opened.simulated is not None
        opened.simulated.interlock_closed = False
        with pytest.raises(SafetyTrip, match="interlock"):
            opened.shutter.open()
        assert not opened.simulated.shutter_open
    assert [kind for kind, _ in events] == ["shutter", "trip"]


def test_a_trip_stays_until_a_person_clears_it() -> None:
    with bench() as (opened, events):
        opened.shutter.open()
        glaring = Histogram(measure(opened)[0].counts, 32e-12, 0.0, 20e-3, 1, 10**6, HistogramFlag.NONE, 0.0)
        with pytest.raises(SafetyTrip, match="5e\\+07 counts/s"):
            opened.shutter.watch(glaring)
        with pytest.raises(SafetyTrip, match="stays closed after a trip"):
            opened.shutter.open()
        opened.shutter.clear_trip("A. Person")
        opened.shutter.open()
        opened.shutter.watch(measure(opened)[0])
    kinds = [kind for kind, _ in events]
    assert kinds == ["shutter", "shutter", "trip", "override", "shutter", "shutter"]
    assert "A. Person" in events[3][1]


def test_a_trip_of_the_instrument_stays_until_a_person_clears_it() -> None:
    fault = Fault(name="U14", parameters={"cause": "over_count"})
    with bench(faults=(fault,)) as (opened, events):
        opened.shutter.open()
        assert opened.simulated is not None
        with pytest.raises(SafetyTrip):
            measure(opened)
        assert not opened.simulated.shutter_open
        with pytest.raises(SafetyTrip):
            opened.shutter.open()
        assert not opened.simulated.shutter_open
        opened.shutter.clear_trip("A. Person")
        opened.shutter.open()
        assert measure(opened)[0].total_count > 200
    assert ("override", "A. Person cleared the trip: the instrument had it") in events


def test_a_pulled_serial_cable_still_closes_the_shutter() -> None:
    def work(opened: Bench) -> None:
        opened.shutter.open()
        unplug("triggerscope")
        measure(opened)

    with pytest.raises(DeviceError, match="triggerscope") as raised, bench() as (opened, events):
        work(opened)
    assert opened.simulated is not None
    assert not opened.simulated.shutter_open
    assert ("shutter", f"closed: {type(raised.value).__name__} {raised.value}") in events


def test_a_pulled_usb_cable_is_said_aloud_and_left_to_the_watchdog(caplog: pytest.LogCaptureFixture) -> None:
    fault = Fault(name="U11", skip=60)

    def work(opened: Bench) -> None:
        opened.shutter.open()
        measure(opened, 500)

    with pytest.raises(DeviceError, match="tcspc488") as raised, bench(faults=(fault,)) as (opened, events):
        work(opened)
    assert "NOT CONFIRMED CLOSED" in caplog.text
    assert any("shutter" in note or "tcspc488" in note for note in raised.value.__notes__)
    assert any(kind == "shutter" and "NOT CONFIRMED" in text for kind, text in events)
    assert ("watchdog", "silent for 2 s: its time to close the shutter") in events
    assert opened.simulated is not None
    assert not opened.simulated.shutter_open
    assert math.hypot(opened.simulated.beam.x_rad, opened.simulated.beam.y_rad) < 1e-4


def test_what_every_step_of_the_way_out_fails_with_is_said_once() -> None:
    """A cable that is gone: shutter, gate and links fail in the same words."""

    def work(opened: Bench) -> None:
        opened.shutter.open()
        assert opened.simulated is not None
        opened.simulated.faults.add(Fault(name="U11"))
        measure(opened, 500)

    with pytest.raises(DeviceError, match="tcspc488") as raised, bench() as (opened, events):
        work(opened)
    notes = getattr(raised.value, "__notes__", [])
    assert len(set(notes)) == len(notes)
    assert str(raised.value) not in notes
    failures = [each for each in events if each[0] == "device" or "NOT CONFIRMED" in each[1]]
    assert failures
    assert len(set(failures)) == len(failures)


def test_a_lost_cable_takes_nothing_back_that_was_confirmed(caplog: pytest.LogCaptureFixture) -> None:
    def work(opened: Bench) -> None:
        opened.shutter.open()
        opened.mirror.move_to(MirrorAngles(0.1, -0.1))
        opened.shutter.close()
        assert opened.simulated is not None
        opened.simulated.faults.add(Fault(name="U11"))
        opened.counter.kick()

    with pytest.raises(DeviceError, match="tcspc488"), bench() as (opened, _events):
        work(opened)
    assert "NOT CONFIRMED CLOSED" not in caplog.text
    assert opened.simulated is not None
    assert math.hypot(opened.simulated.beam.x_rad, opened.simulated.beam.y_rad) < 1e-4


def test_a_late_answer_about_the_shutter_is_waited_for_before_the_mirror_is_parked() -> None:
    ttl = settings().model_dump(mode="json")
    ttl["mirror"]["shutter_pin"] = 9
    ttl["shutter"]["model"] = "triggerscope_ttl"

    def work(opened: Bench) -> float:
        opened.shutter.open()
        opened.mirror.move_to(MirrorAngles(0.1, -0.1))
        assert opened.simulated is not None
        opened.simulated.faults.add(Fault(name="G2", parameters={"delay_s": 1.0}))
        return 1 / 0

    with pytest.raises(ZeroDivisionError), open_bench(BenchSettings.model_validate_json(json.dumps(ttl))) as opened:
        work(opened)
    assert opened.simulated is not None
    assert not opened.simulated.shutter_open
    assert math.hypot(opened.simulated.beam.x_rad, opened.simulated.beam.y_rad) < 1e-4


def test_without_a_watchdog_a_bench_of_which_the_shutter_is_lost_is_not_parked() -> None:
    off = settings(faults=(Fault(name="U11", skip=60),))
    off = off.model_copy(update={"safety": off.safety.model_copy(update={"watchdog_s": 0.0})})
    events: list[tuple[str, str]] = []

    def work(opened: Bench) -> None:
        opened.on_event = lambda kind, text: events.append((kind, text))
        opened.shutter.open()
        measure(opened, 500)

    with pytest.raises(DeviceError, match="tcspc488"), open_bench(off) as opened:
        work(opened)
    assert ("warning", "not parked: the shutter is not confirmed closed") in events


def test_a_position_out_of_reach_is_refused_with_nothing_sent() -> None:
    sent: list[bytes] = []
    with open_bench(settings(), wire_log=lambda device, way, data: sent.append(data)) as opened:
        before = len(sent)
        with pytest.raises(LimitError, match="outside"):
            opened.mirror.move_to(MirrorAngles(0.9, 0.0))
        assert len(sent) == before


def test_a_dry_run_moves_everything_but_the_shutter() -> None:
    chosen = settings()
    dry = chosen.model_copy(update={"safety": chosen.safety.model_copy(update={"dry_run": True})})
    with open_bench(dry) as opened:
        assert opened.simulated is not None
        opened.shutter.open()
        assert measure(opened)[0].total_count < 20
        assert not opened.simulated.shutter_open
        assert "dry run: the shutter stays closed" in opened.warnings


def test_the_allowed_area_is_checked_on_every_side() -> None:
    area = AllowedArea(left_m=-0.5, right_m=0.4, bottom_m=-0.3, top_m=0.2)
    area.check(-0.5, 0.2)
    for x_m, y_m in ((-0.51, 0.0), (0.41, 0.0), (0.0, -0.31), (0.0, 0.21), (float("nan"), 0.0)):
        with pytest.raises(LimitError, match="outside the allowed area"):
            area.check(x_m, y_m)


def test_light_may_be_on_only_from_before_it_comes_until_it_is_off() -> None:
    assert not light_may_be_on()
    with bench() as (opened, _):
        assert not light_may_be_on()
        opened.shutter.open()
        assert light_may_be_on()
        opened.shutter.close()
        assert not light_may_be_on()


def test_one_bench_at_a_time() -> None:
    with bench(), pytest.raises(DeviceBusy), bench():
        pass


TEXT = """
name: t
mirror: {model: triggerscope, port: PORT}
counter: {model: tcspc488, usb: USB}
shutter: {model: SHUTTER}
geometry: {wall_distance_m: 2.0}
"""


@pytest.mark.parametrize(
    ("port", "usb", "shutter", "more", "message"),
    [
        ("sim://a", "auto", "none", "simulation: {}", "share one clock"),
        ("sim://a", "simulated", "none", "", "needs a `simulation` block"),
        ("/dev/ttyACM0", "auto", "none", "simulation: {}", "beside real instruments"),
        ("/dev/ttyACM0", "auto", "triggerscope_ttl", "", "needs mirror triggerscope with its shutter_pin"),
        ("/dev/ttyACM0", "auto", "none", "safety: {watchdog_s: 0.05}", "at least 0.1 s"),
        ("/dev/ttyACM0", "auto", "lid", "", "triggerscope_ttl"),
        ("/dev/ttyACM0", "auto", "none", "safety: {dry_run: 1}", "dry_run"),
        ("/dev/ttyACM0", "auto", "none", "alignment: {longest_s: 0.1}", "longest_s: .* equal to 0.2"),
        ("/dev/ttyACM0", "auto", "none", "alignment: {duty: 0.1, period_s: 0.5}", "0.05 s at a time.* Raise period_s"),
    ],
)
def test_a_bench_file_that_does_not_fit_together_is_refused(
    port: str, usb: str, shutter: str, more: str, message: str
) -> None:
    text = TEXT.replace("PORT", port).replace("USB", usb).replace("SHUTTER", shutter) + more
    with pytest.raises(ConfigError, match=message):
        parse(text, "bench.yaml", BenchSettings)


def test_a_bench_without_shutter_or_watchdog_says_so() -> None:
    ttl = settings().model_dump(mode="json")
    ttl["mirror"]["shutter_pin"] = 9
    ttl["shutter"]["model"] = "triggerscope_ttl"
    with open_bench(BenchSettings.model_validate_json(json.dumps(ttl))) as opened:
        assert opened.simulated is not None
        opened.shutter.open()
        assert opened.simulated.shutter_open
        opened.shutter.close()
        assert not opened.simulated.shutter_open
        assert "no watchdog: if the computer freezes or kills this program, the shutter stays open" in opened.warnings
    without = ttl | {"shutter": {"model": "none"}, "safety": {"watchdog_s": 0.0}}
    events: list[tuple[str, str]] = []
    with open_bench(BenchSettings.model_validate_json(json.dumps(without))) as opened:
        opened.on_event = lambda kind, text: events.append((kind, text))
        assert ("warning", "this bench has no shutter: nothing here can shut off the light") in events


def test_a_program_of_coroutines_is_warned_once_and_the_recording_keeps_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The command line says what `warnings` holds and what is logged."""
    ttl = settings().model_dump(mode="json")
    ttl["mirror"]["shutter_pin"] = 9
    ttl["shutter"]["model"] = "triggerscope_ttl"
    real, events = threading.get_ident, list[tuple[str, str]]()
    for as_gevent in (False, True):
        if as_gevent:
            monkeypatch.setattr(threading, "get_ident", lambda: real())
            monkeypatch.setattr(threading.Thread, "start", lambda thread: None)  # light of 0 s has no need of it
        with open_bench(BenchSettings.model_validate_json(json.dumps(ttl))) as opened:
            monkeypatch.setattr(type(opened.clock), "passes_by_itself", True)
            opened.on_event = lambda kind, text: events.append((kind, text))
            opened.shutter.open()
            opened.shutter.close()
            told = [*opened.warnings, *(record.getMessage() for record in caplog.records)]
        assert (told.count(COROUTINES), events.count(("warning", COROUTINES))) == (as_gevent, as_gevent)
