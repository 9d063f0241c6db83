"""Direct light and the time window: what `plan` warns of, and what the first points of a scan give away."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.__main__ import run
from nlos.acquisition.planning.direct_light import expected_direct, window_warnings
from nlos.acquisition.planning.preflight import aim_of, drawn_aim, fitted
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.recording import Recording
from nlos.configs.load import load, names
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.bench_settings import GeometrySettings
from nlos.drivers.first_light_settings import FirstLightSettings
from tests.changed_bench import bench_file

WALL = "wall: {width_m: 0.6, height_m: 0.6, rows: 8, cols: 8}\npattern: serpentine\ndwell_ms: 8\n"


def scan_file(folder: Path, histogram: str) -> str:
    path = folder / "scan.yaml"
    path.write_text(f"{WALL}histogram: {{{histogram}}}\n")
    return str(path)


def warnings(bench: str, scan: str) -> list[str]:
    settings = load("bench", bench, BenchSettings).settings
    with open_bench(settings) as opened:
        plan = fitted(load("scan", scan, ScanSettings).settings.plan(), opened)
        return window_warnings(plan, expected_direct(plan, settings, aim_of(opened)))


def test_direct_light_is_due_by_the_way_there_and_back_also_where_the_beam_goes_the_wrong_way() -> None:
    """By vectors: a scanner aside, a wall that is wider than high and swings away on its right; the beam that goes to
    the left for right meets the same plane elsewhere."""
    scan = {"wall": {"width_m": 1.2, "height_m": 0.4, "rows": 3, "cols": 4}, "pattern": "serpentine", "dwell_ms": 8,
            "histogram": {"bins": 1024, "bin_width_ps": 16, "offset_ns": 10}}  # fmt: skip
    plan, yaw_rad = ScanSettings.model_validate(scan).plan(), math.radians(8.0)
    geometry = {"wall_distance_m": 1.5, "scanner_x_m": 0.3, "scanner_y_m": -0.1, "wall_yaw_deg": 8.0}
    settings = load("bench", "simulated", BenchSettings).settings
    settings = settings.model_copy(
        update={"first_light": FirstLightSettings(delay_ns=95.0), "geometry": GeometrySettings.model_validate(geometry)}
    )
    direct = expected_direct(plan, settings, drawn_aim(settings.geometry))
    right, normal = np.array([[math.cos(yaw_rad), 0, -math.sin(yaw_rad)], [math.sin(yaw_rad), 0, math.cos(yaw_rad)]])
    place = plan.positions.x_m[:, None] * right + plan.positions.y_m[:, None] * np.array([0.0, 1.0, 0.0])
    scanner = np.array([0.3, -0.1, 1.5])
    goes = (place - scanner) / np.linalg.norm(place - scanner, axis=1)[:, None]
    for signs, arrival_s in (((1, 1, 1), direct.arrival_s), ((-1, 1, 1), direct.turned_s["x is reversed"])):
        range_m = -(scanner @ normal) / (goes * signs @ normal)
        assert arrival_s == pytest.approx((2 * range_m / 299_792_458 + 95e-9) % 100e-9, abs=1e-13)


@pytest.mark.parametrize("scan", names("scan"))
def test_shipped_scans_see_direct_light_on_the_shipped_benches(scan: str) -> None:
    for bench in ("simulated", "multiharp", "optotune"):
        assert warnings(bench, scan) == []


@pytest.mark.parametrize(
    ("histogram", "bench", "said"),
    [
        (
            "bins: 1024, bin_width_ps: 16, offset_ns: 10",
            {"geometry.wall_distance_m": 1.5},
            "cuts off direct light at",
        ),
        ("bins: 1024, bin_width_ps: 16, offset_ns: 20", {}, "misses direct light: it comes 13.3"),
        (
            "bins: 1024, bin_width_ps: 16, offset_ns: 20",
            {},
            "cables delay nothing. First `nlos calibrate --first-light`",
        ),
        (
            "bins: 1024, bin_width_ps: 16, offset_ns: 20",
            {"first_light": {"delay_ns": 0.35}},
            "after the sync pulse. Begin histogram.offset_ns at 12 or earlier.",
        ),
        ("bins: 1024, bin_width_ps: 16, offset_ns: 10", {"first_light": {"delay_ns": 47.0}}, "it comes 60.3"),
        ("bins: 8192, bin_width_ps: 16", {}, "longer than the laser's period of 100 ns"),
        ("bins: 1024, bin_width_ps: 16, offset_ns: 110", {}, ""),  # the next pulse's window
        ("bins: 1024, bin_width_ps: 16, offset_ns: 2", {"first_light": {"delay_ns": -10.0}}, ""),
        ("bins: 1024, bin_width_ps: 16, offset_ns: 2", {"first_light": {"delay_ns": 90.0}}, ""),
    ],
)
def test_windows_are_held_against_the_period_and_the_wall(
    tmp_path: Path, histogram: str, bench: dict[str, Any], said: str
) -> None:
    found = warnings(bench_file(tmp_path, bench), scan_file(tmp_path, histogram))
    assert [said in each for each in found] == ([True] if said else [])


@pytest.mark.parametrize(
    ("bench", "said"),
    [
        ({"simulation.scene.delay_ns": 47.0}, "no direct light in the first 10 points"),
        ({"simulation.scene.direct_cps": 0.0, "simulation.scene.objects": []}, "no direct light in the first 10"),
        ({"first_light": {"delay_ns": 2.35}}, "comes -2.00 ns from where it should"),
        ({"first_light": {"delay_ns": 0.35}, "simulation.misalignment.wall_distance_m": 2.4}, "comes +2.7"),
        ({"first_light": {"delay_ns": 0.35}, "simulation.scene.direct_cps": 0.0}, "direct light"),
    ],
)
def test_a_scan_whose_direct_light_is_not_where_it_should_be_stops_in_its_first_points(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bench: dict[str, Any], said: str
) -> None:
    target = tmp_path / "run.h5"
    scan = scan_file(tmp_path, "bins: 1024, bin_width_ps: 16, offset_ns: 10")
    assert run(["scan", scan, "--bench", bench_file(tmp_path, bench), "-o", str(target)]) == 5
    assert said in capsys.readouterr().err
    with Recording.open(target) as recording:
        assert len(list(recording.samples())) <= 10
        assert any(event.kind == "alarm" and "direct" in event.text for event in recording.events())


@pytest.mark.parametrize("first_light", [None, {"delay_ns": 8.0}])
def test_hidden_light_that_the_next_pulse_overtakes_is_not_taken_for_the_walls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], first_light: dict[str, float] | None
) -> None:
    """A laser of 40 MHz and 8 ns of cable: direct light comes at 21.4 ns, hidden light from 25 ns on, which is 0."""
    changes = {"laser.repetition_hz": 40e6, "simulation.scene.delay_ns": 8.0, "first_light": first_light}
    bench = bench_file(tmp_path, changes)
    for histogram, code in (("bins: 1560, bin_width_ps: 16", 5), ("bins: 1500, bin_width_ps: 16, offset_ns: 20", 0)):
        target = tmp_path / f"{code}.h5"
        assert run(["scan", scan_file(tmp_path, histogram), "--bench", bench, "-o", str(target)]) == code
    assert "which comes at 21.3" in (said := capsys.readouterr().err)
    assert "histogram.offset_ns to 20." in said


@pytest.mark.parametrize("delay_ns", [None, 0.35, 0.9])
def test_a_bench_that_is_as_it_was_goes_on(tmp_path: Path, delay_ns: float | None) -> None:
    changes = {} if delay_ns is None else {"first_light": {"delay_ns": delay_ns}}
    scan = scan_file(tmp_path, "bins: 1024, bin_width_ps: 16, offset_ns: 10")
    assert run(["scan", scan, "--bench", bench_file(tmp_path, changes), "-o", str(tmp_path / "run.h5")]) == 0


def test_what_is_wrong_with_a_window_is_kept_with_the_recording(tmp_path: Path) -> None:
    scan, target = scan_file(tmp_path, "bins: 8192, bin_width_ps: 16"), tmp_path / "run.h5"
    assert run(["scan", scan, "--bench", bench_file(tmp_path, {}), "-o", str(target)]) == 0
    with Recording.open(target) as recording:
        assert any("longer than the laser's period" in warning for warning in recording.header.warnings)
