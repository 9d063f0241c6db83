"""The time of day jumps an hour back and forth (NTP, daylight saving) at every look at it: no scan notices."""

import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

import nlos
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify
from nlos.time_of_day import shown_after

BERLIN = ZoneInfo("Europe/Berlin")
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


@pytest.fixture
def in_berlin(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize(
    ("begun", "end"),
    [
        (datetime(2026, 10, 24, 22, tzinfo=BERLIN), "Sun 07:00"),
        (datetime(2026, 3, 28, 22, tzinfo=BERLIN), "Sun 09:00"),
        (datetime(2026, 12, 31, 22, tzinfo=BERLIN), "Fri 08:00"),
    ],
)
@pytest.mark.usefixtures("in_berlin")
def test_ten_hours_end_when_the_clock_on_the_wall_shows_it(begun: datetime, end: str) -> None:
    """Of the nights in which clocks are set back and forth, and of a new year's."""
    assert shown_after(10 * 3600.0, begun.astimezone(UTC)) == end
