"""A bench without a shutter, whose laser is always on: whatever is said about light there is true."""

import json
import signal
import sys
from pathlib import Path

import pytest
import yaml

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Recording
from nlos.configs.load import find
from tests.nlos.by_hand.at_a_terminal import at_a_terminal

LIES = ("with the shutter closed", "the shutter closed", "light off", "light       off", "light on for",
        "light never on", "in the dark", "stays closed")  # fmt: skip
"""What is said of benches with a shutter, and never of this one."""


@pytest.fixture
def bench(tmp_path: Path) -> str:
    document = yaml.safe_load(find("bench", "simulated").read_text("utf-8"))
    document |= {"name": "always on", "shutter": {"model": "none"}}
    document["safety"]["watchdog_s"] = 0.0
    document["simulation"]["scene"]["surfel_m"] = 0.1
    # as a careless copy of another file would have it: this would be an alarm of a lamp
    document["first_light"] = {"delay_ns": 0.35, "dark_cps": 100.0, "room_cps": 500.0}
    path = tmp_path / "bench.yaml"
    path.write_text(yaml.safe_dump(document), "utf-8")
    return str(path)


def said(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert run(list(words)) == code
    captured = capsys.readouterr()
    whole = captured.out + captured.err
    assert not [each for each in LIES if each in whole], whole
    return whole


def test_a_scan_takes_the_light_as_it_is_and_records_no_shutter(
    bench: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said(capsys, "scan", "five_by_five", "--bench", bench, "-o", str(tmp_path / "n.h5"), code=2)
    target = tmp_path / "run.h5"
    words = said(capsys, "scan", "five_by_five", "--bench", bench, "-o", str(target), "--no-shutter")
    assert "25 of 25 points" in words
    with Recording.open(target) as recording:
        assert not [event for event in recording.events() if event.kind in ("shutter", "alarm", "watchdog")]
        assert any("no shutter" in each for each in recording.header.warnings)
        assert min(sample.histogram.total_count for sample in recording.samples()) > 1000
    said(capsys, "info", str(target))
    assert "25 points" in said(capsys, "verify", str(target))
    said(capsys, "report", str(target), "-o", str(tmp_path / "r.html"))
    said(capsys, "reconstruct", str(target), "--method", "lct", "-o", str(tmp_path / "out"))
    said(capsys, "replay", str(target), "--speed", "max", "-o", str(tmp_path / "again.h5"))
    assert "no shutter that a trip" in said(capsys, "plan", "five_by_five", "--bench", bench)


def test_a_trip_there_says_that_nothing_was_closed(
    bench: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = yaml.safe_load(Path(bench).read_text())
    text["safety"] |= {"trip_cps": 2e4, "trip_ms": 1.0}
    Path(bench).write_text(yaml.safe_dump(text))
    words = ["scan", "five_by_five", "--bench", bench, "-o", str(tmp_path / "t.h5"), "--no-shutter"]
    tripped = said(capsys, *words, code=5)
    assert "there is none to close" in tripped
    assert "Block the laser by hand" in tripped
    assert "clear-trip" in said(capsys, *words, "--resume", code=4)  # latched all the same


def test_a_dry_run_there_says_who_keeps_it_dark(bench: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = yaml.safe_load(Path(bench).read_text())
    text["safety"]["dry_run"] = True
    Path(bench).write_text(yaml.safe_dump(text))
    words = ["scan", "five_by_five", "--bench", bench, "-o", str(tmp_path / "t.h5"), "--no-shutter"]
    assert "switch the laser off by hand" in said(capsys, *words)


def test_by_hand_light_is_not_known_and_not_given(bench: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = said(capsys, "monitor", "--bench", bench, "--for", "0.5")
    assert "light not known: this bench has no shutter" in words
    assert run(["monitor", "--bench", bench, "--for", "0.2", "--json"]) == 0
    row = json.loads(capsys.readouterr().out)
    assert row["light"] == "unknown"
    assert row["light_s"] is None
    assert row["dark_hz"] is None
    for verb in (["monitor"], ["point", "0", "0", "--no-shutter"]):
        refused = said(capsys, *verb, "--bench", bench, "--light", "1", code=4)
        assert "nothing here switches the light on or off" in refused
    said(capsys, "point", "0.1", "0.1", "--bench", bench, code=4)
    said(capsys, "point", "0.1", "0.1", "--bench", bench, "--no-shutter", "--hold", "0.1")


def test_space_in_jog_gives_none_and_says_why(bench: str, tmp_path: Path) -> None:
    words = ("jog", "--bench", bench, "--no-shutter", "--marks", "s.csv")
    with at_a_terminal(tmp_path, *words) as child:
        child.wait_for("light       not known: this bench has no shutter")
        child.press(" ")
        child.wait_for("Switch the laser by hand")
        child.press("m", "\r")
        child.wait_for("spot 1 in s.csv")
        child.press("q")
        assert child.ends() == 0
        assert not [each for each in LIES if each in child.said]


def test_first_light_calls_nothing_dark_that_is_lit(bench: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["calibrate", "--first-light", "--bench", bench, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["closed_cps"] is None
    assert found["room_cps"] is None
    assert found["dark_cps"] == pytest.approx(100, rel=0.3)  # the detector was covered: no laser either
    assert found["direct_cps"] == pytest.approx(40e3, rel=0.06)
    assert "no shutter that could keep the laser off" in said(capsys, "calibrate", "--first-light", "--bench", bench)


def test_the_doctor_fails_nothing_for_the_lack_of_a_shutter(
    bench: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said(capsys, "doctor", "--bench", bench)
    whole = said(capsys, "doctor", "--thorough", "--light", "--bench", bench, "-o", str(tmp_path / "d.html"))
    assert "FAIL  " not in whole
    assert "no watchdog" not in whole
    for check in ("dark histogram", "linearity", "trip"):
        assert f"SKIP  {check}" in whole
    assert "without a shutter" in (tmp_path / "d.html").read_text("utf-8")


@pytest.mark.skipif(sys.platform == "win32", reason="it pauses by SIGINT at a terminal")
def test_a_pause_there_does_not_call_it_dark(bench: str, tmp_path: Path) -> None:
    (tmp_path / "slow.yaml").write_text(
        "wall: {width_m: 0.5, height_m: 0.5, rows: 32, cols: 32}\npattern: serpentine\ndwell_ms: 500\n"
        "histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}\n"
    )
    words = ("scan", "slow.yaml", "--bench", bench, "--no-shutter", "-o", "slow.h5")
    with at_a_terminal(tmp_path, *words) as child:
        child.wait_for("/1024")  # the bar is there once Ctrl-C pauses
        child.signal(signal.SIGINT)
        child.wait_for("the laser is as it was, this bench has no shutter")
        child.press("\x03")
        assert child.ends() == 130
        assert not [each for each in LIES if each in child.said]
