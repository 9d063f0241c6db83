"""A plan of candidates: what comes next is advised or comes coarse to fine, each point once, within its time."""

import json
import os
import random
import signal
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.errors import PlanRefused
from nlos.acquisition.planning.budget import Budget
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles, fitted
from nlos.acquisition.planning.schemes import choose
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.replay import replay
from nlos.acquisition.recording.salvage import resume, settle
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.advice import Advice, Adviser, Reason, reasons
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import BenchSettings, open_bench
from tests.acquisition.killed_scans import FORK, Acknowledging, facts

BENCHES = ("zero_latency", "multiharp", "helios", "optotune", "timetagger")


def plan_of(small_plan: Any, seconds: float = 0.25, side: int = 8, **pattern: Any) -> ScanPlan:
    """By default 8 x 8 candidates of 1 and 2 ms, of which 166 ms of 1 ms and half a millisecond each fit."""
    chosen = {"kind": "adaptive", "seconds": seconds, "step_ms": 0.5, "lengths": 2, "batch": 10, **pattern}
    plan: ScanPlan = small_plan(side, side, pattern=chosen, dwell_ms=1)
    return plan


class Says:
    """An adviser who says what a function of (taken, left) says."""

    def __init__(self, say: Any) -> None:
        self.say = say

    def advise(self, taken: Collection[int], left_us: int) -> Advice | None:
        found: Advice | None = self.say(taken, left_us)
        return found


def backwards(plan: ScanPlan) -> Says:
    """From the plan's end: the longest dwells first."""

    def say(taken: Collection[int], left_us: int) -> Advice | None:
        assert plan.budget is not None
        costs_us = plan.budget.costs_us(plan.dwell_s)
        open_ = [n for n in range(len(plan) - 1, -1, -1) if n not in taken and costs_us[n] <= left_us]
        one = [n for n in open_ if plan.pass_[n] == plan.pass_[open_[0]]] if open_ else []
        return Advice(one, "from the end") if one else None

    return Says(say)


def run(
    path: Path, plan: ScanPlan, settings: BenchSettings, adviser: Adviser | None = None, writer: Any = None
) -> ScanState:
    """What `nlos scan --resume` does, events included."""
    control = ScanControl()
    with open_bench(settings) as bench:
        plan = fitted(plan, bench)
        resumed = resume(path, plan, Header(bench_json=settings.model_dump_json()))
        if resumed.writer is None:
            return ScanState.COMPLETE
        with resumed.writer as opened:
            bench.on_event = lambda kind, text: opened.log(kind, text)
            samples = scan(
                plan, bench, taken=resumed.taken, elapsed_s=resumed.elapsed_s, control=control, adviser=adviser
            )
            record(samples, writer(opened) if writer else opened)
            bench.on_event = None
            opened.finish(Status.COMPLETE if control.state is ScanState.COMPLETE else Status.INTERRUPTED)
    return control.state


def why(path: Path) -> list[Reason]:
    with Recording.open(path) as recording:
        return reasons([(event.kind, event.text) for event in recording.events()], len(recording))


def numbers(path: Path) -> list[int]:
    with Recording.open(path) as recording:
        return [sample.point.number for sample in recording.samples()]


def cost_us(plan: ScanPlan, taken: list[int]) -> int:
    assert plan.budget is not None
    return int(plan.budget.costs_us(plan.dwell_s[taken]).sum())


@pytest.mark.parametrize("bench", BENCHES)
def test_without_advice_a_scan_is_coarse_to_fine_and_ends_with_its_time(
    run_path: Path, small_plan: Any, bench_settings: Any, bench: str
) -> None:
    plan = plan_of(small_plan, 0.075)
    assert run(run_path, plan, bench_settings(name=bench)) is ScanState.COMPLETE
    taken = numbers(run_path)
    assert len(taken) == 50 == plan.most_samples  # 1.5 ms each
    for first in range(0, 50, 10):
        assert set(taken[first : first + 10]) == set(range(first, min(first + 10, 50)))
    assert [(each.first, each.count, each.dwell_s) for each in why(run_path)] == [
        (k, 10, 1e-3) for k in range(0, 50, 10)
    ]
    assert {each.why for each in why(run_path)} == {"coarse to fine"}
    found = verify(run_path)
    assert found.complete
    assert found.planned == 50


@pytest.mark.parametrize("step_ms", [0.2, 3.0])
@pytest.mark.parametrize("longest", [False, True])
def test_the_forecast_holds_whatever_is_advised(
    small_plan: Any, bench_settings: Any, longest: bool, step_ms: float
) -> None:
    """Points beside their dwell cost the budget more than the bench, or less."""
    plan = plan_of(small_plan, 3.0, 24, step_ms=step_ms, lengths=3, batch=64)
    with open_bench(bench_settings(name="simulated")) as bench:
        low_s, high_s = choose(plan, bench, checked_angles(plan, bench, aim_of(bench))).forecast.band_s
        began_s = bench.clock.now()
        assert list(scan(plan, bench, adviser=backwards(plan) if longest else None))
        assert low_s <= bench.clock.now() - began_s <= high_s


@pytest.mark.parametrize("bench", BENCHES)
def test_advice_is_followed_every_point_is_taken_once_and_the_time_is_kept(
    run_path: Path, small_plan: Any, bench_settings: Any, bench: str
) -> None:
    plan = plan_of(small_plan)
    assert run(run_path, plan, bench_settings(name=bench), backwards(plan)) is ScanState.COMPLETE
    taken = numbers(run_path)
    assert len(set(taken)) == len(taken)
    assert set(range(64, 128)) < set(taken)  # all 64 of 2 ms, and what is left of the time for those of 1 ms
    assert plan.budget is not None
    assert plan.budget.total_us - 1500 < cost_us(plan, taken) <= plan.budget.total_us
    assert {each.why for each in why(run_path)} == {"from the end"}
    assert sum(each.count for each in why(run_path)) == len(taken)
    assert verify(run_path).complete


def test_a_point_holds_the_same_photons_whoever_had_it_taken_when(
    run_path: Path, small_plan: Any, bench_settings: Any
) -> None:
    plan, other = plan_of(small_plan), run_path.with_name("other.h5")
    run(run_path, plan, bench_settings())
    run(other, plan, bench_settings(), backwards(plan))
    one, two = ({fact[0].number: fact[1] for fact in facts(path)} for path in (run_path, other))
    both = one.keys() & two.keys()
    assert len(both) > 60
    assert all(one[number] == two[number] for number in both)
    assert len({one[number] for number in both}) > 50


@pytest.mark.parametrize(
    ("absurd", "fault"),
    [
        (lambda taken: [9999], "point 9999 of a plan of 128"),
        (lambda taken: [-1], "point -1 of a plan of 128"),
        (lambda taken: [0.5], "point 0.5 of a plan of 128"),
        (lambda taken: [*taken][:1] or [100], "is taken already"),
        (lambda taken: [127, 127], "names a point twice"),
        (lambda taken: [127, 3], "different dwells"),
        (lambda taken: [], "names no point"),
    ],
)
def test_absurd_advice_is_refused_and_the_scan_goes_on(
    run_path: Path, small_plan: Any, bench_settings: Any, absurd: Any, fault: str
) -> None:
    plan = plan_of(small_plan, 0.06)
    adviser = Says(lambda taken, left_us: Advice(absurd(taken), "absurd"))
    assert run(run_path, plan, bench_settings(), adviser) is ScanState.COMPLETE
    with Recording.open(run_path) as recording:
        refused = [event.text for event in recording.events() if event.kind == "advice"]
    assert any(text.startswith("refused (absurd): ") and fault in text for text in refused)
    assert "coarse to fine: no advice in time" in {each.why for each in why(run_path)}
    assert verify(run_path).complete


def test_an_adviser_who_fails_ends_no_scan(run_path: Path, small_plan: Any, bench_settings: Any) -> None:
    def fails(taken: Collection[int], left_us: int) -> Advice:
        raise ZeroDivisionError("of my own")

    plan = plan_of(small_plan, 0.06)
    assert run(run_path, plan, bench_settings(), Says(fails)) is ScanState.COMPLETE
    with Recording.open(run_path) as recording:
        assert "none: ZeroDivisionError: of my own" in {event.text for event in recording.events()}


def killed_at(count: int, path: Path, plan: ScanPlan, settings: BenchSettings) -> None:
    """Leaves what an advised scan leaves that is killed when so many samples are acknowledged."""

    class Deadly(Acknowledging):
        def write(self, sample: Sample) -> None:
            super().write(sample)
            if self.writer.acknowledged == count:
                os.kill(os.getpid(), signal.SIGKILL)

    def dies() -> None:
        run(path, plan, settings, backwards(plan), lambda writer: Deadly(writer, None, True))

    child = FORK.Process(target=dies)
    child.start()
    child.join()


@pytest.mark.usefixtures("one_child_reads")
@pytest.mark.parametrize("seed", range(3))
def test_killed_in_any_batch_and_resumed_it_goes_on_within_its_time(
    run_path: Path, small_plan: Any, bench_settings: Any, seed: int
) -> None:
    plan, settings = plan_of(small_plan), bench_settings()
    undisturbed = run_path.with_name("undisturbed.h5")
    run(undisturbed, plan, settings, backwards(plan))
    expected = {fact[0].number: fact[1] for fact in facts(undisturbed)}
    count = random.Random(seed).randrange(1, len(expected))
    killed_at(count, run_path, plan, settings)
    before = numbers(run_path)
    assert len(before) == count
    assert verify(run_path).missing
    assert run(run_path, plan, settings, backwards(plan)) is ScanState.COMPLETE
    assert numbers(run_path)[:count] == before
    assert {fact[0].number: fact[1] for fact in facts(run_path)} == expected
    assert [each.first for each in why(run_path)] == sorted({each.first for each in why(run_path)})
    assert sum(each.count for each in why(run_path)) == len(expected)
    assert settle(run_path, plan)


def test_a_recording_replays_bit_for_bit_with_its_reasons(run_path: Path, small_plan: Any, bench_settings: Any) -> None:
    plan, again = plan_of(small_plan), run_path.with_name("again.h5")
    run(run_path, plan, bench_settings(), backwards(plan))
    with Recording.open(run_path) as recording:
        assert recording.plan == plan
        assert ScanPlan.from_parts(json.loads(json.dumps(plan.scalars())), plan.columns()) == plan
        with RecordingWriter.create(again, recording.plan, recording.header) as writer:
            for sample in replay(recording, None):
                writer.write(sample)
            writer.finish(Status.COMPLETE)
    assert facts(again) == facts(run_path)
    assert verify(again).complete


def test_a_crash_between_reason_and_samples_leaves_the_later_reason() -> None:
    said = [
        ("batch", "from sample 0: 10 points of 1 ms, coarse to fine"),
        ("scan", "paused"),
        ("batch", "from sample 10: 10 points of 1 ms, wide"),
        ("batch", "from sample 4: 10 points of 0.5 ms, bright"),
        ("batch", "no line that says so"),
    ]
    assert reasons(said, 12) == [Reason(0, 4, 1e-3, "coarse to fine"), Reason(4, 8, 0.5e-3, "bright")]


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ({"exposure": {"kind": "two_pass", "counts": 3, "again_ms": 2}}, "exposure"),
        ({"frames": 2}, "frames"),
        ({"continuous": {}}, "continuous"),
        ({"order": "strips", "interleave": 2, "frames": 2}, "frames and interleave and order"),
        ({"pattern": {"kind": "adaptive", "seconds": 0.001, "step_ms": 0.5}}, "do not hold a single point"),
        ({"pattern": {"kind": "adaptive", "seconds": 1000}}, "leave nothing to choose"),
        ({"pattern": {"kind": "adaptive", "seconds": 0.8, "batch": 1, "step_ms": 0}}, "raise batch to 2"),
    ],
)
def test_what_would_decide_the_same_otherwise_is_refused_by_name(small_plan: Any, more: Any, named: str) -> None:
    chosen = {"pattern": {"kind": "adaptive", "seconds": 0.05}, "dwell_ms": 1, **more}
    with pytest.raises(PlanRefused, match=named):
        small_plan(32, 32, **chosen)


def test_a_budget_takes_the_first_that_fit() -> None:
    budget = Budget(10_000, 500, 4)
    costs_us = budget.costs_us(np.array([1e-3, 2e-3, 4e-3, 8e-3]))
    assert costs_us.tolist() == [1500, 2500, 4500, 8500]
    assert [budget.first(costs_us, left_us) for left_us in (1499, 1500, 8499, 8500)] == [0, 1, 2, 3]
    assert budget.most(costs_us[::-1].copy()) == 3
    with pytest.raises(ValueError, match="budget"):
        Budget(0, 0, 1)
