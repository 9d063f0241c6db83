"""The network for films: nothing until it has learned, nearer to the truth on films of shapes that nobody learned from,
and without a trace of what is gone."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nlos.acquisition.wall import WallGrid
from nlos.recon.film_network import MOST_GAP, FilmFinish, takes
from nlos.recon.layers.film_network import FilmNetwork
from nlos.recon.live import LiveReconstruction
from nlos.recon.metrics import image_scores
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.training import video_set
from nlos.recon.training.films import FRAME_S, TIME, WALL, TrainingFilm
from nlos.recon.training.video_fit import judge
from nlos.recon.training.video_set import SEEDS, TEST, all_held, hold
from nlos.recon.volume import FINISHED, Reconstruction

FRAMES = 7


def frames_of(film: TrainingFilm, count: int = FRAMES) -> list[tuple[HalfGrid, np.ndarray]]:
    """What the memory makes of each frame, and the truth's brightness."""
    memory, made = LightMemory(WALL, TIME), []
    for number in range(count):
        frame = film.frame(number)
        memory.watch(frame)
        made.append((memory.on_half_grid(), film.truth(frame.mean_s).intensity))
    return made


def shown(frames: list[HalfGrid], finish: bool) -> list[Reconstruction]:
    """As `nlos live` shows them, one after the other."""
    live = LiveReconstruction("nano", {} if finish else {"refine": False}, finish=finish)
    return [live.of_film(seen, number).reconstruction for number, seen in enumerate(frames)]


@pytest.fixture(scope="module")
def film() -> list[tuple[HalfGrid, np.ndarray]]:
    """Of a shape that neither NANO nor the network ever saw."""
    return frames_of(TrainingFilm(SEEDS[TEST], 101, FRAMES, held_out=True))


def test_before_it_learns_it_leaves_pictures_as_they_are(film: list[tuple[HalfGrid, np.ndarray]]) -> None:
    finish, live = FilmFinish(FilmNetwork()), LiveReconstruction("nano", {"refine": False}, finish=False)
    for seen, _ in film[:3]:
        assert seen.given is not None
        picture = seen.enlarged(live.made_of_film(seen))
        made = finish(seen.given, picture, None)
        np.testing.assert_allclose(made.albedo, picture.albedo, atol=1e-6)
        known = np.isfinite(picture.depth_m) & np.isfinite(made.depth_m)
        assert known.mean() > 0.05
        np.testing.assert_allclose(made.depth_m[known], picture.depth_m[known], atol=1e-5)


def test_pictures_of_films_are_nearer_to_the_truth() -> None:
    def scores(frames: list[tuple[HalfGrid, np.ndarray]], finish: bool) -> list[float]:
        pictures = shown([seen for seen, _ in frames], finish)
        some = zip(pictures[2:], [truth for _, truth in frames][2:], strict=True)
        return [image_scores(picture.albedo, truth)["psnr"] for picture, truth in some]

    films = [frames_of(TrainingFilm(SEEDS[TEST], index, FRAMES, held_out=True)) for index in (0, 1, 2)]
    gained = [np.subtract(scores(each, True), scores(each, False)).mean() for each in films]
    assert np.mean(gained) > 0.1, gained


def test_a_film_again_is_the_same_and_what_follows_a_gap_begins_anew(
    film: list[tuple[HalfGrid, np.ndarray]],
) -> None:
    frames = [seen for seen, _ in film]
    first = shown(frames, True)
    again = shown(frames, True)
    assert all(np.array_equal(one.albedo, other.albedo) for one, other in zip(first, again, strict=True))
    live = LiveReconstruction("nano")
    live.of_film(frames[0], 0)
    late = live.of_film(frames[MOST_GAP + 1], 1).reconstruction
    alone = LiveReconstruction("nano").of_film(frames[MOST_GAP + 1], 0).reconstruction
    assert np.array_equal(late.albedo, alone.albedo)
    assert not np.array_equal(late.albedo, first[MOST_GAP + 1].albedo)
    for number in (MOST_GAP, MOST_GAP):  # shown twice, as the last frame of a film may be
        assert not np.array_equal(live.of_film(frames[number], 2).reconstruction.albedo, first[number].albedo)
    twice = LiveReconstruction("nano")
    kept = [twice.of_film(frames[number], number).reconstruction.albedo for number in (0, 1, 1)]
    assert np.array_equal(kept[1], kept[2])


def test_other_grids_and_other_frames_are_left_as_they_are(film: list[tuple[HalfGrid, np.ndarray]]) -> None:
    seen = film[0][0]
    assert seen.given is not None
    assert takes(seen)
    assert not takes(replace(seen, given=None))
    assert not takes(replace(seen, given=replace(seen.given, points=4096)))
    assert not takes(replace(seen, wall=WallGrid(2.0, 2.0, 32, 32)))
    assert not takes(replace(seen, wall=WallGrid(2.0, 1.0, 64, 64)))
    live = LiveReconstruction("nano")
    whole = replace(seen, given=replace(seen.given, points=4096))
    made = live.of_film(whole, 0).reconstruction
    assert FINISHED not in made.settings
    assert made.settings["refine"]
    assert np.array_equal(made.albedo, whole.enlarged(live.made_of_film(whole)).albedo)
    assert not LiveReconstruction("lct").finishes(seen)
    assert live.of_film(seen, 1).reconstruction.settings[FINISHED]


def test_of_what_has_vanished_nothing_is_left_after_two_frames() -> None:
    still = TrainingFilm(SEEDS[TEST], 103, FRAMES, held_out=True)
    one, other = (TrainingFilm(SEEDS[TEST], index, FRAMES, held_out=True).bodies[0] for index in (104, 105))
    aside = [np.array([[x_m, 0.0, 0.9]]) for x_m in (-0.5, 0.5)]
    rests = [
        replace(body, at_s=np.zeros(1), centre_m=centre, turned_rad=np.zeros((1, 3)), there_s=(-1.0, until_s))
        for body, centre, until_s in zip((one, other), aside, (np.inf, 4 * FRAME_S), strict=True)
    ]
    still.bodies = rests
    frames = frames_of(still)
    pictures = shown([seen for seen, _ in frames], True)
    right = [picture.albedo[:, 40:].sum() for picture in pictures]
    assert right[3] > 0.2 * pictures[3].albedo.sum()
    assert right[6] < 0.1 * right[3]


def test_what_it_learns_from_is_what_it_is_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_set, "FRAMES", 3)
    monkeypatch.setattr("nlos.recon.training.video_fit.COMPARED", (2,))
    hold(TEST, 101, tmp_path)
    (held,) = all_held(TEST, tmp_path)
    frames = frames_of(TrainingFilm(SEEDS[TEST], 101, 3, held_out=True), 3)
    pictures = shown([seen for seen, _ in frames], False)
    for number, (picture, (_, truth)) in enumerate(zip(pictures, frames, strict=True)):
        np.testing.assert_allclose(held.albedo[number].float(), picture.albedo, atol=1e-3)
        np.testing.assert_allclose(held.intensity[number].float(), truth, atol=1e-3)
    assert judge(FilmNetwork().eval(), [held])["psnr"][0] == pytest.approx(
        image_scores(pictures[2].albedo, frames[2][1])["psnr"], abs=0.05
    )
    assert torch.isnan(held.frame_by_frame).all()
