"""Scans stepped by the counter's clock give what scans stepped by the host give, faster, and notice a lost step."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Scheme, choose, forecast
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.clocked import stepping
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import DeviceFault
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.settle import SettleModel
from nlos.drivers.simulated.faults import Fault

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


def taken(
    plan: ScanPlan, settings_: BenchSettings, scheme: Scheme, control: ScanControl | None = None
) -> tuple[list[Sample], list[str]]:
    """Samples and what was reported about them."""
    events: list[str] = []
    with open_bench(settings_) as bench:
        bench.on_event = lambda kind, text: events.append(text) if kind == "sample" else None
        samples = list(scan(plan, bench, scheme=scheme, control=control))
    return samples, events


def same(a: list[Sample], b: list[Sample]) -> bool:
    return [s.point for s in a] == [s.point for s in b] and np.array_equal(
        [s.histogram.counts for s in a], [s.histogram.counts for s in b]
    )


@pytest.mark.parametrize("pattern", ["serpentine", "raster", {"kind": "random", "points": 40, "seed": 3}])
def test_clock_and_host_give_the_same_histograms(bench_settings: Benches, small_plan: Plans, pattern: object) -> None:
    plan = small_plan(8, 8, pattern=pattern)
    stepped, _ = taken(plan, bench_settings(), Scheme.STEPPED)
    clocked, events = taken(plan, bench_settings(), Scheme.CLOCKED)
    assert [s.point for s in clocked] == list(plan)
    assert same(stepped, clocked)
    assert events == []


@pytest.mark.parametrize("scheme", [Scheme.STEPPED, Scheme.CLOCKED])
@pytest.mark.parametrize("held", [2, 5, 20])
def test_a_counter_that_holds_few_points_makes_the_same_scan_as_long_as_was_said(
    bench_settings: Benches, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, held: int, scheme: Scheme
) -> None:
    """Places that only wait for the mirror after a jump take room, too."""
    plan = small_plan(6, 6, pattern="raster")
    whole, _ = taken(plan, bench_settings(), scheme)
    monkeypatch.setattr("nlos.drivers.simulated.tcspc488.firmware.MAX_POINTS", held)
    with open_bench(bench_settings(name="simulated")) as bench:
        assert bench.counter.max_points == held
        predicted = forecast(scheme, plan, bench, checked_angles(plan, bench, aim_of(bench)))
        started_s = bench.clock.now()
        samples = list(scan(plan, bench, scheme=scheme))
        took_s = bench.clock.now() - started_s
    assert [s.point for s in samples] == list(plan)
    assert same(samples, whole)
    assert predicted.total_s == pytest.approx(took_s, rel=0.05)


@pytest.mark.parametrize("kind", ["missed", "extra"])
@pytest.mark.parametrize("skip", [0, 1, 70, 143])
def test_a_step_that_was_lost_or_came_twice_is_noticed_and_its_points_taken_again(
    bench_settings: Benches, small_plan: Plans, kind: str, skip: int
) -> None:
    plan = small_plan(12, 12)
    undisturbed, _ = taken(plan, bench_settings(), Scheme.CLOCKED)
    fault = Fault(name="A6", skip=skip, parameters={"kind": kind})
    samples, events = taken(plan, bench_settings(fault), Scheme.CLOCKED)
    assert same(samples, undisturbed)
    assert any("taken again" in text for text in events)


def test_a_point_that_the_counter_spoilt_is_taken_again(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan(12, 12)
    undisturbed, _ = taken(plan, bench_settings(), Scheme.CLOCKED)
    fault = Fault(name="U15", skip=50, parameters={"what": "late"})
    samples, events = taken(plan, bench_settings(fault), Scheme.CLOCKED)
    assert same(samples, undisturbed)
    assert any("taken again" in text for text in events)


def test_wires_that_never_agree_end_the_scan(bench_settings: Benches, small_plan: Plans) -> None:
    fault = Fault(name="A6", times=1000)
    with pytest.raises(DeviceFault, match="disagreed 3 times from point 0"):
        taken(small_plan(), bench_settings(fault), Scheme.CLOCKED)


def test_a_pause_in_a_sequence_loses_nothing(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan(12, 12)
    undisturbed, _ = taken(plan, bench_settings(), Scheme.CLOCKED)
    control = ScanControl(lambda why: True)
    with open_bench(bench_settings()) as bench:
        samples = []
        for sample in scan(plan, bench, scheme=Scheme.CLOCKED, control=control):
            samples.append(sample)
            if len(samples) in (1, 60):
                bench.shutter.close("signal")
                control.interrupt("Ctrl-C")
    assert same(samples, undisturbed)
    assert control.state is ScanState.COMPLETE


def test_photons_listed_one_by_one_make_the_same_scan(bench_settings: Benches, small_plan: Plans) -> None:
    plan = small_plan(6, 6, histogram={"bins": 512, "bin_width_ps": 40, "offset_ns": 10})
    multiharp = bench_settings(name="multiharp")
    with open_bench(multiharp) as bench:
        assert choose(plan, bench, [MirrorAngles(0.0, 0.0)] * 36).scheme is Scheme.LISTED
    samples, events = taken(plan, multiharp, Scheme.LISTED)
    assert [s.point for s in samples] == list(plan)
    assert events == []
    expected, _ = taken(
        small_plan(6, 6, histogram={"bins": 512, "bin_width_ps": 32, "offset_ns": 10}), bench_settings(), Scheme.STEPPED
    )
    totals = np.array([[int(s.histogram.counts.sum()) for s in source] for source in (samples, expected)])
    assert np.abs(np.diff(totals, axis=0)).max() < 6 * np.sqrt(totals.max())


@pytest.mark.parametrize(
    ("name", "markers", "rows", "scheme", "why"),
    [
        ("simulated", True, 32, Scheme.CLOCKED, "stepped by the host it would take"),
        ("simulated", True, 1, Scheme.STEPPED, "clocked it would take"),
        ("simulated", False, 32, Scheme.STEPPED, "not wired"),
        ("optotune", True, 32, Scheme.STEPPED, "cannot step by itself"),
    ],
)
def test_the_fastest_scheme_that_the_bench_allows_is_chosen_and_explained(
    bench_settings: Benches, small_plan: Plans, name: str, markers: bool, rows: int, scheme: Scheme, why: str
) -> None:
    plan = small_plan(rows, rows)
    events: list[tuple[str, str]] = []
    with open_bench(bench_settings(name=name, markers=markers)) as bench:
        bench.on_event = lambda kind, text: events.append((kind, text))
        samples = scan(plan, bench)
        next(samples)
        samples.close()
    said = next(text for kind, text in events if kind == "scheme")
    assert said.startswith(scheme.value)
    assert why in said


MODEL = SettleModel()


@settings(max_examples=60, deadline=None)
@given(
    places=st.lists(
        st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.sampled_from([0.001, 0.008])), min_size=1, max_size=60
    ),
    most=st.integers(2, 70),
    list_mode=st.booleans(),
)
def test_every_sequence_gives_each_point_its_dwell_after_its_settling(
    places: list[tuple[float, float, float]], most: int, list_mode: bool
) -> None:
    points = [ScanPoint(n, None, None, x, y, dwell_s) for n, (x, y, dwell_s) in enumerate(places)]
    angles = [MirrorAngles(x, y) for x, y, _ in places]
    made = stepping(points, angles, MODEL.settle_s, most, list_mode)
    assert 1 <= made.count <= len(points)
    assert len(made.index) <= most
    assert [i for i in made.index if i >= 0] == list(range(made.count))
    assert len(set(made.numbers)) == len(made.numbers)
    where, still_s = made.angles[0], np.inf
    for index, target, dwell_s in zip(made.index, made.angles, made.dwells_s, strict=True):
        if target != where:
            still_s = -MODEL.settle_s(where, target)
            where = target
        still_s += made.blanking_s
        if index >= 0:
            assert target == angles[index]
            assert dwell_s == points[index].dwell_s
            assert still_s > -1e-9
        still_s += dwell_s
    if list_mode:
        assert len(set(made.dwells_s)) == 1


@pytest.mark.parametrize("jump_rad", [0.15, 0.2, 0.6])
def test_no_gate_opens_before_a_long_jump_has_settled(jump_rad: float) -> None:
    """Rows of small steps with long ways back: those get an entry that waits, and no time more than they need."""
    places = [(step * 1e-3 + row % 2 * jump_rad, row * 1e-3) for row in range(6) for step in range(30)]
    points = [ScanPoint(n, None, None, x, y, 1e-3) for n, (x, y) in enumerate(places)]
    angles = [MirrorAngles(x, y) for x, y in places]
    made = stepping(points, angles, MODEL.settle_s, 500, list_mode=False)
    assert made.count == len(points)
    waits = [entry for entry, index in enumerate(made.index) if index < 0]
    assert len(waits) == 5
    for entry in waits:
        needed_s = MODEL.settle_s(made.angles[entry - 1], made.angles[entry])
        assert needed_s > 3 * made.blanking_s
        assert made.angles[entry + 1] == made.angles[entry]
        assert needed_s <= made.blanking_s + made.dwells_s[entry] + made.blanking_s < needed_s + 1.5e-6


def light(bench: Bench) -> bool:
    assert bench.simulated is not None
    return bench.simulated.shutter_open


def test_the_light_is_off_when_a_clocked_scan_is_given_up(bench_settings: Benches, small_plan: Plans) -> None:
    with open_bench(bench_settings()) as bench:
        samples = scan(small_plan(12, 12), bench, scheme=Scheme.CLOCKED)
        next(samples)
        assert light(bench)
        samples.close()
        assert not light(bench)
        assert len(list(scan(small_plan(), bench, scheme=Scheme.STEPPED))) == 36


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        ("zero_latency", Scheme.STEPPED),
        ("zero_latency", Scheme.CLOCKED),
        ("multiharp", Scheme.LISTED),
        ("helios", Scheme.PLAYED),
    ],
)
def test_light_comes_on_at_the_first_point(
    bench_settings: Benches, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, name: str, scheme: Scheme
) -> None:
    """From where it was parked, outside of what the bench allows perhaps, the beam goes there in the dark; so is the
    table of places sent, which takes a while."""
    bins = {"bins": 512, "bin_width_ps": 40 if name == "multiharp" else 32, "offset_ns": 10}
    plan, lit_at, lit_while_sent = small_plan(histogram=bins), list[MirrorAngles](), list[bool]()
    with open_bench(bench_settings(name=name)) as bench:
        table = bench.simulated
        assert table is not None
        first = checked_angles(plan, bench, aim_of(bench))[0]
        bench.on_event = lambda kind, text: lit_at.append(table.beam) if text == "opened" else None
        for word in ("load", "load_steps"):
            if (send := getattr(bench.mirror, word, None)) is not None:

                def sent(*what: object, send: Callable[..., None] = send) -> None:
                    send(*what)
                    lit_while_sent.append(table.shutter_open)

                monkeypatch.setattr(bench.mirror, word, sent)
        assert len(list(scan(plan, bench, scheme=scheme))) == len(plan)
    assert lit_while_sent == ([] if scheme is Scheme.STEPPED else [False])
    assert len(lit_at) == 1
    assert (lit_at[0].x_rad, lit_at[0].y_rad) == pytest.approx((first.x_rad, first.y_rad), abs=1e-3)
