"""The time of day jumps an hour back and forth (NTP, daylight saving) at every look at it: no scan notices."""

import time
from pathlib import Path

import pytest

import nlos
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify

SCAN = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 6, cols: 6}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 64, bin_width_ps: 256, offset_ns: 10}
"""


def test_a_scan_in_jumping_time_is_the_same_scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scan, looks, now = tmp_path / "scan.yaml", 0, time.time
    scan.write_text(SCAN)

    def jumping() -> float:
        nonlocal looks
        looks += 1
        return now() + (3600.0 if looks % 2 else -3600.0)

    def taken(name: str) -> list[tuple[int, float, bytes]]:
        with nlos.open_bench() as bench:
            samples = nlos.scan(scan, bench, output=tmp_path / name)
            return [(each.point.number, each.taken_s, each.histogram.counts.tobytes()) for each in samples]

    steady = taken("steady.h5")
    monkeypatch.setattr(time, "time", jumping)
    assert taken("jumping.h5") == steady
    assert looks > 4
    assert verify(tmp_path / "jumping.h5").complete
    with Recording.open(tmp_path / "jumping.h5") as recording:
        assert recording.elapsed_s == pytest.approx(steady[-1][1] + 8e-3, abs=0.1)
