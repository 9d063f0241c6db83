"""What a refinement may change of a picture, and what becomes of an interval head's words: number by number."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest
import torch
from torch import Tensor, nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.intervals import TRAITS, UNCALIBRATED, CalibratedHead, adjusted, intervals_of, traits_of
from nlos.recon.layers.evidence import NAMES, UNTOLD
from nlos.recon.layers.interval_head import IntervalHead, RawIntervals
from nlos.recon.layers.light_left_over import AROUND, CHANNELS
from nlos.recon.layers.refinement import ALBEDO, ASKED, CHANGE, DEPTH, Correction, Refinement
from nlos.recon.layers.wiener_volumes import WienerVolumes
from nlos.recon.predicted_error import ErrorLine

SIDE = 16


def correction(added: float = 0.0, share: float = 0.0, deeper: float = 0.0) -> Correction:
    """One that says the same everywhere."""
    made = Correction()
    with torch.no_grad():
        made.network.head.bias.copy_(torch.tensor([added, share, deeper]))  # type: ignore[union-attr]
    return made.eval()


def found(**maps: Tensor) -> Tensor:
    out = torch.zeros(len(CHANNELS), SIDE, SIDE)
    for name, values in maps.items():
        out[CHANNELS.index(name)] = values
    return out


@torch.no_grad()
def test_what_the_network_says_is_added_and_outshines_nothing_around() -> None:
    albedo = torch.zeros(SIDE, SIDE)
    albedo[4, 4], albedo[12, 12] = 0.8, 0.3
    change = torch.full((SIDE, SIDE), 0.1)
    seen = found(albedo=albedo, change=change)[None]
    assert (seen[0, ALBEDO] == albedo).all()
    assert (seen[0, CHANGE] == change).all()
    same, none = correction()(seen)
    assert torch.allclose(same[0], albedo)
    assert not none.any()
    brighter = correction(added=0.05, share=2.0)(seen)[0][0]
    assert brighter[4, 4 + AROUND] == pytest.approx(0.25)
    assert brighter[4, 4] == pytest.approx(0.8)  # no brighter than the brightest around it
    assert brighter[12, 12] == pytest.approx(0.3)
    assert brighter[8, 15] == 0.0
    assert not correction(added=-1.0)(seen)[0].any()
    assert correction(deeper=2.0)(seen)[1][0] == pytest.approx(torch.full((SIDE, SIDE), 2 * 0.25 / SIDE))


def test_depths_change_where_the_light_was_asked_and_nowhere_else() -> None:
    asked = torch.zeros(SIDE, SIDE)
    asked[:, :5] = 1.0
    of_light = found(asked=asked, depth=torch.full((SIDE, SIDE), -0.1), albedo=torch.ones(SIDE, SIDE))
    assert of_light[ASKED].sum() == 5 * SIDE
    assert (of_light[DEPTH] == -0.1).all()
    refinement = Refinement(correction(deeper=2.0), WallGrid(1.0, 1.0, SIDE, SIDE), TimeAxis(32, 1e-10), 4.0)
    answers = [of_light, None]
    refinement.left_over = lambda *_: answers.pop(0)  # type: ignore[assignment,method-assign]
    counts, depth = torch.ones(2, 1, 32, SIDE, SIDE), torch.full((2, SIDE, SIDE), 0.7)
    refined = refinement(counts, None, None, torch.ones(2, SIDE, SIDE), depth)
    assert refined.depth[0, :, :5] == pytest.approx(torch.full((SIDE, 5), 0.4 + 0.5 / SIDE))
    assert (refined.depth[0, :, 5:] == 0.7).all()
    assert (refined.depth[1] == 0.7).all()
    assert (refined.found[1] == 0).all()


def test_intervals_are_in_metres_and_no_surface_is_surer_than_that_there_is_one() -> None:
    class Says(nn.Module):
        def forward(self, evidence: Tensor) -> RawIntervals:
            each = [
                torch.full(evidence.shape[:1] + evidence.shape[2:], value) for value in (0.5, 0.6, 0.1, 0.2, 0.05, 0.15)
            ]
            return RawIntervals(*each, torch.zeros_like(each[0]))

    head = CalibratedHead(cast(IntervalHead, Says()), UNCALIBRATED, ErrorLine(1.0, 0.0, 0.0))
    physics = cast(WienerVolumes, SimpleNamespace(unit_m=2.0))
    made = intervals_of(head, torch.zeros(2, len(NAMES), 4, 4), torch.tensor([1.0, 0.25]), physics)
    expected = {"albedo_low": 0.4, "albedo_high": 0.7, "depth_low_m": 1.1, "depth_high_m": 1.5}
    for name, value in expected.items():
        assert made[name] == pytest.approx(torch.full((2, 4, 4), value)), name
    assert made["seen"][:, 0, 0].tolist() == pytest.approx([0.5, 0.125])


def test_each_side_of_an_interval_is_as_wide_as_its_own_calibration_says() -> None:
    """Brightness by 2, depth by 3, at a trait of 0."""
    zeros = (0.0,) * len(TRAITS)
    calibration = replace(UNCALIBRATED, albedo=(math.log(2.0), *zeros), depth=(math.log(3.0), *zeros))
    raw = RawIntervals(*(torch.full((1, 2, 2), value) for value in (0.5, 0.6, 0.1, 0.15, 0.05, 0.07, 0.0)))
    made = adjusted(raw, calibration, torch.zeros(1, len(TRAITS)))
    expected = {"albedo_low": 0.3, "albedo_high": 0.8, "depth_low": 0.45, "depth_high": 0.81, "seen": 0.5}
    for name, value in expected.items():
        assert getattr(made, name) == pytest.approx(torch.full((1, 2, 2), value)), name


def test_traits_of_a_scan_are_its_noise_its_points_and_whether_a_response_was_told() -> None:
    """A quarter of 16 x 32 points: the evidence `kept` is half of the logarithm of the share."""
    evidence = torch.zeros(2, len(NAMES), 16, 32)
    evidence[:, NAMES.index("noise")], evidence[:, NAMES.index("kept")] = -1.5, -1.0
    evidence[0, NAMES.index("response")], evidence[1, NAMES.index("response")] = UNTOLD, 0.2
    assert traits_of(evidence).tolist() == [[-1.5, 7.0, 0.0], [-1.5, 7.0, 1.0]]
