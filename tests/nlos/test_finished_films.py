"""A film of 64 x 64 points from the bench to the page: by the network for films, live and as it is replayed, where the
bench's object was."""

import base64
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.recording.recording import Recording
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.film import film_of
from nlos.live.frames import Frames
from nlos.live.scan import LiveScan
from nlos.recipe import Recipe
from nlos.recon.live import LiveReconstruction
from nlos.recon.volume import FINISHED, Reconstruction
from tests.nlos.bench_films import filmed

FRAMES, PARTS, LOOKED_AT = 20, 16, 3
WORDS = {
    "wall": {"width_m": 2.0, "height_m": 2.0, "rows": 64, "cols": 64},
    "pattern": "serpentine",
    "dwell_ms": 0.4,
    "histogram": {"bins": 512, "bin_width_ps": 32, "offset_ns": 10},
    "frames": FRAMES,
    "interleave": PARTS,
}
AIM_M, DEPTH_M = 0.06, 0.06
"""A tenth of the letter's height and more: its light is not even, and its surfaces are turned."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return filmed(tmp_path_factory.mktemp("film") / "run.h5", WORDS)


def letters_way() -> tuple[npt.NDArray[np.float64], list[float]]:
    """Where the bench's letter is (K, 3), and when."""
    (letter,) = load("bench", "moving", BenchSettings).settings.simulation.scene.objects
    path_m = np.array([letter.centre_m, *(each.centre_m for each in letter.path)])
    return path_m, [0.0, *(each.at_s for each in letter.path)]


def replayed(run: Path, finish: bool) -> tuple[list[npt.NDArray[np.float32]], list[float], Reconstruction]:
    """What a finished film's slider shows of its last frames, their moments, and what was shown live at its end."""
    live = LiveScan(run, [LiveReconstruction("nano", finish=finish)], constants=Path("none"))
    live.start()
    try:
        live.wait()
        assert live.picture is not None
        frames = Frames(live)
        frames.start()
        assert frames._thread is not None
        frames._thread.join(300)
        shown = [picture for picture in frames.pictures if picture is not None]
        assert len(shown) == FRAMES
        albedo = [np.frombuffer(base64.b64decode(each["albedo"]["f4"]), "<f4").reshape(64, 64) for each in shown]
        return albedo, [each["of_film"]["time_s"] for each in shown], live.picture.reconstruction
    finally:
        live.stop(60)


def test_a_films_pictures_are_finished_live_and_in_replay_and_lie_where_the_object_was(run: Path) -> None:
    shown, moments_s, last = replayed(run, True)
    plain, _, unfinished = replayed(run, False)
    assert last.settings[FINISHED]
    assert FINISHED not in unfinished.settings
    assert not any(np.array_equal(one, other) for one, other in zip(shown, plain, strict=True))
    live = last.albedo / np.percentile(last.albedo, 99.9)
    replay = shown[-1] / np.percentile(shown[-1], 99.9)
    assert np.corrcoef(live.ravel(), replay.ravel())[0, 1] > 0.97  # the memory began at another frame
    path_m, at_s = letters_way()
    with Recording.open(run) as recording:
        wall = recording.plan.wall
    for picture, moment_s in zip(shown[-LOOKED_AT:], moments_s[-LOOKED_AT:], strict=True):
        weight = np.where(picture > 0.3, picture, 0.0)
        found_m = np.array([(weight.sum(axis=0) @ wall.x_m()), (weight.sum(axis=1) @ wall.y_m())]) / weight.sum()
        true_m = [np.interp(moment_s, at_s, path_m[:, axis]) for axis in (0, 1)]
        np.testing.assert_allclose(found_m, true_m, atol=AIM_M)
    depth_m = float(np.nanmedian(last.depth_m[last.albedo > 0.3 * last.albedo.max()]))
    assert depth_m == pytest.approx(np.interp(moments_s[-1], at_s, path_m[:, 2]), abs=DEPTH_M)


def test_with_a_memory_frames_of_other_points_have_one_time_axis(run: Path) -> None:
    """Points lie at other distances in every frame of an interleaved film, and have as many bins behind them."""
    film = film_of(run, Recipe("nano", {"symmetries": False}, constants=Path("none")), memory=True)
    assert film.albedo.shape == (FRAMES, 64, 64)
    path_m, at_s = letters_way()
    found = film.track()
    for axis, column in enumerate(("x_m", "y_m", "z_m")):
        off_m = np.abs(found[column] - np.interp(film.time_s, at_s, path_m[:, axis]))[-LOOKED_AT:]
        assert off_m.max() < AIM_M, column
