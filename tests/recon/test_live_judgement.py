"""How far a picture of a scan under way can be trusted: what it is compared with, and what it says of itself."""

import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon import live as live_module
from nlos.recon.live import LiveReconstruction, relative_change

WALL, TIME = WallGrid(0.8, 0.8, 8, 8), TimeAxis(48, 150e-12)


def light(seed: int, exposure_s: np.ndarray | None = None, counts: float = 3.0) -> Transient:
    drawn = np.random.default_rng(seed).poisson(counts, (48, 8, 8)).astype(np.float32)
    exposed = np.ones((8, 8)) if exposure_s is None else exposure_s
    return Transient(drawn * (exposed > 0), exposed, WALL, TIME)


def test_a_picture_is_compared_with_the_newest_of_a_fifth_fewer_samples() -> None:
    live, samples = LiveReconstruction("lct"), (40, 44, 50, 55, 60, 100)
    made = [live.update(light(count), count) for count in samples]
    views = {count: picture.reconstruction.albedo for count, picture in zip(samples, made, strict=True)}
    found = {count: picture.change for count, picture in zip(samples, made, strict=True)}
    with_which = {50: 40, 55: 44, 60: 44, 100: 60}
    assert [found[count] for count in (40, 44)] == [1.0, 1.0]
    for count, before in with_which.items():
        assert found[count] == pytest.approx(relative_change(views[before], views[count])), count
    assert live.anew().update(light(100), 100).change == 1.0


def test_a_change_is_what_no_scale_explains() -> None:
    one, other = np.eye(4, dtype=np.float32), np.eye(4, dtype=np.float32)[::-1].copy()
    assert relative_change(one, 7 * one) == pytest.approx(0.0, abs=1e-6)
    assert relative_change(one, other) == pytest.approx(1.0)
    assert relative_change(one, one + other) == pytest.approx(np.sqrt(0.5))
    assert relative_change(np.zeros_like(one), one) == pytest.approx(1.0)
    assert relative_change(one, np.zeros_like(one)) == 1.0
    assert relative_change(np.zeros_like(one), np.zeros_like(one)) == 0.0


def test_an_error_is_that_of_the_photons_of_each_bright_pixel() -> None:
    transient = light(1)
    picture = LiveReconstruction("lct").update(transient, 64)
    albedo = picture.reconstruction.albedo
    photons_each = transient.counts.sum() / np.count_nonzero(albedo > 0.1 * albedo.max())
    assert picture.error == pytest.approx(1 / np.sqrt(photons_each))
    assert picture.confidence == pytest.approx(1 / (1 + picture.error))
    assert LiveReconstruction("lct").update(light(1, counts=300.0), 64).error < picture.error / 5


def test_confidence_falls_with_the_distance_to_what_was_measured_and_with_what_moved() -> None:
    exposure_s = np.zeros((8, 8))
    exposure_s[:, :4] = 1.0
    live = LiveReconstruction("lct")
    first = live.update(light(2, exposure_s), 32)
    assert first.confidence[0] * (1 + first.error) == pytest.approx([*[1.0] * 4, *np.exp([-0.25, -0.5, -0.75, -1.0])])
    moved = live.update(light(3, exposure_s), 64)
    assert (moved.confidence <= first.confidence.max() + 1e-6).all()
    assert moved.confidence[:, :4].min() < 0.9 * moved.confidence[:, :4].max()


def test_what_a_picture_was_sure_of_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    bounds = [None, 0.3, 0.5, 0.2]
    monkeypatch.setattr(live_module, "error_bound", lambda made: bounds.pop(0))
    live = LiveReconstruction("lct")
    assert [live.update(light(5), count).bound for count in (10, 20, 30, 40)] == [None, 0.3, 0.3, 0.2]


@pytest.mark.parametrize(("given", "falloff"), [({}, 2), ({"falloff": 4}, 4)])
def test_a_files_falloff_counts_unless_another_is_given(given: dict[str, object], falloff: int) -> None:
    made = LiveReconstruction("lct", given).update(light(4), 64, falloff=2).reconstruction
    assert made.settings["falloff"] == falloff
