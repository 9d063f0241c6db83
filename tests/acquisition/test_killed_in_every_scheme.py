"""A scan killed at any moment, in every scheme that rests on its points, loses nothing acknowledged and resumes to the
same counts. Continuous lines: `test_sweeping.py`."""

import os
import random
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Scheme, choose
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.verification import verify
from nlos.drivers.bench import BenchSettings, open_bench
from tests.acquisition.killed_scans import FORK, facts, go_on

SOAK = os.environ.get("NLOS_SOAK") == "1"
LISTED = {"histogram": {"bins": 64, "bin_width_ps": 320, "offset_ns": 9.6}}
SCHEMES: dict[str, tuple[Scheme, dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "stepped": (Scheme.STEPPED, {"markers": False}, {}, {}),
    "clocked": (Scheme.CLOCKED, {"name": "simulated"}, {}, {}),
    "listed": (Scheme.LISTED, {"name": "simulated"}, {"mode": "t3"}, {}),
    "multiharp": (Scheme.LISTED, {"name": "multiharp"}, {}, LISTED),
    "timetagger": (Scheme.LISTED, {"name": "timetagger"}, {}, LISTED),
    "played": (Scheme.PLAYED, {"name": "helios"}, {}, {}),
}
"""Name -> scheme, bench, what its counter is told, plan."""
KILLS = 500 if SOAK else len(SCHEMES)


@dataclass(frozen=True)
class Undisturbed:
    """A scan that nobody kills: its bench, its plan, what it holds, and how long it takes."""

    settings: BenchSettings
    plan: ScanPlan
    holds: list[tuple[Any, ...]]
    duration_s: float


@pytest.fixture(scope="module")
def undisturbed(
    tmp_path_factory: pytest.TempPathFactory, small_plan: Callable[..., ScanPlan], bench_settings: Any
) -> Callable[[str], Undisturbed]:
    """undisturbed(scheme): such a scan, taken twice."""

    @cache
    def of(scheme: str) -> Undisturbed:
        expected, bench, told, wanted = SCHEMES[scheme]
        settings = bench_settings(**bench)
        settings = settings.model_copy(update={"counter": settings.counter.model_copy(update=told)})
        plan, path = small_plan(12, 12, **wanted), tmp_path_factory.mktemp("undisturbed") / "run.h5"
        with open_bench(settings) as opened:
            assert choose(plan, opened, checked_angles(plan, opened, aim_of(opened))).scheme is expected
        go_on(path, plan, settings)
        started = time.monotonic()
        path.unlink()
        go_on(path, plan, settings)
        return Undisturbed(settings, plan, facts(path), time.monotonic() - started)

    return of


def killed_after(seconds: float, *args: Any) -> None:
    child = FORK.Process(target=go_on, args=args)
    child.start()
    child.join(seconds)
    child.kill()
    child.join()


@pytest.mark.soak
@pytest.mark.parametrize("seed", range(KILLS))
def test_killed_at_a_random_moment_and_resumed_equals_undisturbed(
    run_path: Path, undisturbed: Callable[[str], Undisturbed], seed: int
) -> None:
    whole = undisturbed(list(SCHEMES)[seed % len(SCHEMES)])
    draw = random.Random(seed)
    told = FORK.Value("q", 0, lock=False)
    for _ in range(draw.choice([1, 1, 2, 3])):
        eager = draw.random() < 0.5
        killed_after(draw.uniform(0.0, 1.2 * whole.duration_s), run_path, whole.plan, whole.settings, told, eager)
        if told.value:
            assert facts(run_path)[: told.value] == whole.holds[: told.value]
    go_on(run_path, whole.plan, whole.settings)
    assert facts(run_path) == whole.holds
    found = verify(run_path)
    assert found.complete
    assert found.status is Status.COMPLETE
