"""The simulated galvo head: no table of settling times moves it, and the one that plans scans bounds it from above."""

import math

import numpy as np
import pytest

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.settle import SettleModel
from nlos.drivers.simulated.servo import GalvoHead, ServoAxis, ServoSettings

HEAD = ServoSettings()


def optical(mechanical_deg: float) -> float:
    return 2.0 * math.radians(mechanical_deg)


@pytest.mark.parametrize("step_deg", [0.02, 0.1, 0.4, 0.5, 1.0, 3.0, 10.0, 20.0, 40.0])
def test_a_step_is_at_rest_within_the_time_that_plans_allow_it(step_deg: float) -> None:
    axis = ServoAxis(HEAD)
    axis.steer(optical(step_deg), 1.0)
    allowed_s = SettleModel().axis_settle_s(optical(step_deg))
    assert axis.at(1.0 + 0.95 * allowed_s) == optical(step_deg)
    assert abs(axis.at(1.0 + 0.1e-3) - optical(step_deg)) > 0.05 * optical(step_deg)


def test_a_sine_at_the_stated_bandwidth_has_lost_three_decibels() -> None:
    axis = ServoAxis(HEAD.model_copy(update={"rest_deg": 1e-9}))
    step_s, amplitude = 2e-6, 1e-3
    times = np.arange(0, 4e-3, step_s)
    seen = []
    for when_s in times.tolist():
        axis.steer(amplitude * math.sin(2 * math.pi * HEAD.bandwidth_hz * when_s), when_s)
        seen.append(axis.at(when_s))
    assert max(seen[len(seen) // 2 :]) == pytest.approx(amplitude / math.sqrt(2), rel=0.01)


def test_no_axis_turns_faster_than_its_slew_limit_and_it_moves_smoothly() -> None:
    axis = ServoAxis(HEAD)
    axis.steer(optical(20.0), 0.0)
    places = np.array([axis.at(t) for t in np.arange(0, 5e-3, 1e-6).tolist()])
    speed = np.diff(places) / 1e-6
    assert speed.max() <= optical(HEAD.slew_deg_per_s) * (1 + 1e-6)
    assert speed.max() > 0.95 * optical(HEAD.slew_deg_per_s)
    turning = np.abs(np.diff(speed))[places[2:] < optical(20.0)]
    assert turning[:-1].max() < 0.03 * optical(HEAD.slew_deg_per_s)


def test_a_ramp_of_steps_is_trailed_by_a_constant_time() -> None:
    """Delay, twice the inverse of the natural frequency, and half the time that the slew limit gives each step."""
    axis = ServoAxis(HEAD)
    step_rad, dwell_s = optical(0.2), 122e-6
    errors = []
    for k in range(60):
        axis.steer((k + 1) * step_rad, k * dwell_s)
        mean = np.mean([axis.at((k + (i + 0.5) / 64) * dwell_s) for i in range(64)])
        errors.append(((k + 1) * step_rad - mean) / step_rad * dwell_s)
    natural = 2 * math.pi * HEAD.bandwidth_hz / math.sqrt(math.sqrt(2) - 1)
    lag_s = HEAD.delay_us * 1e-6 + 2 / natural + step_rad / optical(HEAD.slew_deg_per_s) / 2
    assert errors[20:] == pytest.approx([lag_s] * 40, rel=1e-3)


def test_a_movement_does_not_depend_on_when_it_is_made() -> None:
    ways = []
    for start_s in (0.0, 1234.567891):
        head = GalvoHead(HEAD)
        for k in range(20):
            head.steer(MirrorAngles(0.003 * k, -0.001 * k), start_s + k * 122e-6)
        ways.append([head.at(start_s + 19 * 122e-6 + t) for t in (0.0, 1e-5, 5e-5, 3e-4, 2e-3)])
    assert ways[0] == ways[1]


def test_the_same_target_again_and_a_time_gone_by_disturb_nothing() -> None:
    axis = ServoAxis(HEAD)
    axis.steer(0.1, 1.0)
    on_its_way = axis.at(1.0005)
    axis.steer(0.1, 1.0002)
    assert axis.at(1.0005) == on_its_way
    axis.steer(0.2, 0.5)
    assert math.isfinite(axis.at(2.0))
    assert axis.at(2.0) == 0.2
