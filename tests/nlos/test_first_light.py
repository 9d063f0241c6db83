"""First light: what is found on simulated benches is what they were made with, and the file it writes is the same."""

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Recording
from nlos.cli.terminal import terminal
from nlos.configs.load import find, load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.first_light_settings import FirstLightSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.first_light.bench_lines import with_block


@pytest.fixture(autouse=True)
def fresh_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("as_json", False), ("verbosity", 0), ("wire_log", None), ("document", {})):
        monkeypatch.setattr(terminal, name, value)


def bench_file(folder: Path, name: str = "simulated", **scene: Any) -> Path:
    document = yaml.safe_load(find("bench", name).read_text("utf-8"))
    document["simulation"]["scene"].update(surfel_m=0.1, **scene)
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(document), "utf-8")
    return path


def found(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert run(["calibrate", "--first-light", "--json", *words]) == 0
    said = json.loads(capsys.readouterr().out)
    assert isinstance(said, dict)
    return said


@pytest.mark.sampled(3)
@pytest.mark.parametrize("bench", ["simulated", "optotune", "multiharp", "timetagger"])
@pytest.mark.parametrize("delay_ns", [0.35, 47.0, -1.2, 93.3])
def test_the_delay_is_found_within_20_ps(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bench: str, delay_ns: float
) -> None:
    said = found(capsys, "--bench", str(bench_file(tmp_path, bench, delay_ns=delay_ns)))
    off_ns = (said["delay_ns"] - delay_ns + 50) % 100 - 50
    assert abs(off_ns) < 0.02
    assert said["response_fwhm_ps"] == pytest.approx(71, abs=8)
    assert said["direct_cps"] == pytest.approx(40e3, rel=0.06)


def test_what_the_delay_rests_on_is_said_and_a_wrong_place_shows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = yaml.safe_load(bench_file(tmp_path).read_text("utf-8"))
    document["simulation"]["misalignment"] = {"wall_distance_m": 2.0, "scanner_x_m": 0.0}
    for distance_m, warned in ((2.0, False), (2.4, True)):
        document["geometry"]["wall_distance_m"] = distance_m
        path = tmp_path / "placed.yaml"
        path.write_text(yaml.safe_dump(document))
        said = found(capsys, "--bench", str(path))
        assert any("from place to place" in each for each in said["warnings"]) is warned
        assert run(["calibrate", "--first-light", "--bench", str(path)]) == 0
        printed = capsys.readouterr().out
        assert f"wall_distance_m {distance_m:g}" in printed
        assert "each millimetre of distance is 6.7 ps" in printed


def test_dark_counts_are_kept_apart_from_the_room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = bench_file(tmp_path, "noisy")  # 2,000 dark counts a second, 20,000 of room light, afterpulses of both
    said = found(capsys, "--bench", str(path))
    assert said["dark_cps"] == pytest.approx(2000, rel=0.1)
    assert said["room_cps"] == pytest.approx(20e3, rel=0.1)


def test_nobody_to_cover_the_detector_calls_nothing_dark(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nlos.doctor.hands.SimulatedHands.cover", lambda self, on: False)
    said = found(capsys, "--bench", str(bench_file(tmp_path)))
    assert said["dark_cps"] is None
    assert said["closed_cps"] == pytest.approx(600, rel=0.2)


def test_a_point_that_was_spoilt_is_taken_again_as_in_a_scan(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = yaml.safe_load(bench_file(tmp_path).read_text("utf-8"))
    faults = [{"name": "U15", "skip": skip, "parameters": {"what": "missed"}} for skip in (3, 40)]
    for times, code in ((1, 0), (3, 3)):
        document["simulation"]["faults"] = [each | {"times": times} for each in faults]
        (tmp_path / "spoilt.yaml").write_text(yaml.safe_dump(document))
        assert run(["calibrate", "--first-light", "--bench", str(tmp_path / "spoilt.yaml")]) == code
        said = capsys.readouterr()
        assert said.err.count("a point came back as TRIGGER_MISSED and is taken again") == 2
        assert ("delay " in said.out) == (code == 0)


def test_a_dead_channel_and_a_dark_laser_are_no_pass(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    document = yaml.safe_load(bench_file(tmp_path, ambient_cps=0.0, direct_cps=0.0, objects=[]).read_text())
    path = tmp_path / "dead.yaml"
    path.write_text(yaml.safe_dump(document))
    assert run(["calibrate", "--first-light", "--bench", str(path)]) == 3
    assert "no direct light from" in capsys.readouterr().err
    document["simulation"]["detector"]["dark_cps"] = 0.0
    path.write_text(yaml.safe_dump(document))
    opened: list[bool] = []
    monkeypatch.setattr(SimulatedBench, "set_shutter", lambda self, is_open: opened.append(is_open))
    assert run(["calibrate", "--first-light", "--bench", str(path)]) == 3
    assert "not one count" in capsys.readouterr().err
    assert not any(opened)
    run(["doctor", "--bench", str(path)])
    said = capsys.readouterr().out
    assert "WARN  dark counts" in said
    assert "PASS  dark counts" not in said


def test_the_bench_file_is_written_with_every_other_line_as_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = find("bench", "simulated").read_text("utf-8")
    path = tmp_path / "mine.yaml"
    assert run(["calibrate", "--first-light", "-o", str(path)]) == 0
    after = path.read_text("utf-8")
    assert next(line for line in after.splitlines() if line not in before.splitlines()).startswith("first_light:")
    assert set(before.splitlines()) <= set(after.splitlines())
    settings = load("bench", str(path), BenchSettings).settings
    assert settings.first_light is not None
    assert abs(settings.first_light.delay_ns - 0.35) < 0.02
    assert run(["calibrate", "--first-light", "--bench", str(path), "-o", str(path)]) == 6
    assert run(["calibrate", "--first-light", "--bench", str(path), "-o", str(path), "--overwrite"]) == 0
    assert path.read_text("utf-8").count("first_light:") == 1


def test_the_block_says_whose_values_it_holds_with_the_digits_they_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = bench_file(tmp_path, "noisy").read_text("utf-8").replace("simulation:", "# what stands there:\nsimulation:")
    path, written = tmp_path / "noisy.yaml", tmp_path / "lit.yaml"
    path.write_text(text)
    assert run(["calibrate", "--first-light", "--bench", str(path), "-o", str(written)]) == 0
    said = capsys.readouterr().out
    after = written.read_text("utf-8")
    assert after.index("first_light:") < after.index("# what stands there:\nsimulation:")
    found = load("bench", str(written), BenchSettings).settings.first_light
    assert found is not None
    assert (found.bench, found.simulated, found.counter) == ("noisy", True, "tcspc488 SIM0001")
    assert found.dark_cps is not None
    assert found.direct_cps is not None
    assert found.direct_cps % 100 == 0  # some 400 either way
    assert f"dark       {found.dark_cps:.0f} +- " in said
    assert f"direct     {found.direct_cps:.0f} +- 400 counts/s" in said


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("whose", "why"),
    [
        ({"simulated": False}, "measured on a real bench, and this one is simulated"),
        ({"bench": "the other lab's"}, "measured on bench the other lab's, and this one is simulated"),
        ({"counter": "tcspc488 QT7"}, "measured with tcspc488 QT7, and the counter is tcspc488 SIM0001"),
    ],
)
def test_another_benchs_first_light_is_not_used_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], whose: dict[str, Any], why: str
) -> None:
    """By plan, which asks no counter for its number, the doctor, and a scan: what was rehearsed is not measured."""
    document = yaml.safe_load(bench_file(tmp_path).read_text("utf-8"))
    document["first_light"] = {"delay_ns": 47.0, "dark_cps": 9.0, "room_cps": 9.0, **whose}
    path = tmp_path / "copied.yaml"
    path.write_text(yaml.safe_dump(document))
    assert run(["plan", "demo", "--bench", str(path)]) == 0
    planned = capsys.readouterr().err
    if "counter" not in whose:
        assert f"first_light is not used: {why}" in planned
        assert "misses direct light" not in planned
    assert run(["doctor", "--bench", str(path)]) == 0
    said = capsys.readouterr().out
    assert f"WARN  first light    the bench file's first_light is not used: {why}" in said
    assert "PASS  direct light" in said
    if "bench" not in whose:
        return
    assert run(["scan", "demo", "--bench", str(path), "-o", str(tmp_path / "run.h5")]) == 0  # 18/s would be alarmed of
    assert f"first_light is not used: {why}" in capsys.readouterr().err
    with Recording.open(tmp_path / "run.h5") as recording:
        assert any(why in each for each in recording.header.warnings)


def test_values_that_do_not_say_whose_they_are_are_used(tmp_path: Path) -> None:
    """Somebody wrote them by hand, or an older version did."""
    settings = load("bench", str(bench_file(tmp_path)), BenchSettings).settings
    by_hand = settings.model_copy(update={"first_light": FirstLightSettings(delay_ns=1.0)})
    assert by_hand.with_own_first_light("tcspc488 QT7").first_light is not None


def test_comments_stay_with_what_they_are_about() -> None:
    text = "a: 1\nfirst_light:\n  x: 2   # old\n# about b\nb: 3\n"
    assert (
        with_block(text, "first_light", ["first_light:", "  x: 9"]) == "a: 1\nfirst_light:\n  x: 9\n# about b\nb: 3\n"
    )
    assert with_block("a: 1", "k", ["k: 2"]) == "a: 1\nk: 2\n"
    marked = "a: 1  # one\n# below: the table\nsimulation:\n  x: 1\n"
    assert with_block(marked, "k", ["k: 2"]) == "a: 1  # one\nk: 2\n# below: the table\nsimulation:\n  x: 1\n"
