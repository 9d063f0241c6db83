"""Too much light while a scan runs: it is off within the time that `nlos plan` states, however a scan is clocked and
whatever counts its photons, and what was taken before is kept. The simulated table itself says when."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.alarms import Alarms, AlarmSettings
from nlos.acquisition.scanning.clocked import BLOCK_S
from nlos.acquisition.scanning.engine import record, scan
from nlos.acquisition.scanning.light_watch import SHUT_WITHIN_S
from nlos.configs.load import load
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import SafetyTrip
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate, SimulatedBench

Plans = Callable[..., ScanPlan]
Witness = list[tuple[float, str]]
TTL = {"shutter": {"model": "triggerscope_ttl"}, "mirror": {"shutter_pin": 16}}
LEVELS: dict[str, Any] = {"sync": {}, "detector": {}}  # each family has its own
COUNTERS: dict[str, tuple[str, dict[str, Any]]] = {
    "tcspc488 histogram": ("simulated", {}),
    "tcspc488 t3": ("simulated", {"counter": {"mode": "t3"}}),
    "tcspc488 histogram, TTL shutter": ("simulated", TTL),
    "tcspc488 t3, TTL shutter": ("simulated", {"counter": {"mode": "t3"}} | TTL),
    "multiharp histogram": ("multiharp", {"counter": {"mode": "histogram"}}),
    "multiharp t3": ("multiharp", {}),
    "hydraharp histogram": ("multiharp", {"counter": {"mode": "histogram", "device": "hydraharp400", **LEVELS}}),
    "picoharp t3": ("multiharp", {"counter": {"device": "picoharp300", **LEVELS}}),
    "optotune and tcspc488": ("optotune", {}),
}
SCHEMES = {
    name: ["S1", *(["S2"] if name.startswith("tcspc488 hist") else ["S3"] if " t3" in name and "picoharp" not in name
    else [])]
    for name in COUNTERS
}  # fmt: skip
CASES = [(name, scheme) for name in COUNTERS for scheme in SCHEMES[name]]
DWELLS = [(2, 6, 0.03), (20, 6, 0.45), (150, 6, 1.53), (3000, 2, 4.1)]
TROUBLES = [(what, *each) for what in ("trip", "pile-up") for each in DWELLS] + [("skipped", 20, 6, 0.45)]
FACTOR = 20
"""How much brighter it becomes than the limit allows."""


def settings(name: str, **safety: Any) -> BenchSettings:
    file, changes = COUNTERS[name]
    text: dict[str, Any] = load("bench", file, BenchSettings).settings.model_dump(mode="json")
    text["simulation"]["scene"]["surfel_m"] = 0.05
    for block, values in {**changes, "safety": safety}.items():
        text[block] |= values
    return BenchSettings.model_validate_json(json.dumps(text))


def plan(small_plan: Plans, name: str, dwell_ms: float, rows: int = 6, cols: int = 6) -> ScanPlan:
    """With bins and offset that every one of these counters can take."""
    width_ps = 320 if name.startswith("multiharp") else 256
    offset_ns = 10.0 if "histogram" in name else width_ps * 40e-3
    histogram = {"bins": 64, "bin_width_ps": width_ps, "offset_ns": offset_ns}
    return small_plan(rows, cols, dwell_ms=dwell_ms, histogram=histogram)


def witness(bench: SimulatedBench) -> Witness:
    seen: Witness = []
    bench.witness = lambda when_s, what: seen.append((when_s, what))
    return seen


def light_s(seen: Witness) -> list[tuple[float, float]]:
    """When the light went on and off."""
    spans, since = [], None
    for when_s, what in seen:
        if what == "shutter open" and since is None:
            since = when_s
        elif what == "shutter closed" and since is not None:
            spans.append((since, when_s))
            since = None
    assert since is None
    return spans


def simulated(bench: Bench) -> SimulatedBench:
    assert bench.simulated is not None
    return bench.simulated


def brighter_from(bench: SimulatedBench, when_s: float) -> None:
    """Somebody carries a mirror past: from then on the detector sees `FACTOR` times as much."""
    before = bench.light

    def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
        seen = before(gate, beam, is_open)
        if not is_open or gate.opened_s < when_s:
            return seen
        return replace(seen, counts=seen.counts * np.uint32(FACTOR), total_count=seen.total_count * FACTOR)

    bench.light = light


def undisturbed(chosen: BenchSettings, points: ScanPlan, scheme: str) -> dict[int, bytes]:
    with open_bench(chosen) as bench:
        samples = scan(points, bench, scheme=Scheme(scheme))
        return {sample.point.number: sample.histogram.counts.tobytes() for sample in samples}


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("what", "dwell_ms", "rows", "after_s"), TROUBLES)
@pytest.mark.parametrize(("name", "scheme"), CASES)
def test_light_that_becomes_too_much_is_off_in_time_and_what_was_taken_is_kept(
    small_plan: Plans, run_path: Path, name: str, scheme: str, what: str, dwell_ms: float, rows: int, after_s: float
) -> None:
    dwell_ms = min(dwell_ms, 1500) if scheme == "S3" else dwell_ms  # a MultiHarp's clock has 1.677 s at most
    chosen = settings(name, **({"trip_cps": 300e3, "trip_ms": 1.0} if what == "trip" else {}))
    points = plan(small_plan, name, dwell_ms, rows, rows)
    limits = AlarmSettings.model_validate(
        {"pile_up": 1.0 if what == "trip" else 0.03, "on_count_rate": "skip" if what == "skipped" else "abort"}
    )
    with open_bench(chosen) as bench:
        seen = witness(simulated(bench))
        bright_s = bench.clock.now() + after_s
        brighter_from(simulated(bench), bright_s)
        alarms = Alarms(limits, chosen.laser.repetition_hz)
        with pytest.raises(SafetyTrip), RecordingWriter.create(run_path, points, Header()) as writer:
            record(scan(points, bench, scheme=Scheme(scheme), alarms=alarms), writer)
        off_s = [end_s for _, end_s in light_s(seen)]
        assert 0 <= off_s[0] - bright_s <= SHUT_WITHIN_S
    with Recording.open(run_path) as recording:
        kept = {sample.point.number: sample.histogram.counts.tobytes() for sample in recording.samples()}
        taken_s = sorted(sample.taken_s for sample in recording.samples())
    whole = undisturbed(chosen, points, scheme)
    assert kept == {number: whole[number] for number in kept}
    # Nothing but the last blocks, which nobody could confirm, is missing.
    assert len(kept) >= (after_s - 2 * BLOCK_S) * 1e3 / (dwell_ms + 2) - 2
    assert taken_s == sorted(taken_s)


@pytest.mark.parametrize("dwell_ms", [1, 2, 9])
@pytest.mark.parametrize(("name", "scheme"), CASES)
def test_a_trip_sees_dwells_that_are_shorter_than_it(
    small_plan: Plans, name: str, scheme: str, dwell_ms: float
) -> None:
    """Each of them says too little by itself: a whole scan went by above the limit."""
    chosen = settings(name, trip_cps=300e3, trip_ms=10.0)
    with open_bench(chosen) as bench:
        seen = witness(simulated(bench))
        bright_s = bench.clock.now() + 0.03
        brighter_from(simulated(bench), bright_s)
        points = plan(small_plan, name, dwell_ms, 12, 12)
        with pytest.raises(SafetyTrip):
            list(scan(points, bench, scheme=Scheme(scheme)))
        off_s = [end_s for _, end_s in light_s(seen)]
        assert off_s[0] - bright_s <= SHUT_WITHIN_S


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("name", "scheme"), CASES)
@pytest.mark.parametrize(("dwell_ms", "rows"), [(2, 12), (20, 6), (300, 3)])
def test_samples_are_handed_on_while_the_sequence_runs(
    small_plan: Plans, name: str, scheme: str, dwell_ms: float, rows: int
) -> None:
    with open_bench(settings(name)) as bench:
        alarms = Alarms(AlarmSettings(), bench.settings.laser.repetition_hz)
        alarms.wait_for_rates(bench)
        start_s = bench.clock.now()
        points = plan(small_plan, name, dwell_ms, rows, rows)
        for sample in scan(points, bench, scheme=Scheme(scheme), alarms=alarms):
            ended_s = start_s + sample.taken_s + dwell_ms * 1e-3
            assert bench.clock.now() - ended_s <= 2 * max(BLOCK_S, dwell_ms * 1e-3) + 0.06


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
def test_the_point_at_which_the_rate_meter_saw_too_much_is_the_one_that_is_put_off(
    small_plan: Plans, scheme: Scheme
) -> None:
    """A screw on the wall, say, seen in the middle of a long dwell: all others are taken before it is tried again."""
    chosen = settings("tcspc488 histogram")
    points, shiny = plan(small_plan, "tcspc488 histogram", 400, 2, 3), 2
    limits = AlarmSettings.model_validate({"pile_up": 0.03, "on_count_rate": "skip"})
    taken = list[int]()
    with open_bench(chosen) as bench:
        table, where = simulated(bench), checked_angles(points, bench, aim_of(bench))[shiny]
        before = table.light

        def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
            seen, far = before(gate, beam, is_open), math.hypot(beam.x_rad - where.x_rad, beam.y_rad - where.y_rad)
            if not is_open or far > 1e-3:
                return seen
            return replace(seen, counts=seen.counts * np.uint32(FACTOR), total_count=seen.total_count * FACTOR)

        table.light = light
        with pytest.raises(SafetyTrip, match="pile-up"):
            taken.extend(
                sample.point.number
                for sample in scan(points, bench, scheme=scheme, alarms=Alarms(limits, chosen.laser.repetition_hz))
            )
    assert taken == [number for number in range(len(points)) if number != shiny]
