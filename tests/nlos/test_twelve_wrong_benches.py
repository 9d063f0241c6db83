"""Twelve benches that are not as their files say: each is named before its scan's eleventh point, and by how much where
something can tell. What arrival times cannot tell - a scanner aside, axes reversed or swapped before a wall that faces
the scanner - the doctor sees; a scan says that nobody has looked, and what was seen where somebody has."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.__main__ import run
from nlos.acquisition.planning.preflight import drawn_aim
from nlos.acquisition.recording.recording import Recording
from nlos.beam_seen import BeamJudged, judge_beam, keep_beam_seen
from nlos.bench_constants import folder_of
from nlos.calibration.bench_facts import facts_of
from nlos.calibration.constants import Arrivals, BenchConstants, save
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import Spots
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from tests.changed_bench import bench_file

WALL = "wall: {width_m: 0.6, height_m: 0.6, rows: 8, cols: 8}\npattern: serpentine\ndwell_ms: 8\n"
WINDOW = "histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}\n"
LIT = {"delay_ns": 0.35, "direct_cps": 40e3, "dark_cps": 100.0, "room_cps": 500.0}
FIRST_POINTS = 10
DEVICES = {"mirror": "triggerscope", "counter": "tcspc488 SIM0001"}


@dataclass(frozen=True)
class Wrong:
    """What is wrong (dotted keys of the bench file), which verb names it by which words, and its exit code."""

    changes: dict[str, Any]
    said: str = ""
    by: str = "scan"
    code: int = 5
    bench: str = "simulated"
    histogram: str = WINDOW
    points: int = FIRST_POINTS
    """How many points may be taken."""


CASES = {
    "delay": Wrong({"simulation.scene.delay_ns": 47.0}, "no direct light in the first 10 points"),
    "delay since first light": Wrong(
        {"simulation.scene.delay_ns": 3.35, "first_light": LIT}, " ns from where it should"
    ),
    "delay, window as it was": Wrong(
        {"simulation.scene.delay_ns": 47.0, "first_light": {**LIT, "delay_ns": 47.0}},
        "the time window holds no direct light: it comes 60.",
    ),
    "wall farther away": Wrong({"simulation.misalignment.wall_distance_m": 2.4}, "than from ahead by 1.2"),
    "wall nearer": Wrong({"simulation.misalignment.wall_distance_m": 1.42}, "as no wall's light does"),
    "wall nearer, seen": Wrong({"simulation.misalignment.wall_distance_m": 1.42}, "or the wall's distance is another",
                               "doctor", 3),
    "wall nearer, since first light": Wrong(
        {"simulation.misalignment.wall_distance_m": 1.42, "first_light": LIT}, "as no wall's light does"
    ),
    "wall since first light": Wrong(
        {"simulation.misalignment.wall_distance_m": 2.4, "first_light": LIT}, " ns from where it should"
    ),
    "volts per degree": Wrong(
        {"simulation.misalignment.x_gain": 1.25, "simulation.misalignment.y_gain": 1.25}, "than from ahead by 1."
    ),
    "side": Wrong({"simulation.misalignment.scanner_x_m": 0.25}, "+0.250, +0.000 m from where it was", "doctor", 3),
    "reversed axis": Wrong({"simulation.misalignment.x_volts_per_degree": -0.5}, "x is reversed", "doctor", 3),
    "swapped axes": Wrong({"simulation.misalignment.axes_swapped": True}, "x and y are swapped", "doctor", 3),
    "reversed axis, wall that leans": Wrong(
        {"simulation.misalignment.x_volts_per_degree": -0.5, "geometry.wall_yaw_deg": 5.0}, "as if x is reversed"
    ),
    "swapped axes, wall that leans": Wrong(
        {"simulation.misalignment.axes_swapped": True, "geometry.wall_yaw_deg": 5.0}, "as if x and y are swapped"
    ),
    "other axis reversed, wall that leans": Wrong(
        {"simulation.misalignment.y_volts_per_degree": -0.5, "geometry.wall_pitch_deg": 5.0}, "as if y is reversed",
        points=2 * 8,  # a row says nothing of y
    ),
    "dead channel": Wrong(
        {"simulation.detector.dark_cps": 0.0, "simulation.scene.ambient_cps": 0.0, "simulation.scene.direct_cps": 0.0,
         "simulation.scene.objects": []}, "no direct light in the first 10 points",
    ),
    "dead channel at first light": Wrong(
        {"simulation.detector.dark_cps": 0.0, "simulation.scene.ambient_cps": 0.0, "simulation.scene.direct_cps": 0.0,
         "simulation.scene.objects": []}, "a dead channel looks like that", "first light", 3,
    ),
    "wrong channel": Wrong({"counter.input": 2}, "no direct light in the first 10 points", bench="multiharp"),
    "wrong channel at first light": Wrong(
        {"counter.input": 2}, "the detector input's level, edge and number", "first light", 3, bench="multiharp"
    ),
    "pile-up": Wrong({"simulation.scene.direct_cps": 3e6}, "more than 5% of the laser's pulses"),
    "a lamp": Wrong({"simulation.scene.ambient_cps": 50e3, "first_light": LIT}, "where first light found 600"),
    "a lamp, never measured": Wrong(
        {"simulation.scene.ambient_cps": 100e3}, "with the shutter closed, dark counts and room light together",
        "doctor", 3,
    ),
    "window longer than the period": Wrong(
        {}, "is longer than the laser's period of 100 ns", "plan", 0,
        histogram="histogram: {bins: 8192, bin_width_ps: 16}\n",
    ),
    "window longer than the period, scanned": Wrong(
        {}, "is longer than the laser's period of 100 ns", code=0,
        histogram="histogram: {bins: 8192, bin_width_ps: 16}\n",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_a_wrong_bench_is_named_in_its_first_ten_points_or_before(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nlos.doctor.small_scan._reconstruction", lambda *about: iter(()))  # no picture of 4 x 4 points
    wrong = CASES[name]
    bench = bench_file(tmp_path, wrong.changes, wrong.bench)
    Path("scan.yaml").write_text(WALL + wrong.histogram)
    words = {
        "scan": ["scan", "scan.yaml", "-o", "run.h5"], "plan": ["plan", "scan.yaml"], "doctor": ["doctor"],
        "first light": ["calibrate", "--first-light"],
    }[wrong.by]  # fmt: skip
    assert run([*words, "--bench", bench]) == wrong.code
    said = capsys.readouterr()
    assert wrong.said in said.err + said.out
    if wrong.by == "scan" and wrong.code == 5:
        with Recording.open(Path("run.h5")) as recording:
            assert len(recording) <= wrong.points


@pytest.mark.parametrize("name", ["side", "reversed axis", "swapped axes"])
def test_a_scan_says_that_nobody_has_seen_the_beam_and_what_was_seen_where_somebody_has(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nlos.doctor.small_scan._reconstruction", lambda *about: iter(()))
    wrong = CASES[name]
    bench = bench_file(tmp_path, wrong.changes, wrong.bench)
    Path("scan.yaml").write_text(WALL + WINDOW)
    never = "nobody has seen where this bench's beam goes"
    assert run(["plan", "scan.yaml", "--bench", bench]) == 0
    assert never in capsys.readouterr().err
    assert run(["scan", "scan.yaml", "-o", "unseen.h5", "--bench", bench]) == 0
    assert never in capsys.readouterr().err
    with Recording.open(Path("unseen.h5")) as recording:
        assert any(never in warning for warning in recording.header.warnings)
    assert run(["doctor", "--bench", bench]) == 3
    capsys.readouterr()
    named = {"side": "the beam lands +0.250, +0.000 m from where it is sent"}.get(name, wrong.said)
    assert run(["plan", "scan.yaml", "--bench", bench]) == 0
    assert named in capsys.readouterr().err
    assert run(["scan", "scan.yaml", "-o", "seen.h5", "--bench", bench]) == 5
    said = capsys.readouterr().err
    assert named in said
    assert "nlos doctor" in said
    with Recording.open(Path("seen.h5")) as recording:
        assert not len(recording)
        assert not any(event.kind == "shutter" and "open" in event.text for event in recording.events())


def test_what_was_seen_holds_until_the_bench_file_changes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Corrected by the numbers that spots gave it is a bench that was seen; with the cables turned it is another."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("nlos.doctor.small_scan._reconstruction", lambda *about: iter(()))
    aside = {"simulation.misalignment.scanner_x_m": 0.25}
    Path("scan.yaml").write_text(WALL + WINDOW)
    assert run(["doctor", "--bench", bench_file(tmp_path, aside)]) == 3
    capsys.readouterr()
    for changes, said in (
        ({"geometry.scanner_x_m": 0.25}, ""),
        ({"geometry.scanner_x_m": 0.1}, "before the bench file changed: geometry.scanner_x_m 0 then, 0.1 now"),
        (
            {"geometry.scanner_x_m": 0.25, "mirror.x": {"dac": 1, "volts_per_degree": -0.5}, "mirror.y": {"dac": 2}},
            "mirror.x.volts_per_degree 0.5 then",
        ),
    ):
        bench = bench_file(tmp_path, aside | changes)
        assert run(["plan", "scan.yaml", "--bench", bench]) == 0
        warned = capsys.readouterr().err
        assert said in warned
        assert bool(said) == ("beam" in warned)


@pytest.mark.parametrize("action", ["pause", "abort"])
def test_an_alarm_whose_cure_changes_the_scan_file_asks_for_a_new_recording(
    action: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the alarm says to do is done, and works; `--resume` alone, which would be refused, is not what it says."""
    monkeypatch.chdir(tmp_path)
    wrong = CASES["delay, window as it was"]
    bench = bench_file(tmp_path, wrong.changes)
    Path("scan.yaml").write_text(f"{WALL}{WINDOW}alarms: {{on_direct: {action}}}\n")
    assert run(["scan", "scan.yaml", "-o", "run.h5", "--bench", bench]) == 5
    said = capsys.readouterr().err
    assert "start a new recording with -o" in said
    assert "Fix it, then resume" not in said
    Path("scan.yaml").write_text(WALL + "histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 57}\n")
    assert run(["scan", "scan.yaml", "-o", "run.h5", "--bench", bench, "--resume"]) != 0
    assert "its plan is not the one given" in capsys.readouterr().err
    assert run(["scan", "scan.yaml", "-o", "new.h5", "--bench", bench]) == 0


@pytest.mark.parametrize("old", [False, True], ids=["", "by a file without the kind of bench"])
def test_a_rehearsal_is_no_sighting_of_the_real_bench(
    old: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same file with `sim://` ports first; nor is a sighting of the real bench lost, or true of another table."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    Path("scan.yaml").write_text(WALL + WINDOW)
    never = "nobody has seen where this bench's beam goes"
    real = load("bench", "lab", BenchSettings).settings
    aside = {"simulation": {"misalignment": {"scanner_x_m": 0.25}}}
    table = {"mirror": real.mirror.on_simulated_cable(), "counter": real.counter.on_simulated_cable(),
             "simulation": SimulationSettings.model_validate(aside["simulation"])}  # fmt: skip
    aim = drawn_aim(real.geometry)
    x_m, y_m = np.array([0.0, 0.3, 0.0]), np.array([0.0, 0.0, 0.3])
    spots = Spots(*aim.angles_rad(x_m, y_m), x_m + 0.25, y_m)
    rehearsed = real.model_copy(update=table)
    keep_beam_seen(rehearsed, "jog", spots)
    assert "lands +0.250" in judge_beam(rehearsed, aim).wrong
    kept = tmp_path / "state" / "beam_seen" / "lab.simulated.json"
    if old:
        said = json.loads(kept.read_text())
        del said["facts"]["instruments"]
        kept.with_name("lab.json").write_text(json.dumps(said))
    assert run(["plan", "scan.yaml", "--bench", "lab"]) == 0
    assert f"{never} (a rehearsal on the simulated bench of this name tells nothing of it)" in capsys.readouterr().err
    keep_beam_seen(real, "jog", Spots(spots.x_rad, spots.y_rad, x_m, y_m))
    assert judge_beam(real, aim) == BeamJudged()
    assert "lands +0.250" in judge_beam(rehearsed, aim).wrong
    elsewhere = SimulationSettings.model_validate({"misalignment": {"scanner_x_m": 0.1}})
    other = judge_beam(rehearsed.model_copy(update={"simulation": elsewhere}), aim)
    assert "simulation.misalignment" in other.warning
    assert not other.wrong


def test_a_sighting_of_a_bench_of_a_similar_name_is_none_of_this_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    real = load("bench", "lab", BenchSettings).settings
    aim = drawn_aim(real.geometry)
    x_m, y_m = np.array([0.0, 0.3, 0.0]), np.array([0.0, 0.0, 0.3])
    ours, theirs = (real.model_copy(update={"name": name}) for name in ("実験台", "光学台"))
    keep_beam_seen(ours, "jog", Spots(*aim.angles_rad(x_m, y_m), x_m, y_m))
    assert judge_beam(ours, aim) == BeamJudged()
    assert "nobody has seen" in judge_beam(theirs, aim).warning
    (kept,) = (tmp_path / "beam_seen").iterdir()
    keep_beam_seen(theirs, "jog", Spots(*aim.angles_rad(x_m, y_m), x_m, y_m))
    (other,) = set((tmp_path / "beam_seen").iterdir()) - {kept}
    other.write_bytes(kept.read_bytes())  # as a copied state folder, or a case-blind disk, has it
    assert "nobody has seen" in judge_beam(theirs, aim).warning


def test_stale_constants_are_named_before_the_first_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    settings = load("bench", "simulated", BenchSettings).settings
    name, facts = facts_of(settings.model_dump_json())
    folder_of(name).mkdir(parents=True)
    x_m = np.array([-0.1, 0.1])
    arrivals = Arrivals(np.array([0.0, 0.0, 2.0]), 1e-9, np.eye(4), 1e-12, x_m, x_m, np.zeros(2))
    save(
        BenchConstants(DEVICES, "2026-03-01T12:00:00+00:00", ("a.h5",), 16e-12, arrivals=arrivals,
                       geometry=ScannerGeometry(2.0), geometry_errors={"x_gain": 1e-4, "wall_distance_m": 1e-3},
                       bench=name, bench_facts=facts), folder_of(name) / "spots.h5",
    )  # fmt: skip
    bench = bench_file(tmp_path, {"geometry.wall_distance_m": 1.9})
    Path("scan.yaml").write_text(WALL + WINDOW)
    assert run(["scan", "scan.yaml", "-o", "run.h5", "--bench", bench]) == 7
    assert "wall_distance_m 2 then, 1.9 now" in capsys.readouterr().err
    assert not Path("run.h5").exists()


def test_a_bench_that_is_as_its_file_says_is_scanned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    bench = bench_file(tmp_path, {"first_light": LIT, "simulation.misalignment.wall_yaw_deg": 3.0,
                                        "simulation.misalignment.x_gain": 1.03})  # fmt: skip
    Path("scan.yaml").write_text(WALL + WINDOW)
    assert run(["scan", "scan.yaml", "-o", "run.h5", "--bench", bench]) == 0


def test_a_detector_that_is_gated_to_leave_direct_light_out_is_scanned_where_the_file_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    bench = bench_file(tmp_path, {"first_light": LIT})
    late = WALL + "histogram: {bins: 512, bin_width_ps: 16, offset_ns: 17}\n"
    Path("scan.yaml").write_text(late)
    assert run(["scan", "scan.yaml", "-o", "run.h5", "--bench", bench]) == 5
    Path("scan.yaml").write_text(late + "alarms: {expect_direct: false}\n")
    assert run(["scan", "scan.yaml", "-o", "gated.h5", "--bench", bench]) == 0
