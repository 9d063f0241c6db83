"""A scan is resumed only on the bench that its recording names: aimed, wired and lit as before."""

from collections.abc import Callable
from pathlib import Path

import pytest

import nlos
from nlos.acquisition.recording.same_scan import ResumeRefused
from nlos.configs.load import find

SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 8}
"""
BENCH = find("bench", "simulated").read_text()
Text = Callable[[str], str]


def changed(before: str, now: str) -> Text:
    def change(text: str) -> str:
        assert text.count(before) == 1
        return text.replace(before, now)

    return change


def said(block: str, line: str) -> Text:
    return changed(f"{block}:\n", f"{block}:\n  {line}\n")


@pytest.fixture
def begun(tmp_path: Path) -> Path:
    """A folder with a scan that was ended after 20 of 64 points."""
    (tmp_path / "scan.yaml").write_text(SCAN)
    (tmp_path / "bench.yaml").write_text(BENCH)
    with nlos.open_bench(tmp_path / "bench.yaml") as bench:
        samples = nlos.scan(tmp_path / "scan.yaml", bench, output=tmp_path / "run.h5")
        for _ in range(20):
            next(samples)
        samples.close()
    return tmp_path


def resumed(folder: Path) -> int:
    with nlos.open_bench(folder / "bench.yaml") as bench:
        return len(list(nlos.scan(folder / "scan.yaml", bench, output=folder / "run.h5", resume=True)))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed("wall_distance_m: 2.0", "wall_distance_m: 2.5"), r"geometry.*wall_distance_m: 2\.0 then, 2\.5 now"),
        (said("mirror", "x: {dac: 1, volts_per_degree: 0.4}"), r"mirror: x\.volts_per_degree: 0\.5 then, 0\.4 now"),
        (said("mirror", "y: {dac: 2, offset_v: 0.1}"), r"mirror: y\.offset_v: 0\.0 then, 0\.1 now"),
        (said("counter", "detector: {delay_ps: 500}"), r"counter: detector\.delay_ps: 0 then, 500 now"),
        (changed("repetition_hz: 10.0e+6", "repetition_hz: 20.0e+6"), r"laser: repetition_hz: 1\d*\.0 then, 2"),
        (changed("wavelength_nm: 532.0", "wavelength_nm: 670.0"), r"laser: wavelength_nm: 532\.0 then, 670\.0 now"),
    ],
)
def test_another_bench_is_refused_by_name(begun: Path, change: Text, words: str) -> None:
    before = (begun / "run.h5").read_bytes()
    (begun / "bench.yaml").write_text(change(BENCH))
    with pytest.raises(ResumeRefused, match=words):
        resumed(begun)
    assert (begun / "run.h5").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (changed("dwell_ms: 8", "dwell_ms: 16"), r"dwell_s of point 0: 0\.008 then, 0\.016 now"),
        (changed("bin_width_ps: 32", "bin_width_ps: 64"), "axis.bin_width_s: "),
        (changed("rows: 8", "rows: 6"), "64 points then, 48 now"),
        (changed("width_m: 0.6", "width_m: 0.5"), r"wall\.width_m: 0\.6 then, 0\.5 now"),
        (changed("serpentine", "raster"), "row of point|col of point|x_m of point"),
    ],
)
def test_another_plan_is_refused_by_what_differs(begun: Path, change: Text, words: str) -> None:
    (begun / "scan.yaml").write_text(change(SCAN))
    with pytest.raises(ResumeRefused, match=words):
        resumed(begun)


@pytest.mark.parametrize(
    "change",
    [
        changed("geometry:", "geometry:\n  allowed: {left_m: -1.0, right_m: 1.0, bottom_m: -1.0, top_m: 1.0}"),
        said("mirror", "timeout_s: 0.7"),
        said("counter", "mode: t3"),
    ],
)
def test_what_does_not_touch_the_photons_may_change(begun: Path, change: Text) -> None:
    (begun / "bench.yaml").write_text(change(BENCH))
    assert 0 < resumed(begun) <= 44
