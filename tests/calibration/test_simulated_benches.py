"""Known constants of simulated benches, recovered from what they record: wall, delay, dark, ambient, dead time."""

import numpy as np
import pytest

from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.calibration.correct import correct_points
from nlos.calibration.detector import undo_dead_time
from nlos.calibration.measure import measure_constants
from nlos.calibration.raw_points import RawPoints
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath, Misalignment
from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings

HZ = 10e6
AIM = Aim(2.0, 0.01)
OFF = Misalignment(wall_pitch_deg=3.0, wall_yaw_deg=-4.0)
PATH = BeamPath(AIM.wall_distance_m, AIM.mirror_separation_m, OFF)
WHOLE_PERIOD = TimeAxis(1250, 80e-12, 8e-9)


def recorded(
    light: SceneLight, side: int, axis: TimeAxis, dwell_s: float, aim: Aim = AIM, shutter_open: bool = True
) -> RawPoints:
    wall = WallGrid(1.2, 1.2, side, side)
    x, y = (a.ravel() for a in np.meshgrid(wall.x_m(), wall.y_m()))
    angles = zip(*aim.angles_rad(x, y), strict=True)
    taken = [
        light(Gate(0.0, dwell_s, axis.bins, axis.bin_width_s, axis.start_s, i), MirrorAngles(a, b), shutter_open)
        for i, (a, b) in enumerate(angles)
    ]
    return RawPoints(
        np.stack([t.counts for t in taken]),
        x,
        y,
        np.array([t.live_s for t in taken]),
        np.array([float(t.sync_count) for t in taken]),
        np.array([float(t.total_count) for t in taken]),
        axis,
    )


@pytest.mark.parametrize(("dead_time_ns", "jitter_fwhm_ps"), [(77.0, 70.0), (30.0, 40.0)])
def test_every_constant_lies_within_its_error(dead_time_ns: float, jitter_fwhm_ps: float) -> None:
    detector = DetectorSettings(jitter_fwhm_ps=jitter_fwhm_ps, dead_time_ns=dead_time_ns, dark_cps=300)
    scene = SceneSettings(direct_cps=0.2 * HZ, ambient_cps=20e3, delay_ns=0.35)
    covered = SceneSettings(direct_cps=0.0, ambient_cps=0.0)
    raw = recorded(SceneLight(scene, detector, PATH, HZ, 7), 12, WHOLE_PERIOD, 0.05)
    dark = recorded(SceneLight(covered, detector, PATH, HZ, 8), 4, WHOLE_PERIOD, 1.0, shutter_open=False)
    found = measure_constants([raw, dark], devices={}, sources=[], measured_utc="2026-01-01", aim=AIM)
    constants, fit = found.constants, found.geometry
    assert fit is not None
    assert constants.dead_time_s is not None
    assert constants.dark_hz is not None
    assert constants.ambient_hz is not None
    for what, value, error, truth in (
        ("distance", fit.geometry.wall_distance_m, fit.errors["wall_distance_m"], 2.0),
        ("pitch", np.rad2deg(fit.geometry.wall_pitch_rad), np.rad2deg(fit.errors["wall_pitch_rad"]), 3.0),
        ("yaw", np.rad2deg(fit.geometry.wall_yaw_rad), np.rad2deg(fit.errors["wall_yaw_rad"]), -4.0),
        ("delay", fit.delay_s * 1e9, fit.errors["delay_s"] * 1e9, 0.35),
        ("dead time", constants.dead_time_s.value * 1e9, constants.dead_time_s.error * 1e9, dead_time_ns),
        ("dark", constants.dark_hz.value, constants.dark_hz.error, 300.0),
        ("ambient", constants.ambient_hz.value, constants.ambient_hz.error, 20e3),
    ):
        assert abs(value - truth) <= 3 * error, what
    light = SceneLight(scene, detector, PATH, HZ, 7)
    beams = [MirrorAngles(a, b) for a, b in zip(*AIM.angles_rad(raw.x_m, raw.y_m), strict=True)]
    photons = sum(light.photons_per_pulse(PATH.spot(beam), 80e-12, 8e-9).sum() for beam in beams) * raw.sync_count[0]
    assert undo_dead_time(raw, constants)[0].sum() == pytest.approx(photons, rel=0.01)
    x_rad, y_rad = fit.geometry.angles_rad(0.5, -0.5)
    hit = PATH.spot(MirrorAngles(float(x_rad), float(y_rad)))
    assert hit is not None
    assert np.hypot(hit.x_m - 0.5, hit.y_m + 0.5) < 5e-3


def test_dark_counts_and_afterpulses_are_told_apart_from_each_other_and_from_ambient_light() -> None:
    """A noisy detector: with its afterpulses dark counts would be 7 % too many, with its dark counts ambient light
    twice as much."""
    detector = DetectorSettings(dead_time_ns=40.0, dark_cps=20e3, afterpulse_probability=0.07)
    scene = SceneSettings(direct_cps=0.02 * HZ, ambient_cps=20e3, delay_ns=0.35)
    covered = SceneSettings(direct_cps=0.0, ambient_cps=0.0)
    raw = recorded(SceneLight(scene, detector, PATH, HZ, 7), 12, WHOLE_PERIOD, 0.05)
    dark = recorded(SceneLight(covered, detector, PATH, HZ, 8), 4, WHOLE_PERIOD, 1.0, shutter_open=False)
    found = measure_constants([raw, dark], devices={}, sources=[], measured_utc="2026-01-01", aim=AIM).constants
    assert found.dark_hz is not None
    assert found.ambient_hz is not None
    assert found.afterpulse_probability is not None
    assert found.afterpulse_probability.value == pytest.approx(0.07, abs=0.01)
    assert found.dark_hz.value == pytest.approx(20e3, rel=0.015)
    assert found.ambient_hz.value == pytest.approx(20e3, rel=0.1)


def test_the_default_scene_is_calibrated_without_being_told_anything() -> None:
    scene = SceneSettings(delay_ns=0.35)
    light = SceneLight(scene, DetectorSettings(), BeamPath(2.0), HZ, 20260)
    raw = recorded(light, 16, TimeAxis(512, 32e-12, 10e-9), 8e-3, Aim(2.0))
    done = correct_points(raw)
    assert done.offsets is not None
    assert done.offsets.wall is not None
    assert done.offsets.rms_bins < 0.25
    assert abs(done.offsets.wall.delay_s * 1e9 - 0.35) < 4e9 * done.offsets.wall.covariance[3, 3] ** 0.5
