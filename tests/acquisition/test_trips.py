"""However a scan is clocked and whoever drives the shutter: within 20 ms of a trip, or of a cable being pulled, it is
told to close."""

import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.engine import scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.clock import Clock
from nlos.drivers.errors import DeviceLost, DeviceReset, SafetyTrip
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plugged
from nlos.drivers.simulated.tcspc488.protection import Protection

Plans = Callable[..., ScanPlan]
WITHIN_S = 0.02
CLOSES = {"tcspc488": b"OUTP:SHUT CLOS", "triggerscope_ttl": b"SDO1-0"}
SCHEMES = {"S1": (Scheme.STEPPED, "histogram"), "S1 in T3 mode": (Scheme.STEPPED, "t3"),
           "S2": (Scheme.CLOCKED, "histogram"), "S3": (Scheme.LISTED, "t3")}  # fmt: skip


def changed(file: str, **blocks: dict[str, Any]) -> BenchSettings:
    text: dict[str, Any] = load("bench", file, BenchSettings).settings.model_dump(mode="json")
    text["simulation"]["scene"]["surfel_m"] = 0.05
    for name, values in blocks.items():
        text[name] |= values
    return BenchSettings.model_validate_json(json.dumps(text))


def bench_with(shutter: str, mode: str) -> BenchSettings:
    return changed("simulated", shutter={"model": shutter}, mirror={"shutter_pin": 16}, counter={"mode": mode})


@pytest.fixture
def trips_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """When, on the bench's clock, the instrument tripped."""
    moments: list[float] = []
    due = Protection.due

    def listen(self: Protection, when_s: float) -> int:
        code = due(self, when_s)
        if code:
            moments.append(when_s)
        return code

    monkeypatch.setattr(Protection, "due", listen)
    return moments


@pytest.mark.parametrize("shutter", CLOSES)
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("dwell_ms", "after_s"), [(8, 0.05), (8, 0.11), (300, 0.5), (2000, 0.1), (2000, 3.0)])
def test_a_trip_is_answered_within_its_time(
    small_plan: Plans, trips_s: list[float], shutter: str, scheme: str, dwell_ms: int, after_s: float
) -> None:
    chosen, mode = SCHEMES[scheme]
    sent: list[tuple[float, bytes]] = []
    events: list[tuple[str, bool]] = []
    clocks: list[Clock] = []

    def log(device: str, way: str, data: bytes) -> None:
        if clocks:
            sent.append((clocks[0].now(), data))

    with open_bench(bench_with(shutter, mode), wire_log=log) as bench:
        simulated = bench.simulated
        assert simulated is not None
        clocks.append(bench.clock)
        bench.on_event = lambda kind, text: events.append((kind, simulated.shutter_open))
        simulated.faults.add(Fault(name="U14", after_s=bench.clock.now() + after_s))
        with pytest.raises(SafetyTrip, match="rate"):
            list(scan(small_plan(dwell_ms=dwell_ms), bench, scheme=chosen))
        answered_s = next(when_s for when_s, data in sent if CLOSES[shutter] in data and when_s >= trips_s[0])
        assert answered_s - trips_s[0] <= WITHIN_S
        assert ("trip", False) in events
        assert ("trip", True) not in events
        with pytest.raises(SafetyTrip):
            bench.shutter.open()
        assert not simulated.shutter_open


@pytest.mark.parametrize(
    ("cable", "shutter"), [("G8", "tcspc488"), ("U11", "triggerscope_ttl")], ids=["the mirror's", "the counter's"]
)
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(("dwell_ms", "after_s"), [(8, 0.053), (8, 0.117), (300, 0.5), (2000, 0.77), (2000, 3.03)])
def test_a_pulled_cable_is_noticed_while_points_are_waited_for(
    small_plan: Plans, cable: str, shutter: str, scheme: str, dwell_ms: int, after_s: float
) -> None:
    chosen, mode = SCHEMES[scheme]
    sent: list[tuple[float, bytes]] = []
    clocks: list[Clock] = []

    def log(device: str, way: str, data: bytes) -> None:
        if clocks and way == ">":
            sent.append((clocks[0].now(), data))

    with suppress(DeviceLost), open_bench(bench_with(shutter, mode), wire_log=log) as bench:
        simulated = bench.simulated
        assert simulated is not None
        clocks.append(bench.clock)
        pulled_s = bench.clock.now() + after_s
        simulated.faults.add(Fault(name=cable, after_s=pulled_s))
        with pytest.raises(DeviceLost):
            list(scan(small_plan(dwell_ms=dwell_ms), bench, scheme=chosen))
    answered_s = next(when_s for when_s, data in sent if CLOSES[shutter] in data and when_s >= pulled_s)
    assert answered_s - pulled_s <= WITHIN_S
    assert not simulated.shutter_open


@pytest.mark.parametrize("scheme", ["S2", "S3"])
def test_a_mirror_controller_that_restarts_while_it_steps_ends_the_scan(small_plan: Plans, scheme: str) -> None:
    chosen, mode = SCHEMES[scheme]
    looks = 0
    with open_bench(bench_with("tcspc488", mode)) as bench:

        def look() -> None:
            nonlocal looks
            looks += 1
            if looks == 5:
                plugged("triggerscope").say(plugged("triggerscope").firmware.reboot())
            bench.mirror.look()

        bench.counter.meanwhile(look)
        with pytest.raises(DeviceReset):
            list(scan(small_plan(), bench, scheme=chosen))
    assert looks == 5
    assert bench.simulated is not None
    assert not bench.simulated.shutter_open
