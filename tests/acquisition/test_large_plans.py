"""Plans of many points are checked and forecast in one go, with the answers that each point would have got."""

from collections.abc import Callable

import numpy as np
import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import choose
from nlos.acquisition.planning.timing import moves_s
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles, surely_reached
from nlos.drivers.galvo.settle import SettleModel

BENCHES = ("simulated", "helios", "optotune")


@pytest.mark.parametrize("name", BENCHES)
def test_a_plan_costs_no_question_per_point(
    name: str,
    bench_settings: Callable[..., BenchSettings],
    small_plan: Callable[..., ScanPlan],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """2,500 points, in a plan whose film would have millions."""
    plan, asked = small_plan(50, 50), []
    with open_bench(bench_settings(name=name)) as bench:
        check, steps = type(bench.mirror).check, SettleModel.axis_settle_s
        monkeypatch.setattr(
            type(bench.mirror), "check", lambda mirror, angles: [asked.append("check"), check(mirror, angles)][1]
        )
        angles = checked_angles(plan, bench, aim_of(bench))
        choose(plan, bench, angles)
        assert asked.count("check") < 100
        monkeypatch.setattr(
            SettleModel, "axis_settle_s", lambda model, step_rad: asked.append("settle") or steps(model, step_rad)
        )
        moves_s(bench, angles)
        assert "settle" not in asked


@pytest.mark.parametrize("name", BENCHES)
def test_what_is_said_to_be_reached_at_once_is_reached_point_by_point(
    name: str, bench_settings: Callable[..., BenchSettings]
) -> None:
    """Rectangles of angles of every size and place, those across a head's limits among them."""
    draw, said = np.random.default_rng(5), []
    with open_bench(bench_settings(name=name)) as bench:
        for _ in range(150):
            x_rad, y_rad = draw.uniform(-0.5, 0.5, 2)[:, None] + draw.uniform(0.01, 0.6) * draw.uniform(-1, 1, (2, 30))
            refused = 0
            for each in zip(x_rad.tolist(), y_rad.tolist(), strict=True):
                try:
                    bench.mirror.check(MirrorAngles(*each))
                except LimitError:
                    refused += 1
            surely = surely_reached(bench.mirror, x_rad, y_rad)
            assert not (surely and refused)
            said.append((surely, refused > 0))
        assert {(True, False), (False, True)} <= set(said)
        assert not surely_reached(bench.mirror, np.array([0.0, np.nan]), np.zeros(2))


def test_the_first_point_out_of_reach_is_named_of_many(
    bench_settings: Callable[..., BenchSettings], small_plan: Callable[..., ScanPlan]
) -> None:
    """A serpentine from the top left: on a wall 1.6 m wide, 1 m away, the head's 40 degrees optical end at 0.839 m."""
    wall = {"width_m": 1.8, "height_m": 0.2, "rows": 3, "cols": 60}
    settings = bench_settings()
    near = settings.geometry.model_copy(update={"wall_distance_m": 1.0, "mirror_separation_m": 0.0})
    plan = small_plan(wall=wall)
    first_x_m = -0.9 + 0.015
    assert np.degrees(np.arctan(-first_x_m)) > 40
    with (
        open_bench(settings.model_copy(update={"geometry": near})) as bench,
        pytest.raises(LimitError, match=rf"x = {first_x_m:+.3f} m, y = \+0.067 m: mirror x = -41"),
    ):
        checked_angles(plan, bench, aim_of(bench))
