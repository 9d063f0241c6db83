"""Photons of a scene that moves, against the true place of object and beam at the moment each point is lit."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

from nlos.acquisition.planning.preflight import aim_of
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.engine import scan
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import SPEED_OF_LIGHT_M_PER_S, BeamPath
from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.motion import pose_at
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface

BIN_S = 32e-12
QUIET = DetectorSettings(dark_cps=0.0, dead_time_ns=0.0, tail_fraction=0.0)
BEAM = MirrorAngles(0.05, -0.03)
PATCH: dict[str, object] = {"panel_m": (0.01, 0.01), "centre_m": (-0.2, 0.0, 0.8)}


def surface(words: dict[str, object]) -> Surface:
    """As a bench file says it."""
    return Surface.model_validate_json(json.dumps(words))


def light(*objects: dict[str, object], surfel_m: float = 0.01) -> SceneLight:
    surfaces = tuple(surface(each) for each in objects)
    scene = SceneSettings(objects=surfaces, direct_cps=0.0, hidden_cps=1e9, ambient_cps=0.0, surfel_m=surfel_m)
    return SceneLight(scene, QUIET, BeamPath(2.0), 10e6, seed=5)


def gate(time_s: float, dwell_s: float = 1e-3) -> Gate:
    return Gate(50.0 + time_s, dwell_s, 1024, BIN_S, 10e-9, 0, since_lit_s=time_s)


def mean_arrival_s(counts: np.ndarray) -> float:
    return float((counts * (np.arange(len(counts)) + 0.5)).sum() / counts.sum()) * BIN_S + 10e-9


def due_s(place_m: np.ndarray) -> float:
    """When light comes back by way of `place_m`: to the spot on the wall, on to the object, and the same way back."""
    spot_m = np.array([2.0 / np.cos(BEAM.y_rad) * np.tan(BEAM.x_rad), 2.0 * np.tan(BEAM.y_rad), 0.0])
    range_m = 2.0 / np.cos(BEAM.y_rad) / np.cos(BEAM.x_rad)
    return 2 * (range_m + float(np.linalg.norm(place_m - spot_m))) / SPEED_OF_LIGHT_M_PER_S


@pytest.mark.parametrize("time_s", [0.0, 0.3, 1.0, 1.7, 2.0, 9.0])
def test_photons_come_from_where_the_object_is_when_the_point_is_lit(time_s: float) -> None:
    path = [{"at_s": 1.0, "centre_m": (0.2, 0.1, 0.8)}, {"at_s": 2.0, "centre_m": (0.2, -0.3, 1.1)}]
    turns = [np.array([-0.2, 0.0, 0.8]), np.array([0.2, 0.1, 0.8]), np.array([0.2, -0.3, 1.1])]
    leg = min(int(time_s), 1)
    place_m = turns[leg] + min(time_s - leg, 1.0) * (turns[leg + 1] - turns[leg])
    counts = light(PATCH | {"path": path})(gate(time_s), BEAM, True).counts
    assert counts.sum() > 30
    assert mean_arrival_s(counts) == pytest.approx(due_s(place_m), abs=5 * 40e-12 / counts.sum() ** 0.5)


def test_a_still_scene_is_the_same_at_every_moment() -> None:
    still = light(PATCH, {"letter": "S", "centre_m": (0.1, 0.0, 0.9), "height_m": 0.3})
    for beam in (BEAM, MirrorAngles(0.0, 0.0)):
        assert np.array_equal(still(gate(0.0), beam, True).counts, still(gate(7.0), beam, True).counts)


def test_objects_appear_and_vanish() -> None:
    here = light(PATCH | {"appears_s": 1.0, "vanishes_s": 2.0})
    assert [here(gate(at), BEAM, True).total_count > 0 for at in (0.0, 0.99, 1.0, 1.9, 2.0, 5.0)] == [
        False, False, True, True, False, False,
    ]  # fmt: skip
    assert here(gate(1.5), BEAM, False).total_count == 0
    # A dwell of which it is there for the first half only has half its photons.
    whole, half = (here(gate(at, 0.2), BEAM, True).total_count for at in (1.5, 1.9))
    assert half / whole == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("turn", ["yaw_deg", "pitch_deg"])
def test_a_turned_panel_is_as_dim_as_its_normal_says(turn: str) -> None:
    turning = light(PATCH | {"centre_m": (0.0, 0.0, 0.8), "path": [{"at_s": 1.0, turn: 60.0}]})
    still = light(PATCH | {"centre_m": (0.0, 0.0, 0.8), turn: 30.0})
    spot = BeamPath(2.0).spot(BEAM)
    half_way, due = (each.photons_per_pulse(spot, BIN_S, 10e-9, at) for each, at in ((turning, 0.5), (still, 0.0)))
    assert half_way == pytest.approx(due, rel=1e-9)
    assert half_way.sum() < 0.95 * turning.photons_per_pulse(spot, BIN_S, 10e-9, 0.0).sum()


def test_rolling_turns_in_the_plane() -> None:
    rolling = surface({"panel_m": (0.4, 0.1), "centre_m": (0.0, 0.0, 1.0), "path": [{"at_s": 2.0, "roll_deg": 180.0}]})
    turned = pose_at(1.0, rolling.pose, rolling.path).rotation
    assert turned @ np.array([1.0, 0.0, 0.0]) == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)
    assert turned @ np.array([0.0, 0.0, 1.0]) == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)


def test_a_long_dwell_is_the_mean_over_its_moments() -> None:
    """A dwell of a second is the sum of what many short ones hold."""
    moving = light(PATCH | {"path": [{"at_s": 1.0, "centre_m": (-0.05, 0.0, 0.8)}]})
    spot = BeamPath(2.0).spot(BEAM)
    fine = np.mean([moving.photons_per_pulse(spot, BIN_S, 10e-9, (k + 0.5) / 500) for k in range(500)], axis=0)[:1024]
    counts = moving(gate(0.0, 1.0), BEAM, True).counts
    expected = fine * 10e6
    by_then, due = (np.cumsum(each) / each.sum() for each in (counts, expected))
    assert np.abs(by_then - due).max() < 0.02
    middle = np.cumsum(moving.photons_per_pulse(spot, BIN_S, 10e-9, 0.5)[:1024])
    assert np.abs(middle / middle[-1] - due).max() > 0.1
    assert counts.sum() == pytest.approx(expected.sum(), rel=0.02)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ({"path": [{"at_s": 2.0}, {"at_s": 1.0}]}, "must grow"),
        ({"path": [{"at_s": 1.0, "centre_m": (0.0, 0.0, -0.1)}]}, "in front of the wall"),
        ({"path": [{"at_s": 1.0, "yaw_deg": 120.0}]}, "faces away"),
        ({"appears_s": 2.0, "vanishes_s": 1.0}, "is not after"),
        ({"path": [{"at_s": 0.0}]}, "greater than 0"),
        ({"path": [{"at_s": 1.0, "center_m": (0, 0, 1)}]}, "center_m"),
    ],
)
def test_paths_that_no_object_takes_are_refused(words: dict[str, object], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        surface(PATCH | words)


@pytest.mark.parametrize(
    ("name", "scheme"),
    [("simulated", Scheme.STEPPED), ("simulated", Scheme.CLOCKED), ("multiharp", Scheme.LISTED),
     ("helios", Scheme.PLAYED)],
)  # fmt: skip
def test_a_scan_finds_each_photon_where_beam_and_object_were(name: str, scheme: Scheme) -> None:
    """Every sample's mean arrival is that of a small sphere on its path at the sample's own time, from the wall point
    that the beam lit."""
    settings = load("bench", name, BenchSettings).settings
    sphere = surface(
        {"sphere_m": 0.02, "centre_m": (-0.3, 0.1, 0.6), "path": [{"at_s": 0.8, "centre_m": (0.3, -0.1, 0.8)}]}
    )
    scene = SceneSettings(objects=(sphere,), direct_cps=0.0, hidden_cps=4e8, ambient_cps=0.0)
    assert settings.simulation is not None
    simulation = settings.simulation.model_copy(update={"scene": scene, "detector": QUIET})
    settings = settings.model_copy(update={"simulation": simulation})
    words = {
        "wall": {"width_m": 1.0, "height_m": 1.0, "rows": 6, "cols": 6},
        "pattern": "serpentine",
        "dwell_ms": 4,
        "histogram": {"bins": 1024, "bin_width_ps": 32, "offset_ns": 8},
        "frames": 4,
    }
    with open_bench(settings) as bench:
        plan = ScanSettings.model_validate(words).plan()
        plan = plan.on_axis(bench.counter.nearest_axis(plan.axis))
        if name == "multiharp" and bench.simulated is not None:
            bench.simulated.set_shutter(True)
        aim = aim_of(bench)
        samples = list(scan(plan, bench, scheme=scheme))
        geometry = bench.settings.geometry
    lit_s = min(sample.taken_s for sample in samples)
    off_m, blind_m = [], []
    for sample in samples:
        histogram, point = sample.histogram, sample.point
        assert histogram.counts.sum() > 20
        bins = (np.arange(len(histogram.counts)) + 0.5) * histogram.bin_width_s + histogram.offset_s
        arrival_s = float((histogram.counts * bins).sum() / histogram.counts.sum())
        x_rad, y_rad = aim.angles_rad(np.array([point.x_m]), np.array([point.y_m]))
        spot = BeamPath(geometry.wall_distance_m, geometry.mirror_separation_m).spot(
            MirrorAngles(float(x_rad[0]), float(y_rad[0]))
        )
        assert spot is not None
        way_m = arrival_s * SPEED_OF_LIGHT_M_PER_S / 2 - spot.range_m
        true_m = np.array(pose_at(sample.taken_s - lit_s + 0.002, sphere.pose, sphere.path).centre_m)
        wall_m = np.array([point.x_m, point.y_m, 0.0])
        off_m.append(way_m - float(np.linalg.norm(true_m - wall_m)))
        blind_m.append(way_m - float(np.linalg.norm(np.array(sphere.centre_m) - wall_m)))
    # The nearer half of a sphere of 2 cm sends the light: it comes from somewhat before its centre.
    assert np.mean(off_m) == pytest.approx(-0.012, abs=0.004)
    assert np.std(off_m) < 0.005
    assert np.std(blind_m) > 0.05  # what a scene at rest would have been told apart from
