"""Scan files that several tests use, and a recording made by one of them."""

from pathlib import Path

from tests.command import nlos

COARSE_TO_FINE = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: coarse_to_fine, batch: 8}
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
EIGHT_BY_EIGHT = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 4
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
THREE_BY_FOUR = """\
wall: {width_m: 0.8, height_m: 0.6, rows: 3, cols: 4}
pattern: serpentine
dwell_ms: 4
histogram: {bins: 64, bin_width_ps: 256, offset_ns: 8}
"""


def recorded(folder: Path, text: str) -> Path:
    """Writes `scan.yaml` to the folder and scans it on the simulated bench: `run.h5`."""
    (folder / "scan.yaml").write_text(text)
    nlos(folder, "scan", "scan.yaml", "-o", "run.h5", check=True)
    return folder / "run.h5"
