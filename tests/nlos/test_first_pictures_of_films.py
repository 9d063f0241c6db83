"""The first picture of a film waits for nothing that could have been done before: it is as quick as those after it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.sample import Sample
from nlos.calibration.errors import NoDirectPeak
from nlos.chain import arrivals_of
from nlos.live.film_pictures import FilmPictures
from nlos.live.gathered import Gathered, nothing_yet
from nlos.loaded import LoadedScan, load_scan
from nlos.recon.live import LivePicture, LiveReconstruction
from nlos.recon.with_torch import built
from nlos.response import AUTO
from tests.nlos.bench_films import filmed

FRAMES, PARTS = 8, 4
WORDS = {
    "wall": {"width_m": 1.0, "height_m": 1.0, "rows": 16, "cols": 16},
    "pattern": "serpentine",
    "dwell_ms": 4,
    "histogram": {"bins": 512, "bin_width_ps": 32, "offset_ns": 10},
    "frames": FRAMES,
    "interleave": PARTS,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two whole scans of 16 x 16 points of something that moves, a quarter of them a frame."""
    return filmed(tmp_path_factory.mktemp("first") / "run.h5", WORDS)


@pytest.fixture
def growing(run: Path) -> tuple[Gathered, list[list[Sample]]]:
    """What a viewer holds before the first sample, and the samples of each frame."""
    with Recording.open(run) as recording:
        held, samples = nothing_yet(recording, Path("none"), AUTO, False, print), list(recording.samples())
    each = len(samples) // FRAMES
    return held, [samples[frame * each : (frame + 1) * each] for frame in range(FRAMES)]


def begun(pictures: FilmPictures, held: Gathered, lives: list[LiveReconstruction]) -> list[LivePicture]:
    """The pictures of the newest frame, in the order in which they are shown."""
    shown: list[LivePicture] = []
    known = held.calibrated(False)
    for live in lives:
        pictures.begin(live, known, 0.1, shown.append, lambda error: pytest.fail(str(error)))
        pictures.finish()
    return shown


def test_the_first_picture_of_a_film_builds_nothing_and_aligns_nothing(
    growing: tuple[Gathered, list[list[Sample]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    held, frames = growing
    assert held.film is not None
    lives = [LiveReconstruction("lct"), LiveReconstruction("nano")]
    made: list[str] = []
    plain = LiveReconstruction.made_of_film
    monkeypatch.setattr(
        LiveReconstruction, "made_of_film", lambda live, *given: made.append(live.method) or plain(live, *given)
    )
    pictures = FilmPictures(held.film, lives, 2, held.so_far)
    for frame in frames[:PARTS]:
        for sample in frame:
            held.add(sample)
        pictures.watch()
    pictures.finish()
    pictures.watch()  # the newest frame has waited for a core
    assert sorted(set(made)) == ["lct", "nano"]  # before there is a whole scan
    assert made.count("nano") == 2 * 2  # both kinds on both cores
    assert not held.film.waiting
    before, aligned = built.cache_info().misses, held.film._alignment
    assert aligned is not None
    made.clear()
    first = begun(pictures, held, lives)
    assert (built.cache_info().misses, held.film._alignment) == (before, aligned)
    assert made == ["lct", "nano"]  # and no further rehearsal
    pictures.watch()
    pictures.finish()
    assert made == ["lct", "nano"]
    pictures.stop()

    known = held.calibrated(False)
    assert known.of_film is not None
    for picture, live in zip(first, lives, strict=True):  # what was rehearsed leaves no trace
        other, hurried = live.anew(), live is lives[-1]  # as films begin
        made_alone = other.made_of_film(known.of_film, known.falloff, hurried)
        alone = other.judged_of_film(known.of_film, made_alone, known.samples)
        np.testing.assert_array_equal(picture.reconstruction.albedo, alone.reconstruction.albedo)
        assert picture.change == 1.0


def test_a_film_is_aligned_before_its_first_whole_scan_is_over_as_the_whole_film_would_be(
    run: Path, growing: tuple[Gathered, list[list[Sample]]]
) -> None:
    held, frames = growing
    film, wanted = held.film, arrivals_of(load_scan(run))
    assert film is not None
    assert wanted is not None
    for number, frame in enumerate(frames[: PARTS - 1], 1):
        assert not film.can_be_aligned
        for sample in frame:
            held.add(sample)
        assert film.share_of_whole_scan == pytest.approx(number / PARTS)
    assert film.can_be_aligned
    held.calibrated(False)
    assert film._alignment is not None
    arrivals = film._alignment.direct.offset_bins
    assert np.isfinite(arrivals).all()  # of the last quarter's points too
    assert np.abs(arrivals - wanted.offset_bins).max() < 0.5


def test_a_look_at_what_has_come_of_a_film_changes_nothing_of_it(
    growing: tuple[Gathered, list[list[Sample]]],
) -> None:
    held, frames = growing
    film = held.film
    assert film is not None
    for sample in frames[0][:-8]:
        held.add(sample)
    now = film.by_now()
    assert now.calibrated(False, held.so_far).frame[0] == 0
    assert (film.over, film.waiting, film.samples, film._alignment) == (-1, False, 0, None)
    for sample in frames[0][-8:]:
        held.add(sample)
    assert (film.over, film.waiting, film.samples) == (0, True, len(frames[0]))


def test_a_film_that_cannot_be_aligned_is_rehearsed_a_few_times_and_its_first_picture_says_why(
    growing: tuple[Gathered, list[list[Sample]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    held, frames = growing
    assert held.film is not None
    tried: list[int] = []
    whole = held.so_far

    def dark() -> LoadedScan:
        scan = whole()
        tried.append(len(held.samples))
        return replace(scan, transient=replace(scan.transient, counts=np.ones_like(scan.transient.counts)))

    pictures = FilmPictures(held.film, [LiveReconstruction("lct")], 1, dark)
    for sample in (sample for frame in frames[: PARTS - 1] for sample in frame[:-1]):
        held.add(sample)
        pictures.watch()
    assert len(tried) == 4
    held.add(frames[PARTS - 1][0])
    with pytest.raises(NoDirectPeak):
        held.film.calibrated(False, dark)
    pictures.stop()
