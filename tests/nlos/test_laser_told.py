"""What a recording says of the laser's light, as the live page shows it: scans, replays, imports and other benches."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml

from nlos.__main__ import run
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Event, Recording
from nlos.configs.load import find
from nlos.live.laser import Light, is_simulated, light_said

WITH_SHUTTER = Header(bench_json=json.dumps({"shutter": {"model": "tcspc488"}}))


def told(*said: tuple[str, str], header: Header = WITH_SHUTTER, under_way: bool = True) -> Light:
    return light_said(header, [Event(0.0, 0.0, kind, text) for kind, text in said], under_way)


def of_file(path: Path) -> tuple[Light, bool]:
    with Recording.open(path) as recording:
        return light_said(recording.header, tuple(recording.events()), False), is_simulated(recording.header)


@pytest.mark.parametrize(
    ("said", "light"),
    [
        ([], Light.OFF),
        ([("shutter", "armed by somebody, at the bench"), ("shutter", "light in 3 s")], Light.OFF),
        ([("shutter", "opened")], Light.ON),
        ([("shutter", "opened"), ("shutter", "closed: SIGINT")], Light.OFF),
        ([("shutter", "opened"), ("shutter", "NOT CONFIRMED CLOSED: no answer")], Light.MAYBE),
        ([("shutter", "NOT CONFIRMED CLOSED: no answer"), ("watchdog", "silent for 1 s")], Light.MAYBE),
        ([("shutter", "NOT CONFIRMED CLOSED: no answer"), ("shutter", "closed")], Light.OFF),
        ([("shutter", "closed"), ("shutter", "asked to open: stays closed in a dry run")], Light.OFF),
        ([("shutter", "closed"), ("log_full", "further events are not kept")], Light.MAYBE),
        ([("shutter", "opened"), ("note", "closed the curtain")], Light.ON),
        ([("shutter", "closed"), ("scan", "opened again")], Light.OFF),
        ([("replayed", "replayed from run.h5")], Light.REPLAYED),
        ([("replayed", "replayed from run.h5"), ("shutter", "opened")], Light.ON),  # resumed on a bench
    ],
)
def test_the_newest_word_about_the_shutter_counts(said: list[tuple[str, str]], light: Light) -> None:
    assert told(*said) is light


def test_a_shutter_that_was_open_when_the_scan_was_gone_may_be_open() -> None:
    assert told(("shutter", "opened"), under_way=False) is Light.MAYBE


def test_no_shutter_is_no_light_that_is_off() -> None:
    assert told(header=Header(bench_json=json.dumps({"shutter": {"model": "none"}}))) is Light.NO_SHUTTER


def test_files_are_told_apart(tmp_path: Path) -> None:
    scanned, replayed, imported = (tmp_path / f"{name}.h5" for name in ("scanned", "replayed", "imported"))
    assert run(["scan", "five_by_five", "-o", str(scanned), "-q"]) == 0
    assert of_file(scanned) == (Light.OFF, True)
    assert run(["replay", str(scanned), "--speed", "max", "-o", str(replayed), "-q"]) == 0
    assert of_file(replayed)[0] is Light.REPLAYED
    np.savez(tmp_path / "made.npz", histograms=np.ones((4, 4, 64), np.uint32), bin_width_s=32e-12, wall_size_m=1.0)
    assert run(["import", str(tmp_path / "made.npz"), "-o", str(imported), "-q"]) == 0
    assert of_file(imported) == (Light.UNTOLD, False)
    bench = yaml.safe_load(find("bench", "simulated").read_text("utf-8"))
    bench |= {"shutter": {"model": "none"}}
    bench["safety"]["watchdog_s"] = 0.0
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench), "utf-8")
    words = ["scan", "five_by_five", "--bench", str(tmp_path / "bench.yaml"), "--no-shutter", "-q"]
    assert run([*words, "-o", str(tmp_path / "always.h5")]) == 0
    assert of_file(tmp_path / "always.h5")[0] is Light.NO_SHUTTER
