"""What is said of constants that are kept with their bench is what takes them."""

from pathlib import Path

import pytest

from nlos.__main__ import run as nlos
from tests.scan_texts import COARSE_TO_FINE, recorded


def test_constants_without_spots_are_not_said_to_aim(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = recorded(tmp_path, COARSE_TO_FINE)
    capsys.readouterr()
    assert nlos(["calibrate", str(run)]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert "taken from now on by `reconstruct`" in last
    assert "`plan` and `scan` go on aiming by the bench file" in last
    assert nlos(["plan", "demo"]) == 0
    assert "constants" not in capsys.readouterr().out
