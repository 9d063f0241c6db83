"""A trip outlasts the program: the next scan refuses until somebody clears it by name, and the log keeps all of it."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from nlos.configs.load import find

if TYPE_CHECKING:
    import subprocess

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]
SCAN = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 20, offset_ns: 10}
"""


@pytest.fixture
def multiharp(tmp_path: Path) -> Callable[[float], str]:
    def bench(trip_cps: float) -> str:
        text = find("bench", "multiharp").read_text()
        path = tmp_path / "bench.yaml"
        path.write_text(text.replace("safety:\n", f"safety:\n  trip_cps: {trip_cps}\n  trip_ms: 1.0\n"))
        return str(path)

    (tmp_path / "scan.yaml").write_text(SCAN)
    return bench


def test_a_trip_of_a_ttl_shutter_stands_until_it_is_cleared_by_name(
    nlos: Nlos, multiharp: Callable[[float], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    tripped = nlos("scan", "scan.yaml", "--bench", multiharp(20000), "-o", "run.h5")
    assert tripped.returncode == 5, tripped.stderr
    bench = multiharp(5e6)  # the limit is corrected; the trip still stands
    for again in (("-o", "other.h5"), ("-o", "run.h5", "--resume")):
        refused = nlos("scan", "scan.yaml", "--bench", bench, *again)
        assert refused.returncode == 4, refused.stderr
        assert "--clear-trip" in refused.stderr
    assert not (tmp_path / "other.h5").exists()
    for nobody in ("", "  "):
        assert nlos("doctor", "--bench", bench, "--clear-trip", nobody).returncode != 0
    assert nlos("scan", "scan.yaml", "--bench", bench, "-o", "run.h5", "--resume").returncode == 4
    assert "in the name of Ada" in nlos("doctor", "--bench", bench, "--clear-trip", "Ada").stdout
    done = nlos("scan", "scan.yaml", "--bench", bench, "-o", "run.h5", "--resume")
    assert done.returncode == 0, done.stderr
    (log,) = (tmp_path / "state" / "trips").glob("*.log")
    trip, override = log.read_text().splitlines()
    assert "trip: " in trip
    assert "counts/s" in trip
    assert "override: Ada cleared" in override


def test_shutter_close_needs_only_what_drives_the_shutter(nlos: Nlos, tmp_path: Path) -> None:
    for name in ("simulated", "multiharp"):
        assert nlos("shutter", "close", "--bench", name).returncode == 0
    text = find("bench", "simulated").read_text().replace("model: tcspc488\ngeometry", "model: none\ngeometry")
    (tmp_path / "none.yaml").write_text(text)
    assert nlos("shutter", "close", "--bench", "none.yaml").returncode == 4
    assert nlos("shutter", "open").returncode == 2
