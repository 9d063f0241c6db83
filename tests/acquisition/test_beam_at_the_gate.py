"""While a gate is open the beam is on the point that the plan says: every shipped scan, every bench, every scheme.

The witness is the simulated table itself, which knows where the beam was.
"""

import os
from itertools import groupby
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, beam_within_px, checked_angles
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme, choose
from nlos.acquisition.scanning.engine import scan
from nlos.acquisition.scanning.lag import Lag
from nlos.configs.load import load, names
from nlos.drivers.bench import Bench, BenchSettings, open_bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate

SOAK = os.environ.get("NLOS_SOAK") == "1"
BENCHES: dict[str, tuple[str, str | None, Scheme]] = {
    "S1": ("simulated", None, Scheme.STEPPED),
    "S2": ("simulated", None, Scheme.CLOCKED),
    "S3": ("simulated", "t3", Scheme.LISTED),
    "S2, no latency": ("zero_latency", None, Scheme.CLOCKED),
    "S2, noisy": ("noisy", None, Scheme.CLOCKED),
    "S2, drawn": ("drawn", None, Scheme.CLOCKED),
    "S1, optotune": ("optotune", None, Scheme.STEPPED),
    "S3, multiharp": ("multiharp", None, Scheme.LISTED),
}
SAMPLE = {"five_by_five", "circle"}
CASES = [(name, kind) for name in names("scan") for kind in BENCHES if SOAK or name in SAMPLE]


def settings_of(name: str, mode: str | None = None) -> BenchSettings:
    settings = load("bench", name, BenchSettings).settings
    if mode is None:
        return settings
    return settings.model_copy(update={"counter": settings.counter.model_copy(update={"mode": mode})})


def plan_of(name: str, kind: str) -> ScanPlan:
    settings = load("scan", name, ScanSettings).settings
    changes: dict[str, Any] = {"continuous": None}
    if kind.endswith(
        "multiharp"
    ):  # its bins are 5 ps times a power of two, its dwells whole milliseconds, without stop
        histogram = settings.histogram.model_copy(update={"bins": 256, "bin_width_ps": 40.0})
        whole = max(1.0, round(settings.dwell_ms))
        changes |= {
            "histogram": histogram,
            "dwell_ms": whole,
            "exposure": ScanSettings.model_fields["exposure"].default,
        }
    return settings.model_copy(update=changes).plan()


def dark(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
    """A detector that is quickly drawn: one count a gate."""
    counts = np.zeros(gate.bins, np.uint32)
    counts[0] = 1
    return Exposure(counts, gate.dwell_s, round(gate.dwell_s * 10e6), 1, False)


def off_px(plan: ScanPlan, bench: Bench, number: int, beam: MirrorAngles) -> float:
    x_m, y_m = aim_of(bench).wall_point(beam)
    columns, wall = plan.positions, plan.wall
    across = (x_m - columns.x_m[number]) / wall.width_m * wall.cols
    return float(np.hypot(across, (y_m - columns.y_m[number]) / wall.height_m * wall.rows))


@pytest.mark.sampled(2)
@pytest.mark.soak
@pytest.mark.parametrize(("name", "kind"), CASES)
def test_the_beam_rests_on_every_point_while_its_gate_is_open(name: str, kind: str) -> None:
    bench_name, mode, scheme = BENCHES[kind]
    plan = plan_of(name, kind)
    gates: list[tuple[Gate, MirrorAngles]] = []
    with open_bench(settings_of(bench_name, mode)) as bench:
        assert bench.simulated is not None
        table = bench.simulated
        table.light = dark
        table.on_gate = lambda gate, beam: gates.append((gate, beam))
        if plan.stop is not None and mode == "t3":  # records cannot end a point by its counts
            with pytest.raises(LimitError, match="needs histogram mode"):
                checked_angles(plan, bench, aim_of(bench))
            return
        angles = checked_angles(plan, bench, aim_of(bench))
        bound_px = beam_within_px(plan, bench, angles)
        taken = [sample.point.number for sample in scan(plan, bench, scheme=scheme)]
        assert bound_px <= 0.25
        if kind.endswith("multiharp"):  # its gates bear no numbers: the beam rests on one point after the other
            rests = [beam for _, beam in gates if not _.track]
            numbers = [_nearest(plan, bench, beam) for beam, _ in groupby(rests)]
            assert max(off_px(plan, bench, n, beam) for n, (beam, _) in zip(numbers, groupby(rests), strict=True)) <= (
                bound_px
            )
            steps = iter(numbers)
            places = [_first_at(plan, number) for number in taken]  # frames come to the same points again
            assert all(number in steps for number, _ in groupby(places))
            return
        seen = {gate.number: (gate, beam) for gate, beam in gates if gate.number is not None}
        assert set(taken) <= set(seen)
        assert not any(seen[number][0].track for number in taken)
        assert max(off_px(plan, bench, number, seen[number][1]) for number in taken) <= bound_px


def _first_at(plan: ScanPlan, number: int) -> int:
    """The first point of the plan that lies where this one does."""
    x_m, y_m = plan.positions.x_m, plan.positions.y_m
    return int(np.argmin((x_m - x_m[number]) ** 2 + (y_m - y_m[number]) ** 2))


def _nearest(plan: ScanPlan, bench: Bench, beam: MirrorAngles) -> int:
    x_m, y_m = aim_of(bench).wall_point(beam)
    return int(np.argmin((plan.positions.x_m - x_m) ** 2 + (plan.positions.y_m - y_m) ** 2))


@pytest.mark.soak
@pytest.mark.parametrize("bench_name", ["simulated", "noisy"] if SOAK else ["simulated"])
def test_the_shipped_continuous_scan_is_where_it_says(bench_name: str) -> None:
    plan = load("scan", "video", ScanSettings).settings.plan()
    settings = settings_of(bench_name)
    assert settings.simulation is not None
    bare = settings.simulation.scene.model_copy(update={"objects": ()})
    settings = settings.model_copy(update={"simulation": settings.simulation.model_copy(update={"scene": bare})})
    beams: dict[int | None, MirrorAngles] = {}
    lags: list[Lag] = []
    with open_bench(settings) as bench:
        assert bench.simulated is not None
        assert choose(plan, bench, checked_angles(plan, bench, aim_of(bench))).scheme is Scheme.SWEPT
        bench.on_event = lambda kind, text: lags.append(Lag.of_text(text)) if kind == "lag" else None
        bench.simulated.on_gate = lambda gate, beam: beams.__setitem__(gate.number, beam)
        taken = [sample.point.number for sample in scan(plan, bench)]
        worst_px = max(off_px(plan, bench, number, beams[number]) for number in taken)
    assert taken == list(range(len(plan)))
    assert worst_px <= lags[0].within_px <= 0.25
