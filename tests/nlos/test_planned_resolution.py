"""What `nlos plan` says of the resolution to expect: by the response, and by pixels."""

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

COLUMN = """
wall: {width_m: 0.05, height_m: 1.0, rows: 16, cols: 1}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]


def test_a_plan_says_what_resolution_to_expect(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "column.yaml").write_text(COLUMN)
    told = json.loads(nlos("plan", "demo", "--json", "--response", "300").stdout)
    assert told["resolution_depth_m"] == pytest.approx(299792458 / 2 * 300e-12, rel=0.01)
    for depth_m, across_m in zip(told["at_depths_m"], told["resolution_across_m"], strict=True):
        assert across_m == pytest.approx(299792458 * 300e-12 * np.hypot(0.5, depth_m) / 1.0, rel=0.01)
    simulated = json.loads(nlos("plan", "demo", "--json").stdout)
    assert simulated["response_fwhm_s"] == pytest.approx(70e-12, rel=0.01)
    assert simulated["resolution_across_m"][0] == simulated["pixel_m"] == pytest.approx(1 / 64)
    column = json.loads(nlos("plan", "column.yaml", "--json", "--response", "300").stdout)
    assert column["resolution_across_m"] == [max(each, 0.0625) for each in told["resolution_across_m"]]
    unknown = json.loads(nlos("plan", "demo", "--bench", "lab", "--json").stdout)
    assert "response_fwhm_s" not in unknown
    assert unknown["pixel_m"] == pytest.approx(1 / 64)
