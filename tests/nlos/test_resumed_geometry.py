"""A scan is resumed only where it is aimed as before: by the geometry that its recording names."""

from pathlib import Path

import pytest

import nlos
from nlos.acquisition.recording.salvage import ResumeRefused
from nlos.configs.load import find

SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 8}
"""
BENCH = find("bench", "simulated").read_text()


def test_a_wall_that_was_moved_is_another_scan_and_a_wider_limit_is_not(tmp_path: Path) -> None:
    scan, bench, run = tmp_path / "small.yaml", tmp_path / "bench.yaml", tmp_path / "run.h5"
    scan.write_text(SCAN)
    bench.write_text(BENCH)
    with nlos.open_bench(bench) as opened:
        samples = nlos.scan(scan, opened, output=run)
        for _ in range(20):
            next(samples)
        samples.close()
    bench.write_text(BENCH.replace("wall_distance_m: 2.0", "wall_distance_m: 2.5"))
    with (
        nlos.open_bench(bench) as opened,
        pytest.raises(ResumeRefused, match=r"wall_distance_m: 2\.0 then, 2\.5 now"),
    ):
        list(nlos.scan(scan, opened, output=run, resume=True))
    allowed = "geometry:\n  allowed: {left_m: -1.0, right_m: 1.0, bottom_m: -1.0, top_m: 1.0}"
    bench.write_text(BENCH.replace("geometry:", allowed))
    with nlos.open_bench(bench) as opened:
        taken = len(list(nlos.scan(scan, opened, output=run, resume=True)))
    assert 0 < taken <= 44
