"""The light of frames brought to one moment: moved as what they show has moved, by what registering them
and their photons tell."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.drivers.simulated.beam import SPEED_OF_LIGHT_M_PER_S, BeamPath, Spot
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.surfaces import Surface
from nlos.recon.over_time.following import FollowingMemory
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.over_time.moments import Moments, added, moments_of, moved
from nlos.recon.over_time.path import along, path_through
from nlos.recon.reconstruct import reconstruct

WALL, TIME = WallGrid(2.0, 2.0, 32, 32), TimeAxis(256, 64e-12)
DWELL_S, REPETITION_HZ = 0.4e-3, 10e6
VELOCITY_M_PER_S = np.array([0.5, -0.3, 0.2])
START_M = np.array([-0.3, 0.2, 0.8])


def light(*objects: Surface, hidden_cps: float = 3e6) -> SceneLight:
    """Of the simulated bench: what it draws shares no code with what is tested."""
    scene = SceneSettings(objects=objects, direct_cps=0.0, hidden_cps=hidden_cps, ambient_cps=500.0, surfel_m=0.02)
    return SceneLight(scene, DetectorSettings(), BeamPath(2.0), REPETITION_HZ, 1)


def panel(velocity_m_per_s: np.ndarray, yaw_deg: float = 0.0) -> Surface:
    """20 cm, from `START_M` on for 10 s."""
    end = {"at_s": 10.0, "centre_m": tuple(START_M + 10 * velocity_m_per_s)}
    return Surface.model_validate({"panel_m": (0.2, 0.2), "centre_m": tuple(START_M), "path": (end,)})


def frame(seen: SceneLight, number: int, begin_s: float | None = None) -> Moments:
    """8 x 8 points of the grid, every other frame backwards."""
    index = np.arange(16 * 16)[:: -1 if number % 2 else 1]
    row, col = 2 * (index // 16) + number % 2, 2 * (index % 16) + number // 2 % 2
    begin_s = 256 * DWELL_S * number if begin_s is None else begin_s
    taken_s = begin_s + (np.arange(256) + 0.5) * DWELL_S
    rng, counts = np.random.default_rng(number), []
    for x_m, y_m, at_s in zip(WALL.x_m()[col], WALL.y_m()[row], taken_s, strict=True):
        range_m = float(np.sqrt(x_m**2 + y_m**2 + 4))
        spot = Spot(x_m, y_m, range_m, 2 / range_m)
        photons = seen.photons_per_pulse(spot, TIME.bin_width_s, 2 * range_m / SPEED_OF_LIGHT_M_PER_S, at_s)
        counts.append(rng.poisson(photons[: TIME.bins] * DWELL_S * REPETITION_HZ))
    exposure_s = np.full(256, DWELL_S)
    return Moments(WALL.x_m()[col], WALL.y_m()[row], np.array(counts, np.float32), exposure_s, taken_s, WALL, TIME)


def mean_bins(points: Moments) -> np.ndarray:
    """The mean arrival at each point of the grid, (32, 32), NaN where few photons came."""
    bins, enough = np.arange(TIME.bins), points.counts.sum(axis=1) > 20
    means = np.where(enough, points.counts @ bins / np.maximum(points.counts.sum(axis=1), 1), np.nan)
    made = np.full((32, 32), np.nan)
    row, col = (np.rint(each / 0.0625 + 15.5).astype(int) for each in (points.y_m, points.x_m))
    made[row, col] = means
    return made


def test_light_moved_is_the_light_of_what_has_moved() -> None:
    """Arrivals of a small panel, moved to where it is later, against those of the panel there."""
    way_m, small = np.array([0.125, -0.125, 0.15]), {"panel_m": (0.05, 0.05)}
    before, after = (
        frame(light(Surface.model_validate(small | {"centre_m": tuple(START_M + way)}), hidden_cps=3e8), 0)
        for way in (0 * way_m, way_m)
    )
    done = moved(before, np.tile(way_m, (256, 1)), float((START_M + way_m)[2]), 0)
    assert 200 < len(done.x_m) < 256  # the outermost points went off the wall
    off, unmoved = (mean_bins(each) - mean_bins(after) for each in (done, before))
    assert np.isfinite(off).sum() > 50
    assert np.nanmedian(np.abs(off)) < 1.5
    assert np.nanmedian(np.abs(unmoved)) > 5
    late = 40  # the same of a record that begins late
    time = TimeAxis(TIME.bins - late, TIME.bin_width_s, late * TIME.bin_width_s)
    cut = replace(before, counts=np.ascontiguousarray(before.counts[:, late:]), time=time)
    whole, part = (moved(each, np.tile(way_m, (256, 1)), 0.95, 0).counts[:, -196:] for each in (before, cut))
    assert np.abs(whole - part).sum() < 0.01 * whole.sum()
    still = moved(before, np.zeros((256, 3)), 1.0, 0)
    assert np.array_equal(still.counts, before.counts)


def test_a_frames_moment_is_that_of_its_exposure() -> None:
    each = np.zeros(3)
    points = Moments(each, each, np.zeros((3, 256), np.float32), np.array([1.0, 1.0, 8.0]), np.array([0.0, 1.0, 2.0]),
                     WALL, TIME)  # fmt: skip
    assert points.mean_s == pytest.approx(1.7)


def test_a_path_goes_through_its_pairs_and_not_through_an_outlier() -> None:
    places = np.array([[0.05 * k, -0.02 * k, 0.001 * k**2] for k in range(8)])
    pairs = {
        (a, b): (places[b] - places[a], 1.0) for a in range(8) for b in range(a + 1, min(a + 5, 8))
    }  # fmt: skip
    pairs[2, 3] = (np.array([0.4, 0.4, -0.4]), 1.0)
    found = path_through(pairs, list(range(8)))
    assert found == pytest.approx(places - places[-1], abs=0.004)
    assert along(found, np.arange(8.0), np.array([6.5, 8.0]))[:, 0] == pytest.approx([-0.025, 0.05], abs=0.004)
    assert path_through({}, [0]) == pytest.approx(np.zeros((1, 3)))
    assert path_through({}, [0, 1, 2]) == pytest.approx(np.zeros((3, 3)))


def off_its_way_m(memory: LightMemory, seen_s: list[float], at: int) -> np.ndarray:
    """How far off the panel's path that of a memory is, of frames of these moments (F, 3)."""
    moments_s = np.array(seen_s)
    return np.abs(memory.path_m - VELOCITY_M_PER_S * (moments_s - moments_s[at])[:, None])


def test_a_memory_finds_the_motion_and_brings_the_light_along() -> None:
    memory, seen = LightMemory(WALL, TIME), light(panel(VELOCITY_M_PER_S))
    frames = [frame(seen, number) for number in range(6)]
    for each in frames:
        together = memory.add(each)
    assert memory.weights[-1] == 1
    assert together.exposure_s.sum() == pytest.approx(256 * DWELL_S * memory.weights.sum(), rel=0.1)
    off_m = off_its_way_m(memory, [each.mean_s for each in frames], 5)
    assert off_m.max() < 0.02
    assert off_m.mean() < 0.008
    assert 0.05 < memory.weights[-2] < 1


@pytest.mark.parametrize("pictured", [True, False])
def test_a_memory_that_follows_pictures_finds_the_motion_better(pictured: bool) -> None:
    """Or what the volume of the frame before shows, where nobody made a picture. Each frame's light holds that of
    frames before and after it."""
    memory, seen = FollowingMemory(WALL, TIME), light(panel(VELOCITY_M_PER_S))
    frames = [frame(seen, number) for number in range(6)]
    for number, together in enumerate(memory.each_brought(frames)):
        there = [each.mean_s for each in frames[: number + 2]]
        assert memory.weights[number] == 1
        assert together.exposure_s.sum() == pytest.approx(256 * DWELL_S * memory.weights.sum(), rel=0.1)
        off_m = off_its_way_m(memory, there, number)
        assert off_m[max(number - 2, 0) :].max() < 0.02
        assert (np.delete(memory.weights, number)[max(number - 1, 0) :] > 0.2).all()
        if pictured:
            memory.pictured(reconstruct(together, "lct", explain=False))
    assert number == 5
    assert off_m.mean() < 0.004


@pytest.mark.parametrize("count", [0, 1, 2])
def test_of_short_films_every_frame_has_its_light(count: int) -> None:
    memory, seen = FollowingMemory(WALL, TIME), light(panel(np.zeros(3)))
    brought = list(memory.each_brought(frame(seen, number) for number in range(count)))
    assert len(brought) == count
    assert all(np.count_nonzero(each.exposure_s) == 256 * count for each in brought)


def test_light_of_what_rests_is_kept_and_of_what_is_gone_is_not() -> None:
    still = light(panel(np.zeros(3)))
    memory = LightMemory(WALL, TIME)
    for number in range(5):
        kept = memory.add(frame(still, number))
    assert memory.weights.min() > 0.3
    assert np.abs(memory.path_m).max() < 0.02
    assert np.count_nonzero(kept.exposure_s) == 4 * 256
    other = light(Surface.model_validate({"letter": "X", "height_m": 0.5, "centre_m": (0.5, -0.4, 1.3)}))
    memory.add(frame(other, 5))
    assert memory.weights[:-1].max() < 0.1


def test_a_memory_that_follows_pictures_keeps_the_light_of_what_rests_and_drops_that_of_what_is_gone() -> None:
    still, memory = light(panel(np.zeros(3))), FollowingMemory(WALL, TIME)
    other = light(Surface.model_validate({"letter": "X", "height_m": 0.5, "centre_m": (0.5, -0.4, 1.3)}))
    frames = [*(frame(still, number) for number in range(5)), frame(other, 5)]
    for number, brought in enumerate(memory.each_brought(frames)):
        if number == 3:
            assert memory.weights.min() > 0.3
            assert np.count_nonzero(brought.exposure_s) == 4 * 256
        if number == 4:
            assert memory.weights[-1] < 0.1  # what comes next
        memory.pictured(reconstruct(brought, "lct", explain=False))
    assert memory.weights[:5].max() < 0.1
    assert memory.weights[5] == 1


def test_frames_without_light_leave_each_frame_its_own() -> None:
    seen, memory = light(), LightMemory(WALL, TIME)
    dark = [replace(each, counts=0 * each.counts) for each in (frame(seen, 0), frame(seen, 1))]
    for each in dark:
        together = memory.add(each)
    assert together.counts.sum() == 0
    alone = added([dark[1]], [1.0])
    assert np.array_equal(moments_of(alone, alone.exposure_s).counts, np.zeros((256, 256)))
