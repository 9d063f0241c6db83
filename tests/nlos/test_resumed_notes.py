"""A resumed recording keeps the notes that it was begun with, and says so to whoever gives others."""

from pathlib import Path

import pytest

from nlos.cli.app import load_verb
from nlos.cli.exit_codes import UsageError

SCAN = """
wall: {width_m: 0.4, height_m: 0.4, rows: 2, cols: 2}
pattern: serpentine
dwell_ms: 1
histogram: {bins: 64, bin_width_ps: 256, offset_ns: 10}
"""


def test_other_notes_are_refused_the_same_ones_are_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scan.yaml").write_text(SCAN)

    def scan(*words: str) -> None:
        load_verb("scan").main(["scan.yaml", "-o", "run.h5", *words], standalone_mode=False)

    scan("--sample", "hat", "--tag", "night")
    held = Path("run.h5").read_bytes()
    scan("--resume")
    scan("--resume", "--sample", " hat", "--tag", "night")
    for words in (("--sample", "cat"), ("--tag", "day"), ("--note", "later")):
        with pytest.raises(UsageError, match="keeps what it was begun with"):
            scan("--resume", *words)
    assert Path("run.h5").read_bytes() == held
