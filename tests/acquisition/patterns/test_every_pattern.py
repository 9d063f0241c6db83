"""What every pattern promises: places on the wall, the same ones every time, on their pixels if they have any."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nlos.acquisition.errors import InvalidData, PlanRefused
from nlos.acquisition.planning.patterns import PATTERNS
from nlos.acquisition.planning.patterns.archimedean_spiral import ArchimedeanSpiral
from nlos.acquisition.planning.patterns.blue_noise import BlueNoise
from nlos.acquisition.planning.patterns.circle import Circle
from nlos.acquisition.planning.patterns.coarse_to_fine import CoarseToFine
from nlos.acquisition.planning.patterns.concentric_circles import ConcentricCircles
from nlos.acquisition.planning.patterns.fermat_spiral import FermatSpiral
from nlos.acquisition.planning.patterns.from_list import FromList
from nlos.acquisition.planning.patterns.jittered import Jittered
from nlos.acquisition.planning.patterns.random_pixels import RandomPixels
from nlos.acquisition.planning.patterns.serpentine import Serpentine
from nlos.acquisition.planning.patterns.subgrid import Subgrid
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.wall import WallGrid

EXAMPLES: dict[str, dict[str, Any]] = {
    "raster": {},
    "serpentine": {},
    "subgrid": {"rows": 3, "cols": 4},
    "jittered": {"rows": 4, "cols": 4, "seed": 5},
    "random": {"points": 30, "seed": 5},
    "blue_noise": {"points": 30, "seed": 5},
    "circle": {"points": 20, "radius_m": 0.3},
    "concentric_circles": {"circles": 3, "points": 40},
    "archimedean_spiral": {"dr_m": 0.07},
    "fermat_spiral": {"dr_m": 0.08},
    "coarse_to_fine": {"batch": 4},
    "adaptive": {"seconds": 0.5, "lengths": 1},
    "list": {},
}
FREE = {"circle", "concentric_circles", "archimedean_spiral", "fermat_spiral"}


@pytest.fixture
def points_file(tmp_path: Path) -> Path:
    path = tmp_path / "points.csv"
    path.write_text("x_m,y_m\n0.1,-0.2\n0,0\n-0.3,0.25\n", encoding="utf-8")
    return path


def plan_settings(kind: str, file: Path, rows: int = 12, cols: int = 10, **extra: Any) -> ScanSettings:
    example = EXAMPLES[kind] | ({"file": str(file)} if kind == "list" else {})
    document = {
        "wall": {"width_m": 1.0, "height_m": 0.8, "rows": rows, "cols": cols},
        "pattern": {"kind": kind, **example},
        "dwell_ms": 8,
        "histogram": {"bins": 64, "bin_width_ps": 16},
        **extra,
    }
    return ScanSettings.model_validate(document)


def test_every_pattern_has_an_example_here_and_a_sentence_about_itself() -> None:
    assert set(EXAMPLES) == set(PATTERNS)
    assert all((pattern.__doc__ or "").strip() for pattern in PATTERNS.values())


@pytest.mark.parametrize("kind", EXAMPLES)
def test_every_pattern_lies_on_the_wall_and_is_the_same_every_time(kind: str, points_file: Path) -> None:
    plan = plan_settings(kind, points_file).plan()
    again = plan_settings(kind, points_file).plan()
    assert plan == again
    assert plan.digest() == again.digest()
    places = [(point.x_m, point.y_m) for point in plan]
    assert len(set(places)) == len(places) == len(plan)
    assert all(abs(x_m) <= 0.5 + 1e-9 and abs(y_m) <= 0.4 + 1e-9 for x_m, y_m in places)
    assert [point.number for point in plan] == list(range(len(plan)))


@pytest.mark.parametrize("kind", EXAMPLES)
def test_every_pattern_keeps_dense_indices_where_there_are_any(kind: str, points_file: Path) -> None:
    plan = plan_settings(kind, points_file).plan()
    assert plan.positions.on_grid == (kind not in FREE | {"list"})
    for point in plan:
        if point.row is not None and point.col is not None:
            assert point.x_m == plan.wall.x_m()[point.col]
            assert point.y_m == plan.wall.y_m()[point.row]


@pytest.mark.parametrize("kind", ["jittered", "random", "blue_noise"])
def test_another_seed_gives_other_points(kind: str, points_file: Path) -> None:
    first = plan_settings(kind, points_file)
    other = first.model_copy(update={"pattern": first.pattern.model_copy(update={"seed": 6})})
    assert first.plan() != other.plan()


@pytest.mark.parametrize("kind", sorted(EXAMPLES.keys() - {"adaptive"}))  # whose order is its own
@pytest.mark.parametrize("order", ["pattern", "strips", "two_opt"])
def test_every_order_visits_the_same_points(kind: str, order: str, points_file: Path) -> None:
    settings_ = plan_settings(kind, points_file, order=order)
    plan, as_listed = settings_.plan(), plan_settings(kind, points_file, order="pattern").plan()
    assert sorted((p.x_m, p.y_m) for p in plan) == sorted((p.x_m, p.y_m) for p in as_listed)


@settings(max_examples=40, deadline=None)
@given(rows=st.integers(1, 40), cols=st.integers(1, 40), sub=st.integers(1, 40))
def test_a_subgrid_is_spread_evenly(rows: int, cols: int, sub: int) -> None:
    wall = WallGrid(1.0, 1.0, rows, cols)
    if sub > min(rows, cols):
        with pytest.raises(PlanRefused, match="not part of"):
            Subgrid(rows=sub, cols=sub).points(wall)
        return
    positions = Subgrid(rows=sub, cols=sub).points(wall)
    assert sorted(set(positions.row.tolist())) == [int((i + 0.5) * rows / sub) for i in range(sub)]
    steps = np.diff(sorted(set(positions.col.tolist())))
    assert np.ptp(steps) <= 1 if len(steps) else sub == 1


def test_jittered_points_sit_one_to_a_cell() -> None:
    positions = Jittered(rows=4, cols=5, seed=1).points(WallGrid(1.0, 1.0, 16, 20))
    assert sorted(zip((positions.row // 4).tolist(), (positions.col // 4).tolist(), strict=True)) == [
        (row, col) for row in range(4) for col in range(5)
    ]


def test_blue_noise_keeps_its_distance_and_grows_by_adding_points() -> None:
    wall = WallGrid(1.0, 1.0, 64, 64)
    blue, white = BlueNoise(points=256, seed=2).points(wall), RandomPixels(points=256, seed=2).points(wall)

    def nearest(x_m: np.ndarray, y_m: np.ndarray) -> np.ndarray:
        distance = np.hypot(x_m[:, None] - x_m, y_m[:, None] - y_m) + 9 * np.eye(len(x_m))
        return np.asarray(distance.min(axis=1))

    ideal_m = np.sqrt(2 / (np.sqrt(3) * 256))
    assert nearest(blue.x_m, blue.y_m).min() > 0.5 * ideal_m > 2 * nearest(white.x_m, white.y_m).min()
    shorter = BlueNoise(points=100, seed=2).points(wall)
    assert (shorter.row == blue.row[:100]).all()
    assert (shorter.col == blue.col[:100]).all()
    everything = BlueNoise(points=25, seed=0).points(WallGrid(1.0, 1.0, 5, 5))
    assert len(set(zip(everything.row.tolist(), everything.col.tolist(), strict=True))) == 25


@pytest.mark.parametrize("shape", [(16, 16), (13, 22)])
def test_every_beginning_of_coarse_to_fine_covers_the_wall_evenly(shape: tuple[int, int]) -> None:
    wall = WallGrid(1.0, 1.0, *shape)
    positions = CoarseToFine().points(wall)
    assert len(set(zip(positions.row.tolist(), positions.col.tolist(), strict=True))) == shape[0] * shape[1]
    for taken in (4, 9, 16, 30, 64, 100, shape[0] * shape[1]):
        quarters = np.histogram2d(positions.row[:taken] * 2 // shape[0], positions.col[:taken] * 2 // shape[1], [2, 2])
        assert np.ptp(quarters[0]) <= 0.35 * taken + 1
    batched = CoarseToFine(batch=16).points(wall)
    assert set(batched.row[:16].tolist()) == set(positions.row[:16].tolist())


def test_circles_and_spirals_space_their_points_evenly() -> None:
    wall = WallGrid(2.0, 2.0, 8, 8)

    def steps(positions: Any) -> np.ndarray:
        return np.asarray(np.hypot(np.diff(positions.x_m), np.diff(positions.y_m)))

    circle = steps(Circle(points=100, radius_m=0.8).points(wall))
    assert np.allclose(circle, 2 * np.pi * 0.8 / 100, rtol=1e-3)
    spiral = ArchimedeanSpiral(dr_m=0.1, spacing_m=0.02).points(wall)
    assert np.allclose(steps(spiral)[50:], 0.02, rtol=2e-3)
    turns = np.hypot(spiral.x_m, spiral.y_m) / 0.1
    assert turns.max() == pytest.approx(10.0, abs=0.1)
    rings = ConcentricCircles(circles=4, points=100).points(wall)
    radii, counts = np.unique(np.round(np.hypot(rings.x_m, rings.y_m), 9), return_counts=True)
    assert radii == pytest.approx([0.25, 0.5, 0.75, 1.0])
    assert counts.sum() == 100
    assert counts == pytest.approx([10, 20, 30, 40], abs=2)
    sunflower = FermatSpiral(dr_m=0.1, factor=2.0).points(wall)
    assert len(sunflower) == pytest.approx(4.0 / (np.pi * 0.05**2), rel=0.05)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_a_list_may_name_pixels(tmp_path: Path, encoding: str) -> None:
    """Also with the mark that Excel begins a file with."""
    path = tmp_path / "pixels.csv"
    path.write_text("row,col\n0,1\n2,2\n", encoding=encoding)
    positions = FromList(file=str(path)).points(WallGrid(1.0, 1.0, 3, 3))
    assert positions.on_grid
    assert positions.x_m == pytest.approx([0.0, 1 / 3])


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("x,y\n1,2\n", ":1: the header is 'x,y'"),
        ("x_m,y_m\n0.1,0.2\n0.1;0.2\n", ":3: "),
        ("x_m,y_m\n0.1,nan\n", ":2: .*not finite"),
        ("x_m,y_m\n", "holds no points"),
        ("row,col\n0.5,1\n", ":2: "),
        ("row,col\n1,1\n7,1\n", ":3: '7,1' lies outside the grid of 3 x 3"),
        ("row,col\n1,-1\n", ":2: '1,-1' lies outside the grid of 3 x 3"),
        ("row,col\n1,1\n3000000000,0\n", ":3: '3000000000,0' lies outside the grid"),
        (f"row,col\n0,{10**30}\n", ":2: '0,1000000000000000000000000000000' lies outside the grid"),
        ("row,col\n1e30,0\n", ":2: '1e30,0' is not two numbers"),
        ("x_m,y_m\n0,1e999\n", ":2: '0,1e999' is not finite"),
        (f"row,col\n1,{'1' * 5000}\n", ":2: '1,1{58}...' is not two numbers"),
        (f"x_m,y_m\n0,0\n0,{'1' * 131_073}\n", ":3: is no line of a CSV file .*field"),
        ("x" * 131_073, ":1: is no line of a CSV file .*field"),
    ],
)
def test_a_bad_list_is_refused_by_file_and_line(tmp_path: Path, text: str, place: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidData, match=r"points\.csv" + place if place.startswith(":") else place):
        FromList(file=str(path)).points(WallGrid(1.0, 1.0, 3, 3))


@pytest.mark.parametrize(
    ("pattern", "why"),
    [
        (Jittered(rows=9, cols=2), "too many"),
        (RandomPixels(points=65), "more than 8 x 8"),
        (BlueNoise(points=65), "more than 8 x 8"),
        (Circle(points=9, radius_m=0.6), "leaves the wall"),
        (ConcentricCircles(circles=5, points=4), "too few for"),
        (ArchimedeanSpiral(dr_m=1e-5), "too many"),
        (FermatSpiral(dr_m=1e-4), "more than a million"),
    ],
)
def test_what_the_wall_cannot_hold_is_refused(pattern: Any, why: str) -> None:
    with pytest.raises(PlanRefused, match=why):
        pattern.points(WallGrid(1.0, 1.0, 8, 8))


def test_points_off_the_wall_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text("x_m,y_m\n0.1,0.0\n0.1,0.45\n", encoding="utf-8")
    with pytest.raises(PlanRefused, match=r"point 1 at \(0.1, 0.45\) m lies outside the wall"):
        plan_settings("list", path).plan()


def test_serpentine_never_steps_further_than_a_pixel() -> None:
    positions = Serpentine().points(WallGrid(1.0, 1.2, 5, 7))
    steps = np.hypot(np.diff(positions.x_m) * 7 / 1.0, np.diff(positions.y_m) * 5 / 1.2)
    assert steps.max() == pytest.approx(1.0)
