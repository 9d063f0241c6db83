"""Films that were not taken in one go: resumed after a while, frames taken again, parts of frames, dark ones. Held
against the path that photons were drawn from."""

import json
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

import nlos
from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording import salvage
from nlos.acquisition.recording.frames import frame_table
from nlos.acquisition.recording.layout import sample_crc
from nlos.acquisition.recording.open_file import open_scan_file
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.replay import replay
from nlos.acquisition.recording.rescue import written_unix_s
from nlos.acquisition.recording.same_scan import ResumeRefused
from nlos.chain import reconstruct_file
from nlos.drivers.clock import VirtualClock
from nlos.drivers.simulated.motion import pose_at
from nlos.drivers.simulated.surfaces import Surface
from nlos.film import film_of
from nlos.live.film import LiveFilm
from nlos.live.gathered import nothing_yet
from nlos.loaded import loaded_frames
from nlos.recipe import Recipe
from nlos.recon.errors import NoLight
from nlos.response import AUTO
from nlos.results_folder import ResultsFolder
from nlos.time_left import TimeLeft
from tests.command import nlos as command
from tests.nlos.bench_films import WORDS, bench_file, filmed_objects, taken_by_hand

LCT = Recipe("lct", constants=Path("none"))
AWAY_S = 20.0
PANEL = {
    "panel_m": (0.2, 0.2),
    "centre_m": (-0.2, 0.1, 0.7),
    "path": [{"at_s": 2.0, "centre_m": (0.3, 0.0, 0.8)}, {"at_s": 40.0, "centre_m": (-0.2, 0.1, 0.7)}],
}
Counts = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bench")
    (folder / "film.yaml").write_text(yaml.safe_dump(WORDS))
    return bench_file(folder / "bench.yaml", PANEL)


def taken(bench: Path, run: Path, samples: int | None = None, resume: bool = False) -> Path:
    taken_by_hand(bench, bench.with_name("film.yaml"), run, samples, resume)
    return run


def watched(run: Path) -> LiveFilm:
    """What a viewer has of the film once all that is written has come."""
    with open_checked(run) as recording:
        live = LiveFilm(recording.plan, None, AUTO)
        for sample in recording.samples():
            live.add(sample)
        live.finish()
        live.watch(lambda: loaded_frames(recording, None))
    return live


def later(monkeypatch: pytest.MonkeyPatch, run: Path) -> None:
    """It is `AWAY_S` after the last that was written there."""
    with Recording.open(run) as recording:
        written_s = written_unix_s(recording)
    assert written_s is not None
    monkeypatch.setattr(salvage, "time", SimpleNamespace(time=lambda: written_s + AWAY_S))


@pytest.fixture(scope="module")
def whole(bench: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return taken(bench, tmp_path_factory.mktemp("whole") / "run.h5")


def changed(run: Path, target: Path, frame: int, change: Counts, damaged: bool = False) -> Path:
    """A copy with other counts in every row of a frame, as if they had been measured so, or `damaged`."""
    shutil.copyfile(run, target)
    file = open_scan_file(target, writable=True)
    with file.handle:
        for row in range(len(file.plan)):
            records, _ = file.records.read(row, row + 1)
            counts, _ = file.counts.read(row, row + 1)
            records, counts = records.copy(), counts.copy()
            if file.plan.pass_[int(records["number"][0])] == frame:
                counts[0] = change(counts[0])
                records["crc"] = 0
                if not damaged:
                    records["crc"] = sample_crc(records[0].tobytes(), counts[0])
                    file.records.write(row, records)
                file.counts.write(row, counts)
    return target


def true_m(time_s: float) -> np.ndarray:
    panel = Surface.model_validate_json(json.dumps(PANEL))
    return np.array(pose_at(time_s, panel.pose, panel.path).centre_m)


def test_a_resumed_film_has_the_time_in_between(bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Points, events, and where what is in the scene has gone meanwhile; the frame in pieces has no picture."""
    run = taken(bench, tmp_path / "run.h5", 4 * 144 + 60)
    with Recording.open(run) as recording:
        before_s = recording.elapsed_s
    later(monkeypatch, run)
    taken(bench, run, resume=True)
    with Recording.open(run) as recording:
        table = frame_table(recording.plan, recording.intact_records())
        taken_s = recording.records["taken_s"]
        events = recording.events()
    assert table.complete == 8
    assert taken_s[4 * 144 + 60] - before_s == pytest.approx(AWAY_S, abs=0.5)
    assert all(one.bench_s <= other.bench_s for one, other in pairwise(events))
    assert [event.kind for event in events].count("resumed") == 1
    film = film_of(run, LCT)
    assert film.frame.tolist() == [0, 1, 2, 3, 5, 6, 7]
    found = film.track()
    off_m = [found["x_m"][k] - true_m(time_s)[0] for k, time_s in enumerate(film.time_s)]
    assert np.abs(off_m).max() < 0.06
    assert np.median(found["vx_m_per_s"][:4]) == pytest.approx(0.25, rel=0.25)  # there, and slowly back
    assert np.abs(found["vx_m_per_s"][4:] - (-0.5 / 38)).max() < 0.1
    assert table.pace_hz == pytest.approx(1 / np.median(np.diff(table.start_s[:4])), rel=0.05)
    clock = VirtualClock()
    with Recording.open(run) as recording:
        live = nothing_yet(recording, Path("none"), AUTO, False, lambda said: None)
        time_left = TimeLeft(recording.plan)
        for sample in replay(recording, 1.0, clock):
            live.add(sample)
            time_left.passed(sample)
        elapsed_s = recording.elapsed_s
    for without_s in (clock.now(), time_left.busy_s):  # nobody waits for the pause again, or is told to
        assert without_s == pytest.approx(elapsed_s - AWAY_S, abs=0.5)
    assert live.elapsed_s == pytest.approx(elapsed_s)


def test_a_frame_taken_again_stands_where_its_time_is(
    bench: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = changed(whole, tmp_path / "run.h5", 3, lambda counts: counts ^ 0x10, damaged=True)
    later(monkeypatch, run)
    taken(bench, run, resume=True)
    for memory in (False, True):
        film = film_of(run, LCT, memory=memory)
        assert film.frame.tolist() == [0, 1, 2, 4, 5, 6, 7, 3]
        assert (np.diff(film.time_s) > 0).all()
        assert film.time_s[-1] - film.time_s[-2] > AWAY_S / 2
        found = film.track()
        assert np.isnan(found["vx_m_per_s"][-1])  # nothing was seen around it
        assert np.median(found["vx_m_per_s"][:5]) == pytest.approx(0.25, rel=0.3)
        assert abs(found["x_m"][-1] - true_m(film.time_s[-1])[0]) < 0.06
    pairs = film_of(run, LCT, window=2)
    assert pairs.frame.tolist() == [1, 2, 5, 6, 7]


@pytest.mark.parametrize("memory", [False, True])
def test_a_frame_without_light_is_dark(
    whole: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture, memory: bool
) -> None:
    run = changed(whole, tmp_path / "run.h5", 2, np.zeros_like)
    film = film_of(run, LCT, memory=memory)
    assert film.frame.tolist() == list(range(8))
    assert np.isfinite(film.albedo).all()
    dark = [k for k in range(8) if not film.albedo[k].any()]
    if memory:
        assert not dark or dark == [2]  # there is the light of others
    else:
        assert dark == [2]
        assert np.isnan(film.depth_m[2]).all()
        assert any("frame 2 shows nothing" in each.getMessage() for each in caplog.records)
    assert np.isfinite(film.track()["vx_m_per_s"][[1, 3]]).all()


def test_a_film_without_any_light_says_so(whole: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def dark(*_: object) -> None:
        raise NoLight("the counts add up to -3")

    monkeypatch.setattr("nlos.film.reconstruct", dark)
    with pytest.raises(NoLight, match="add up to -3"):
        film_of(whole, LCT)


def test_a_part_of_a_frame_is_no_picture(bench: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    run = taken(bench, tmp_path / "run.h5", 5 * 144 + 70)
    film = film_of(run, LCT)
    assert film.frame.tolist() == list(range(5))
    assert any("skipped, with a part of the points only: frames 5" in r.getMessage() for r in caplog.records)
    said = command(tmp_path, "info", "run.h5", check=True).stdout
    with Recording.open(run) as recording:
        table = frame_table(recording.plan, recording.intact_records())
    assert f"5 of 8 complete, {1 / np.median(np.diff(table.start_s[:5])):.3g} a second" in said
    command(tmp_path, "report", "run.h5", check=True)
    assert "a film of 8 frames, 5 of 8 complete" in (tmp_path / "run.html").read_text()
    live = watched(run)
    assert live.newest[0] == live.over == 4


def test_the_only_part_of_a_frame_is_shown_live(bench: Path, tmp_path: Path) -> None:
    """There is nothing else of it; the film that is made afterwards says so."""
    run = taken(bench, tmp_path / "run.h5", 100)
    assert watched(run).newest[0] == 0
    with pytest.raises(InvalidData, match="no frame of it was taken whole"):
        film_of(run, LCT)


def test_a_film_of_the_bench_that_it_replays_is_the_same_film(whole: Path, tmp_path: Path) -> None:
    """Every visit to a point has its own photons, also where one frame of it is asked for."""
    shutil.copyfile(whole, tmp_path / "seen.h5")
    (tmp_path / "film.yaml").write_text(yaml.safe_dump(WORDS))
    command(tmp_path, "scan", "film.yaml", "--scene", "seen.h5", "-o", "again.h5", check=True)
    with Recording.open(whole) as one, Recording.open(tmp_path / "again.h5") as other:
        for frame in range(8):
            frames = range(frame, frame + 1)
            assert np.array_equal(one.transient(frames).counts, other.transient(frames).counts)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("pattern", "within_m"),
    # A circle does not say where in it something is: it is seen too near to the middle, alike in every frame.
    [({"kind": "circle", "points": 30, "radius_m": 0.4}, 0.2), ({"kind": "fermat_spiral", "dr_m": 0.09}, 0.05)],
    ids=["circle", "spiral"],
)
def test_points_off_the_grid_are_aligned_by_the_light_of_all_frames(
    pattern: dict[str, object], within_m: float, tmp_path: Path
) -> None:
    """One frame's own direct light, of few photons, would not do."""
    words = {**WORDS, "pattern": pattern}
    (tmp_path / "film.yaml").write_text(yaml.safe_dump(words))
    settings = bench_file(tmp_path / "bench.yaml", PANEL)
    run = taken(settings, tmp_path / "run.h5")
    film = film_of(run, LCT)
    assert film.frame.tolist() == list(range(8))
    off_m = film.track()["x_m"] - np.array([true_m(time_s)[0] for time_s in film.time_s])
    assert np.abs(off_m).max() < within_m
    assert np.std(off_m) < 0.03
    said: list[str] = []
    with open_checked(run) as recording:
        nothing_yet(recording, Path("none"), AUTO, False, said.append)
    assert said == ["points off the grid: the 8 frames are added up here; `nlos reconstruct --film` shows each"]
    one = reconstruct_file(run, LCT, ResultsFolder(tmp_path / "one", volume=False), frame=3)
    assert np.array_equal(one.albedo, film.albedo[3])
    blinded = changed(run, tmp_path / "blinded.h5", 3, _behind_the_peak)
    assert np.isfinite(film_of(blinded, LCT).albedo[3]).all()


def _behind_the_peak(counts: np.ndarray) -> np.ndarray:
    """No direct light at all."""
    kept = counts.copy()
    kept[: int(counts.argmax()) + 8] = 0
    return kept


def test_a_frame_from_python_is_the_frame_of_the_command(whole: Path, tmp_path: Path) -> None:
    made = reconstruct_file(whole, LCT, ResultsFolder(tmp_path / "made", volume=False), frame=5)
    scan = nlos.load(whole, frame=5)
    assert np.array_equal(nlos.reconstruct(scan, method="lct", constants="none").albedo, made.albedo)
    assert np.array_equal(scan.calibrated("none").counts.sum(axis=0) > 0, scan.exposure_s > 0)


def test_results_say_which_frame_they_are_of(whole: Path, tmp_path: Path) -> None:
    shutil.copyfile(whole, tmp_path / "run.h5")
    words = ("reconstruct", "run.h5", "-o", "out", "--no-volume")
    command(tmp_path, *words, "--frame", "2", check=True)
    assert '"frame": 2' in command(tmp_path, "info", "out/reconstruction.h5", "--json", check=True).stdout
    command(tmp_path, *words, "--frame", "2", "--skip-existing", check=True)
    for other in (("--frame", "3"), (), ("--frame", "2", "--method", "fk")):
        refused = command(tmp_path, *words, *other, "--skip-existing")
        assert refused.returncode == 6
        assert "holds lct, frame 2, not" in refused.stderr
    film = ("reconstruct", "run.h5", "--film", "-o", "film")
    command(tmp_path, *film, check=True)
    command(tmp_path, *film, "--skip-existing", check=True)
    refused = command(tmp_path, *film, "--memory", "--skip-existing")
    assert refused.returncode == 6
    assert "holds a film by lct, not by lct with a memory" in refused.stderr


def test_usage_errors_come_before_the_pictures(whole: Path, tmp_path: Path) -> None:
    shutil.copyfile(whole, tmp_path / "run.h5")
    for words, code in ((("-o", "nowhere/film.gif"), 2), (("--method", "lctt"), 2)):
        refused = command(tmp_path, "export", "run.h5", "--to", "gif", *words)
        assert refused.returncode == code, refused.stderr
        assert "calibrated" not in refused.stderr
    (tmp_path / "film.yaml").write_text(yaml.safe_dump(WORDS))
    refused = command(tmp_path, "scan", "film.yaml", "-o", "new.h5", "--until", "stable")
    assert refused.returncode == 2
    assert "what moves is never good enough" in refused.stderr
    assert not (tmp_path / "new.h5").exists()


def test_a_mistyped_sweep_leaves_nothing_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(yaml.safe_dump({k: v for k, v in WORDS.items() if k != "frames"}))
    words = ("scan", "scan.yaml", "-o", "series", "--sweep")
    for wrong in ("dwel_ms=1,2", "dwell_ms=1,-2"):
        assert command(tmp_path, *words, wrong).returncode == 2
        assert not (tmp_path / "series").exists()
    command(tmp_path, *words, "dwell_ms=1,2", check=True)
    assert len(list((tmp_path / "series").glob("*.h5"))) == 2


def test_another_scene_on_the_simulated_table_is_refused(bench: Path, tmp_path: Path) -> None:
    run = taken(bench, tmp_path / "run.h5", 200)
    with (
        nlos.open_bench("simulated") as table,
        pytest.raises(ResumeRefused, match=r"simulation: scene\.objects"),
    ):
        list(nlos.scan(bench.with_name("film.yaml"), table, output=run, resume=True))


def test_an_interleaved_film_is_in_order_too(tmp_path: Path) -> None:
    film = film_of(filmed_objects(tmp_path / "run.h5", 4, PANEL), LCT)
    assert film.frame.tolist() == [3, 4, 5, 6, 7]
