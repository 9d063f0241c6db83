"""A film on the live page: each picture is of the newest visit to every point, one is due with every frame."""

import base64
import json
import time
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.newest_visits import NewestVisits
from nlos.chain import arrivals_of, calibrate_scan
from nlos.film_memory import FilmMemory
from nlos.live.film import LiveFilm
from nlos.live.frames import Frames
from nlos.live.gathered import nothing_yet
from nlos.live.pace import Pace
from nlos.live.page import LivePage
from nlos.live.scan import LiveScan
from nlos.live.schedule import Schedule
from nlos.live.steps import film_frames
from nlos.live.web import Request
from nlos.loaded import load_scan, loaded_frames
from nlos.recon.live import LiveReconstruction
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.reconstruct import reconstruct
from nlos.recon.seen import brightest
from nlos.response import AUTO
from tests.nlos.bench_films import filmed

FRAMES, PARTS = 6, 2
WORDS = {
    "wall": {"width_m": 1.0, "height_m": 1.0, "rows": 8, "cols": 8},
    "pattern": "serpentine",
    "dwell_ms": 4,
    "histogram": {"bins": 512, "bin_width_ps": 32, "offset_ns": 10},
    "frames": FRAMES,
    "interleave": PARTS,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of half of 8 x 8 points of the shipped bench with something that moves."""
    return filmed(tmp_path_factory.mktemp("live") / "run.h5", WORDS)


def test_newest_visits_are_the_sum_of_the_last_cycle(run: Path) -> None:
    with Recording.open(run) as recording:
        newest, samples = NewestVisits(recording.plan), list(recording.samples())
        each = len(samples) // FRAMES
        for number, sample in enumerate(samples, 1):
            assert newest.add(sample)
            assert not newest.add(sample)
            if number in (each, 3 * each, len(samples)):
                last = number // each
                wanted = recording.transient(range(max(last - PARTS, 0), last))
                held = newest.transient()
                assert np.array_equal(held.counts, wanted.counts)
                assert held.exposure_s == pytest.approx(wanted.exposure_s)
        assert len(newest) == len(samples)


@pytest.mark.parametrize("adds_up", [False, True])
def test_the_viewer_shows_the_newest_frames_of_a_film_and_a_follower_the_sum(run: Path, adds_up: bool) -> None:
    """`reconstruct --follow` ends with what `reconstruct` makes of the recording."""
    live = LiveScan(run, [LiveReconstruction("lct")], constants=Path("none"), adds_up=adds_up)
    live.start()
    try:
        live.wait()
        assert live.picture is not None
        assert live.picture.samples == FRAMES * 32
        shown, whole = live.picture.reconstruction.albedo, reconstruct(calibrate_scan(load_scan(run)), "lct").albedo
        if adds_up:
            assert np.array_equal(shown, whole)
            return
        assert not np.array_equal(shown, whole)
        assert live.picture.reconstruction.explained is not None  # of the last one there is time to look
        assert live.gathered is not None
        assert live.gathered.film is not None
        assert live.gathered.film.shown_frame == FRAMES - 1
    finally:
        live.stop(30)


def test_the_light_of_a_frame_is_that_of_the_film_made_afterwards(run: Path) -> None:
    """Aligned alike, whatever was there before it."""
    whole = load_scan(run)
    with Recording.open(run) as recording:
        live, arrivals = LiveFilm(recording.plan, None, AUTO), arrivals_of(whole)
        remembered, memory = FilmMemory(recording, calibrate_scan(whole, False, None, arrivals)), None
        samples = list(recording.samples())
        each = len(samples) // FRAMES
        for frame in range(FRAMES):
            for sample in samples[frame * each : (frame + 1) * each]:
                live.add(sample)
            alone = loaded_frames(recording, range(frame, frame + 1))
            moments = remembered.moments(frame, calibrate_scan(alone, False, None, arrivals))
            memory = memory or LightMemory(moments.wall, moments.time)
            wanted = memory.add(moments)
            known = live.calibrated(False, lambda: whole)
            assert known.samples == (frame + 1) * each
            assert known.transient.time == wanted.time
            # Sums in another order round otherwise, and what is registered with a hair's difference counts with one.
            shown, made = (each.counts[:368].reshape(23, 16, 8, 8).sum(axis=1) for each in (known.transient, wanted))
            assert np.linalg.norm(shown - made) < 0.02 * np.linalg.norm(made)
            assert known.transient.exposure_s == pytest.approx(wanted.exposure_s, rel=0.02)
            assert frame or np.array_equal(known.transient.counts, wanted.counts)


@pytest.mark.parametrize("waiting", [1, 2, 3])
def test_frames_wait_for_a_core_up_to_two_and_of_more_only_the_newest_has_a_picture(run: Path, waiting: int) -> None:
    whole = load_scan(run)
    with Recording.open(run) as recording:
        live, samples = LiveFilm(recording.plan, None, AUTO), list(recording.samples())
    each, first = len(samples) // FRAMES, PARTS
    for frame in range(first + waiting):
        for sample in samples[frame * each : (frame + 1) * each]:
            live.add(sample)
        if frame == first - 1:  # the first whole scan has its picture; then all cores are taken
            assert live.calibrated(False, lambda: whole).frame[0] == frame
            live.shown(reconstruct(calibrate_scan(whole), "lct"), live.newest)
        elif frame >= first:
            live.watch(lambda: whole, 0)
    wanted = [first, first + 1][:waiting] if waiting < 3 else [first + 2]
    for frame in wanted:
        known = live.calibrated(False, lambda: whole)
        assert (known.frame[0], known.samples) == (frame, (frame + 1) * each)
        live.shown(reconstruct(calibrate_scan(whole), "lct"), known.frame)
    assert not live.waiting
    assert live.dropped == (2 if waiting == 3 else 0)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("cores", [1, 2])
def test_every_frame_in_passing_is_shown_as_it_would_be_alone(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cores: int
) -> None:
    """On one core, and by several pictures at a time on two."""
    monkeypatch.setattr("nlos.live.scan.threads", lambda: cores)
    grows, shown, wanted = tmp_path / "grows.h5", {}, {}
    with Recording.open(run) as recording:
        samples, each = list(recording.samples()), len(recording) // FRAMES
        held = nothing_yet(recording, Path("none"), AUTO, False, print)
        writer = RecordingWriter.create(grows, recording.plan, recording.header)
    alone, live = LiveReconstruction("lct"), LiveScan(grows, [LiveReconstruction("lct")], constants=Path("none"))
    live.start()
    for frame in range(FRAMES):
        for sample in samples[frame * each : (frame + 1) * each]:
            writer.write(sample)
            held.add(sample)
        writer.flush()
        if frame < PARTS - 1 or frame == FRAMES - 1:
            continue  # before the first whole scan, and the last one, which knows that no more will come
        known = held.calibrated(False)
        assert known.of_film is not None
        wanted[frame] = alone.of_film(known.of_film, known.samples, known.falloff)
        deadline_s = time.monotonic() + 240
        while not (live.latest and live.latest["lct"].samples == known.samples):
            assert time.monotonic() < deadline_s
            time.sleep(0.01)
        shown[frame] = live.latest["lct"]
    writer.finish(Status.COMPLETE)
    live.wait()
    live.stop(30)
    assert live.gathered is not None
    assert live.gathered.film is not None
    assert (live.gathered.film.dropped, live.pictures) == (0, FRAMES - PARTS + 1)
    for frame, picture in shown.items():
        assert np.array_equal(picture.reconstruction.albedo, wanted[frame].reconstruction.albedo)
        assert np.array_equal(picture.reconstruction.depth_m, wanted[frame].reconstruction.depth_m, equal_nan=True)
        assert np.array_equal(picture.confidence, wanted[frame].confidence)
        assert (picture.change, picture.reconstruction.scan) == (wanted[frame].change, "grows.h5")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_fault_of_ours_in_a_picture_made_aside_is_told_and_ends_the_pictures(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nlos.live.scan.threads", lambda: 2)
    monkeypatch.setattr(LiveReconstruction, "made_of_film", lambda *given: 1 // 0)
    grows = tmp_path / "grows.h5"
    with Recording.open(run) as recording:
        samples = list(recording.samples())
        writer = RecordingWriter.create(grows, recording.plan, recording.header)
    live = LiveScan(grows, [LiveReconstruction("lct")], constants=Path("none"))
    live.start()
    for sample in samples[:-1]:
        writer.write(sample)
    writer.flush()
    deadline_s = time.monotonic() + 240
    while not live.broke_off:
        assert time.monotonic() < deadline_s
        time.sleep(0.01)
    writer.finish(Status.INTERRUPTED)
    live.stop(30)
    assert "because of a bug" in live.message


def test_a_picture_in_a_hurry_is_not_refined_and_what_was_asked_for_is_kept(run: Path) -> None:
    light = HalfGrid(load_scan(run).transient, load_scan(run).transient.wall)
    live = LiveReconstruction("nano")
    usual, hurried = (live.made_of_film(light, hurried=each).settings for each in (False, True))
    assert (usual["symmetries"], usual["refine"]) == (False, True)
    assert hurried == usual | {"refine": False, "from_first_light": True}
    assert LiveReconstruction("nano", {"symmetries": True, "refine": True}).made_of_film(
        light, hurried=True
    ).settings == (usual | {"symmetries": True})


def test_who_has_all_pictures_of_a_growing_film_waits_for_the_next(run: Path, tmp_path: Path) -> None:
    """But not a stranger, nor anybody once the film is over."""
    grows, host = tmp_path / "grows.h5", "127.0.0.1:1"

    def asks(made: int | str, token: str = "token", what: str = "state") -> bool:
        return page.nothing_new(Request(f"/{token}/{what}", {"made": str(made)}, host))

    with Recording.open(run) as recording:
        plan, header, samples = recording.plan, recording.header, list(recording.samples())
    with RecordingWriter.create(grows, plan, header) as writer:
        for sample in samples[: len(samples) // 2]:
            writer.write(sample)
        writer.flush()
        live = LiveScan(grows, [LiveReconstruction("lct")], constants=Path("none"))
        page = LivePage([live], "token", {host})
        live.start()
        deadline_s = time.monotonic() + 240
        while not (live.latest and live.latest["lct"].samples == len(samples) // 2 and asks(live.pictures)):
            assert time.monotonic() < deadline_s  # two frames may wait for their pictures when it is opened
            time.sleep(0.02)
        assert not asks(live.pictures - 1)
        assert not asks(live.pictures, token="other")
        assert not asks(live.pictures, what="picture")
        assert not page.nothing_new(Request("/token/state", {}, host))
        for sample in samples[len(samples) // 2 :]:
            writer.write(sample)
    live.wait()
    assert not asks(live.pictures)
    live.stop(30)


def made_along(run: Path, steps: int) -> Frames:
    """What the slider of a finished scan shows, once all of it is made."""
    live = LiveScan(run, [LiveReconstruction("lct")], constants=Path("none"))
    live.start()
    live.wait()
    frames = Frames(live)
    try:
        frames.start()
        deadline_s = time.monotonic() + 240
        while frames.version < steps:
            assert time.monotonic() < deadline_s
            time.sleep(0.02)
    finally:
        frames.stop(30)
        live.stop(30)
    return frames


def test_a_finished_films_slider_shows_every_frame_with_its_memory(run: Path) -> None:
    """Of the light of each frame of the recording, whatever was dropped while it was live; at its own moment."""
    frames = made_along(run, FRAMES)
    assert frames.samples == [32 * (frame + 1) for frame in range(FRAMES)]
    assert [(shown or {})["of_film"]["frame"] for shown in frames.pictures] == list(range(FRAMES))
    assert all("of the light" in (shown or {})["explained"] for shown in frames.pictures)
    moments_s = [(shown or {})["of_film"]["time_s"] for shown in frames.pictures]
    whole = load_scan(run)
    with Recording.open(run) as recording:
        arrivals, records = arrivals_of(whole), recording.intact_records()
        remembered, memory = FilmMemory(recording, calibrate_scan(whole, False, None, arrivals)), None
        for frame in range(FRAMES):
            taken = records[recording.plan.pass_[records["number"]] == frame]
            assert taken["taken_s"].min() < moments_s[frame] < taken["taken_s"].max()
            alone = loaded_frames(recording, range(frame, frame + 1))
            moments = remembered.moments(frame, calibrate_scan(alone, False, None, arrivals))
            memory = memory or LightMemory(moments.wall, moments.time)
            light = HalfGrid(memory.add(moments), recording.plan.wall)
            wanted = LiveReconstruction("lct").of_film(light, 1, whole.falloff)
            packed = (frames.pictures[frame] or {})["albedo"]
            shown = np.frombuffer(base64.b64decode(packed["f4"]), dtype="<f4")
            made = wanted.reconstruction.albedo / brightest(wanted.reconstruction)
            assert np.linalg.norm(shown - made.ravel()) < 0.02 * np.linalg.norm(made)
            rates = (frames.rates[frame] or {})["samples"]
            assert rates == 32 * (frame + 1)


def test_a_step_of_a_long_film_remembers_the_frames_between_the_steps(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    every = made_along(run, FRAMES)
    monkeypatch.setattr("nlos.live.steps.MOST_OF_FILM", 2)
    some = made_along(run, 2)
    assert some.samples == [every.samples[2], every.samples[5]]
    for mine, other in ((0, 2), (1, 5)):
        assert (some.pictures[mine] or {})["albedo"] == (every.pictures[other] or {})["albedo"]


def test_of_a_long_film_some_frames_are_shown_and_the_last_is_one_of_them() -> None:
    assert film_frames(6) == list(range(6))
    some = film_frames(10_000)
    assert (len(some), some[0], some[-1]) == (100, 99, 9_999)
    assert set(np.diff(some)) == {100}
    assert film_frames(101)[-1] == 100


def test_frames_that_wait_for_too_long_are_dropped_and_late_points_are_too_late(run: Path) -> None:
    with Recording.open(run) as recording:
        live, samples = LiveFilm(recording.plan, None, AUTO), list(recording.samples())
        each = len(samples) // FRAMES
        for sample in (*samples[: each - 1], *samples[each : 2 * each], samples[each - 1]):
            live.add(sample)
        assert live.samples == 2 * each - 1  # the first frame was over when the second began
        live.finish()
        assert live.samples == 2 * each
        assert live.calibrated(True, lambda: load_scan(run)).samples == 2 * each
        light = HalfGrid(load_scan(run).transient, recording.plan.wall)
        picture = LiveReconstruction("lct").of_film(light, 1).reconstruction
        assert live.shown(picture, live.newest) == 0
        assert (live.shown_frame, live.dropped) == (1, 0)
        for sample in samples[2 * each : 5 * each]:
            live.add(sample)
        assert live.calibrated(False, lambda: load_scan(run)).samples == 5 * each
        assert live.shown(picture, live.newest) == 2
        assert (live.shown_frame, live.dropped) == (4, 2)


def test_a_picture_is_due_with_every_frame_and_those_dropped_are_counted() -> None:
    words = WORDS | {"frames": 1000, "interleave": 1}
    plan = ScanSettings.model_validate_json(json.dumps(words)).plan()
    schedule = Schedule(["lct"], 0.05)
    schedule.follow_frames(plan)
    planned = len(plan)
    for _ in range(planned):
        schedule.pace.saw(0.0)
    assert schedule.due(63, planned, True, False) is None
    schedule.made("lct", 64, planned, 0.0, True)
    assert schedule.skipped == 0
    schedule.made("lct", 64 * 5, planned, 0.0, True)
    assert schedule.skipped == 3
    schedule.made("lct", planned - 128, planned, 60.0, True)  # however long pictures take
    assert schedule.due(planned - 64, planned, True, False) == "lct"


def test_thousands_of_samples_a_second_are_counted_in_few_entries() -> None:
    pace = Pace()
    for sample in range(10_000):
        pace.saw(sample * 0.4e-3)
    assert len(pace._came) <= Pace.OVER_S / Pace.TOGETHER_S + 1
    assert pace.left_s(2500, 4.0) == pytest.approx(1.0, rel=0.02)
    assert pace.left_s(1, 4.0 + 1.9) > 1e-3
    assert pace.left_s(1, 7.0) == float("inf")
