"""By which scheme a scan is taken is said before its light, and again where it turns out to be another."""

import json
import math
from pathlib import Path

import pytest

from nlos.acquisition.planning import schemes
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.scanning import lag_trial
from nlos.acquisition.scanning.lag import Lag
from nlos.acquisition.scanning.sweeping import LineRefused
from nlos.scan_preparation import known_lag
from tests.command import nlos

LINES = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 6, cols: 24}
pattern: raster
dwell_ms: 0.2
continuous: {}
histogram: {bins: 256, bin_width_ps: 32, offset_ns: 10}
"""


@pytest.mark.parametrize("fit", [True, False])
def test_lines_that_turn_out_not_to_fit_are_told_with_what_is_done_instead(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fit: bool
) -> None:
    monkeypatch.setattr(schemes, "USUAL", 0)  # else so small a scan is not worth the measurement

    def measure(*_: object) -> Lag:
        if not fit:
            error = LineRefused("mirror", "the run-up is too long. " + "There is more to say. " * 12, "Scan less.")
            error.lag = Lag(0.3e-3, 0.1, error.what)
            raise error
        return Lag(0.12e-3, 0.1)

    monkeypatch.setattr(lag_trial, "measure", measure)
    (tmp_path / "lines.yaml").write_text(LINES)
    done = nlos(tmp_path, "scan", "lines.yaml", "-o", "run.h5", "--json")
    assert done.returncode == 0, done.stderr
    assert "scheme S2, continuous lines" in done.stderr
    instead = "warning: scheme S2 (the counter's clock steps the mirror)"
    assert (instead in done.stderr) is not fit
    assert ("not in continuous lines: the run-up is too long." in done.stderr) is not fit
    assert json.loads(done.stdout)["scheme"] == ("S2, continuous lines" if fit else "S2")
    with Recording.open(tmp_path / "run.h5") as recording:
        assert len([event for event in recording.events() if event.kind == "scheme"]) == (1 if fit else 2)
        expected = [event.text for event in recording.events() if event.kind == "scheme"][-1]
        assert [event.kind for event in recording.events()].count("lag") == 1
    lag = known_lag(tmp_path / "run.h5")  # by which it is resumed
    assert lag is not None
    assert (lag.lag_s, lag.refused[:22]) == ((0.12e-3, "") if fit else (0.3e-3, "the run-up is too long"))
    assert lag.within_px == (0.1 if fit else math.inf)
    predicted_s = json.loads(done.stdout)["predicted_s"]
    assert f", {predicted_s:.1f} s expected" in expected
