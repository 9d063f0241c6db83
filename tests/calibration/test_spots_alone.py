"""The scanner's place from spots alone, against the simulated table's own geometry; what spots cannot tell is said."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nlos.__main__ import run
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import Spots
from nlos.calibration.spots_fit import place_from_spots
from nlos.calibration.spots_sense import check_sense
from nlos.cli.terminal import terminal
from nlos.configs.load import find, load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath, Misalignment
from nlos.first_light.bench_lines import with_keys

DRAWN = ScannerGeometry(1.5, 0.012)


@pytest.fixture(autouse=True)
def fresh_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("as_json", False), ("verbosity", 0), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


def spots_of(path: BeamPath, side_deg: float = 16.0, count: int = 4, noise_m: float = 5e-4, seed: int = 1) -> Spots:
    draw = np.random.default_rng(seed)
    x, y = (each.ravel() for each in np.meshgrid(*[np.radians(np.linspace(-side_deg, side_deg, count))] * 2))
    seen = [path.spot(MirrorAngles(float(a), float(b))) for a, b in zip(x, y, strict=True)]
    places = np.array([(each.x_m, each.y_m) for each in seen if each is not None]) + draw.normal(
        0, noise_m, (len(x), 2)
    )
    return Spots(x, y, places[:, 0], places[:, 1])


@pytest.mark.parametrize("seed", range(8))
def test_the_place_is_found_within_2_mm(seed: int) -> None:
    true = Misalignment(scanner_x_m=0.25, scanner_y_m=-0.08, wall_yaw_deg=3.0, wall_pitch_deg=-2.0)
    found = place_from_spots(spots_of(BeamPath(1.42, 0.012, true), seed=seed, count=5), DRAWN)
    geometry, errors = found.fit.geometry, found.fit.errors
    assert not found.undetermined
    for name, value in (("scanner_x_m", 0.25), ("scanner_y_m", -0.08), ("wall_distance_m", 1.42)):
        assert abs(getattr(geometry, name) - value) < max(2e-3, 4 * errors[name])
        assert errors[name] < 2e-3
    assert np.degrees(geometry.wall_yaw_rad) == pytest.approx(3.0, abs=0.4)


def test_what_spots_cannot_tell_is_named_and_left_as_drawn() -> None:
    near = spots_of(BeamPath(1.42, 0.012, Misalignment(scanner_x_m=0.1)), side_deg=2.0, count=3, noise_m=1e-3)
    found = place_from_spots(near, DRAWN)
    assert {"wall_pitch_rad", "wall_yaw_rad"} <= set(found.undetermined)
    assert found.fit.geometry.wall_pitch_rad == 0.0
    assert all(error > np.radians(0.5) for name, (_, error) in found.undetermined.items() if "wall_p" in name)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: Spots(s.x_rad, s.y_rad, -s.x_m, s.y_m), "x is reversed"),
        (lambda s: Spots(s.x_rad, s.y_rad, s.x_m, -s.y_m), "y is reversed"),
        (lambda s: Spots(s.x_rad, s.y_rad, s.y_m, s.x_m), "swapped"),
        (lambda s: Spots(s.x_rad, s.x_rad, s.x_m, s.x_m), "on one line"),
    ],
)
def test_axes_that_are_wrong_are_named(change: Any, said: str) -> None:
    with pytest.raises(InvalidData, match=said):
        check_sense(change(spots_of(BeamPath(1.42))))


def test_marked_spots_become_lines_of_the_bench_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = yaml.safe_load(find("bench", "simulated").read_text("utf-8"))
    document["simulation"]["misalignment"] = {"scanner_x_m": 0.25, "wall_distance_m": 1.42}
    bench = tmp_path / "bench.yaml"
    bench.write_text(yaml.safe_dump(document))
    spots = spots_of(BeamPath(1.42, 0.0, Misalignment(scanner_x_m=0.25)), count=5)
    table = tmp_path / "spots.csv"
    with table.open("w") as file:
        rows = csv.writer(file)
        rows.writerow(["x_deg", "y_deg", "x_m", "y_m"])
        rows.writerows(zip(np.degrees(spots.x_rad), np.degrees(spots.y_rad), spots.x_m, spots.y_m, strict=True))
    target = tmp_path / "placed.yaml"
    assert run(["calibrate", "--spots", str(table), "--bench", str(bench), "-o", str(target), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["undetermined"] == []
    assert (tmp_path / "spots.png").stat().st_size > 10_000
    words = ["calibrate", "--spots", str(table), "--bench", str(bench)]
    assert run(words) == 0  # its own picture is drawn anew
    (tmp_path / "spots.png").write_bytes(b"\x89PNG, a photograph of the wall")
    assert run(words) == 6
    assert "spots.png: exists, and is none of this program's pictures" in capsys.readouterr().err
    assert (tmp_path / "spots.png").read_bytes() == b"\x89PNG, a photograph of the wall"
    drawn = load("bench", str(target), BenchSettings).settings.geometry
    assert (drawn.scanner_x_m, drawn.wall_distance_m) == pytest.approx((0.25, 1.42), abs=2e-3)
    assert run(["point", "0.3", "0.1", "--bench", str(target), "--json"]) == 0
    sent = capsys.readouterr().out
    assert json.loads(sent)["x_m"] == pytest.approx(0.3)
    assert json.loads(sent)["x_deg"] == pytest.approx(np.degrees(np.arctan(0.05 / 1.42)), abs=0.1)


def test_keys_are_set_where_they_are_and_their_comments_stay() -> None:
    text = (
        "name: x\ngeometry:\n  wall_distance_m: 2.0     # measured by tape\n  allowed: {left_m: -1}\n\nlaser:\n  a: 1\n"
    )
    new = with_keys(text, "geometry", {"wall_distance_m": "1.4200", "scanner_x_m": "0.2500"})
    assert new == (
        "name: x\ngeometry:\n  wall_distance_m: 1.4200  # measured by tape\n  allowed: {left_m: -1}\n"
        "  scanner_x_m: 0.2500\n\nlaser:\n  a: 1\n"
    )


def test_a_scan_with_spots_names_what_both_together_cannot_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mirror's offset turns the beam as a leaning wall does: in the middle nothing tells them apart."""
    document = yaml.safe_load(find("bench", "simulated").read_text("utf-8"))
    document["simulation"]["scene"].update(surfel_m=0.1)
    document["simulation"]["misalignment"] = {"scanner_x_m": 0.1}
    bench, scan, table = tmp_path / "bench.yaml", tmp_path / "scan.yaml", tmp_path / "spots.csv"
    bench.write_text(yaml.safe_dump(document))
    scan.write_text(
        "wall: {width_m: 1.0, height_m: 1.0, rows: 12, cols: 12}\npattern: serpentine\ndwell_ms: 8\n"
        "histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}\n"
    )
    spots = spots_of(BeamPath(2.0, 0.0, Misalignment(scanner_x_m=0.1)), count=3, noise_m=0.0)
    table.write_text(
        "x_deg,y_deg,x_m,y_m\n"
        + "".join(
            f"{np.degrees(a)},{np.degrees(b)},{x:.3f},{y:.3f}\n"
            for a, b, x, y in zip(spots.x_rad, spots.y_rad, spots.x_m, spots.y_m, strict=True)
        )
    )
    assert run(["scan", str(scan), "--bench", str(bench), "-o", str(tmp_path / "run.h5")]) == 0
    capsys.readouterr()
    found = tmp_path / "found.h5"
    assert run(["calibrate", str(tmp_path / "run.h5"), "--spots", str(table), "-o", str(found), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert "y_offset_rad" in said["undetermined"]
    assert said["geometry"]["y_offset_rad"] == 0.0
    assert said["geometry"]["scanner_x_m"] == pytest.approx(0.1, abs=2e-3)
    assert said["geometry_errors"]["scanner_x_m"] < 5e-3
    assert (tmp_path / "found" / "spots.png").exists()
