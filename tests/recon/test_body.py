"""What a picture shows is followed through frames by their photons, which the bench draws from known paths."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.drivers.simulated.surfaces import Surface
from nlos.recon.over_time.body import body_of, motion_of
from nlos.recon.over_time.body_light import Body, BodyLight
from nlos.recon.over_time.moments import Moments
from tests.recon.test_over_time import START_M, VELOCITY_M_PER_S, WALL, frame, light, panel

FRAMES = 4
OTHER_M = np.array([0.45, -0.4, 1.0])


def shown(*centres_m: np.ndarray, wall: WallGrid = WALL) -> tuple[np.ndarray, np.ndarray]:
    """A perfect picture of panels of 20 cm: brightness and depth (H, W)."""
    x_m, y_m = np.meshgrid(wall.x_m(), wall.y_m())
    albedo, depth_m = np.zeros((wall.rows, wall.cols)), np.full((wall.rows, wall.cols), np.nan)
    for centre_m in centres_m:
        there = (np.abs(x_m - centre_m[0]) < 0.1) & (np.abs(y_m - centre_m[1]) < 0.1)
        albedo[there], depth_m[there] = 1.0, centre_m[2]
    return albedo, depth_m


def body_at(moment_s: float, *centres_m: np.ndarray) -> Body:
    body = body_of(*shown(*centres_m), WALL, moment_s)
    assert body is not None
    return body


def moving(number: int) -> Surface:
    """Panel 0 from `START_M` on, panel 1 from `OTHER_M` on the other way."""
    if number == 0:
        return panel(VELOCITY_M_PER_S)
    end = {"at_s": 2.0, "centre_m": tuple(OTHER_M - 2 * VELOCITY_M_PER_S)}
    return Surface.model_validate({"panel_m": (0.2, 0.2), "centre_m": tuple(OTHER_M), "path": (end,)})


def frames_of(*objects: Surface) -> tuple[list[Moments], np.ndarray]:
    """And their mean moments."""
    made = [frame(light(*objects), number) for number in range(FRAMES)]
    return made, np.array([each.mean_s for each in made])


def test_a_body_is_followed_to_millimetres() -> None:
    frames, moments_s = frames_of(moving(0))
    where_m = START_M + VELOCITY_M_PER_S * moments_s[:, None]
    near_m = np.random.default_rng(0).normal(0, 0.015, (FRAMES, 3))
    found = motion_of(body_at(moments_s[2], where_m[2]), frames, where_m - where_m[2] + near_m)
    off_m = np.diff(found.path_m - where_m, axis=0)
    assert np.sqrt((off_m**2).mean()) < 0.006
    assert np.abs(off_m).max() < 0.012
    assert found.apart_m_per_s < 0.05
    assert found.change.max() < 0.2


def test_of_frames_of_many_points_some_are_enough_wherever_they_lie(monkeypatch: pytest.MonkeyPatch) -> None:
    """A quarter of them: every fourth would be four of sixteen columns."""
    monkeypatch.setattr("nlos.recon.over_time.body_light.MEASURED", 64)
    frames, moments_s = frames_of(moving(0))
    where_m = START_M + VELOCITY_M_PER_S * moments_s[:, None]
    body, start_m = body_at(moments_s[2], where_m[2]), where_m - where_m[2]
    seen = BodyLight(body, frames, start_m)
    assert len(np.unique(seen.x_m[:64])) > 12
    off_m = np.diff(motion_of(body, frames, start_m).path_m - where_m, axis=0)
    assert np.sqrt((off_m**2).mean()) < 0.01


def test_where_its_picture_is_wrong_ways_between_frames_are_not() -> None:
    """The picture shows it 2 cm aside and 2 cm too near, and half as large."""
    frames, moments_s = frames_of(moving(0))
    where_m = START_M + VELOCITY_M_PER_S * moments_s[:, None]
    body = body_at(moments_s[2], where_m[2] + [0.02, 0.0, -0.02])
    middle_m = body.places_m.mean(axis=0)
    body = replace(body, places_m=middle_m + (body.places_m - middle_m) / 2)
    found = motion_of(body, frames, where_m - where_m[2])
    off_m = np.diff(found.path_m - where_m, axis=0)
    assert np.sqrt((off_m**2).mean()) < 0.007
    assert np.abs(off_m).max() < 0.014


def test_two_that_part_are_told_from_one() -> None:
    frames, moments_s = frames_of(moving(0), moving(1))
    body = body_at(moments_s[2], START_M + VELOCITY_M_PER_S * moments_s[2], OTHER_M - VELOCITY_M_PER_S * moments_s[2])
    found = motion_of(body, frames, np.zeros((FRAMES, 3)))
    assert 0.4 < found.apart_m_per_s / np.linalg.norm(VELOCITY_M_PER_S) < 1.2


def test_what_vanishes_has_changed() -> None:
    still, gone = panel(np.zeros(3)), panel(np.zeros(3)).model_copy(update={"vanishes_s": 0.25})
    frames, moments_s = frames_of(still)
    found = motion_of(body_at(moments_s[1], START_M), frames, np.zeros((FRAMES, 3)))
    assert found.change.max() < 0.15
    frames, moments_s = frames_of(gone)
    found = motion_of(body_at(moments_s[1], START_M), frames, np.zeros((FRAMES, 3)))
    assert found.change[:2].min() > 0.8


def test_nothing_seen_is_no_body() -> None:
    albedo, depth_m = shown(START_M)
    assert body_of(0 * albedo, depth_m, WALL, 0.0) is None
    assert body_of(albedo, np.full_like(depth_m, np.nan), WALL, 0.0) is None


def test_without_photons_it_stays_where_it_was_looked_for() -> None:
    frames, moments_s = frames_of(moving(0))
    dark = [replace(each, counts=0 * each.counts) for each in frames]
    start_m = VELOCITY_M_PER_S * (moments_s - moments_s[2])[:, None]
    found = motion_of(body_at(moments_s[2], START_M), dark, start_m)
    assert found.path_m == pytest.approx(start_m, abs=1e-3)
    assert np.isfinite(found.change).all()
