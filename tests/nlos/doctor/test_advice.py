"""What the doctor says to do first is what the rest waits for."""

from pathlib import Path

import pytest

from nlos.__main__ import run
from nlos.doctor.advice import in_order
from nlos.doctor.findings import failed, passed, skipped, warned
from tests.changed_bench import bench_file


def test_causes_come_before_what_follows_from_them() -> None:
    advice = in_order(
        [
            warned("software", "torch is missing", "pip install torch"),
            warned("levels", "3.3 V into 50 mV", "Put in an attenuator."),
            failed("count rates", "no light comes back", "Check laser."),
            failed("triggerscope", "mirror at /dev/ttyACM0: no such port", "Plug it in."),
            failed("shutter", "not confirmed closed", "Switch the laser off by hand."),
            passed("sync", "at 10 MHz"),
            skipped("scan", "the mirror is missing"),
            warned("dark counts", "3000 counts/s", "Dim the room."),
            warned("direct light", "none stands out", "Run first light."),
            warned("reconstruction", "no direct light", "Run first light."),
        ]
    )
    assert advice == [
        "levels: Put in an attenuator.",
        "triggerscope: Plug it in.",
        "shutter: Switch the laser off by hand.",
        "count rates: Check laser.",
        "software: pip install torch",
        "direct light, reconstruction: Run first light.",
        "dark counts: Dim the room.",
    ]


def test_the_missing_delay_is_said_before_the_bright_room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bench = bench_file(tmp_path, {"simulation.scene.delay_ns": 47.0, "simulation.scene.ambient_cps": 20e3})
    assert run(["doctor", "--bench", bench]) == 0
    said = capsys.readouterr().out
    assert said.index("WARN  dark counts") < said.index("WARN  direct light")
    first, second = said.partition("what to do, in this order:\n")[2].splitlines()[:2]
    assert first.startswith("  1. direct light: Run `nlos calibrate --first-light`")
    assert second.startswith("  2. dark counts: Dim the room")


def test_one_remedy_needs_no_order(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor"]) == 0
    assert "in this order" not in capsys.readouterr().out
