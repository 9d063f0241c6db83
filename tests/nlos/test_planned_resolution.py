"""What `nlos plan` says of the resolution to expect: by the response, and by pixels."""

import json
import subprocess
from collections.abc import Callable

import numpy as np
import pytest

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]


def test_a_plan_says_what_resolution_to_expect(nlos: Nlos) -> None:
    told = json.loads(nlos("plan", "demo", "--json", "--response", "300").stdout)
    assert told["resolution_depth_m"] == pytest.approx(299792458 / 2 * 300e-12, rel=0.01)
    for depth_m, across_m in zip(told["at_depths_m"], told["resolution_across_m"], strict=True):
        assert across_m == pytest.approx(299792458 * 300e-12 * np.hypot(0.5, depth_m) / 1.0, rel=0.01)
    simulated = json.loads(nlos("plan", "demo", "--json").stdout)
    assert simulated["response_fwhm_s"] == pytest.approx(70e-12, rel=0.01)
    assert simulated["resolution_across_m"][0] == simulated["pixel_m"] == pytest.approx(1 / 64)
    unknown = json.loads(nlos("plan", "demo", "--bench", "lab", "--json").stdout)
    assert "response_fwhm_s" not in unknown
    assert unknown["pixel_m"] == pytest.approx(1 / 64)
