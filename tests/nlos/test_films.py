"""A film of something that moves: pictures, a GIF and a table, held against the path that photons were drawn from."""

import csv
import json
import os
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.chain import reconstruct_file
from nlos.cli.app import load_verb
from nlos.drivers.simulated.motion import pose_at
from nlos.drivers.simulated.surfaces import Surface
from nlos.film import BAR_PX, film_of, write_film, write_gif, write_mp4
from nlos.recipe import Recipe
from nlos.recon.volume import response_words
from nlos.response import response_wanted
from nlos.results_folder import ResultsFolder
from tests.nlos.bench_films import filmed_objects

LCT = Recipe("lct", constants=Path("none"))
PANEL = {"panel_m": (0.2, 0.2), "centre_m": (-0.2, 0.1, 0.7), "path": [{"at_s": 2.0, "centre_m": (0.3, 0.0, 0.8)}]}


@pytest.fixture(scope="module", params=[1, 4])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight frames, whole and in fourths, of a panel of 20 cm at 26 cm/s."""
    return filmed_objects(tmp_path_factory.mktemp("film") / "run.h5", request.param, PANEL)


def test_a_film_tells_where_a_panel_was_and_how_fast(run: Path, tmp_path: Path) -> None:
    film = film_of(run, LCT)
    assert len(film.frame) == 9 - film.window
    assert film.frame.tolist() == list(range(film.window - 1, 8))
    found, panel = film.track(), Surface.model_validate_json(json.dumps(PANEL))
    # The scan's clock starts some milliseconds before the first point is lit: less than a millimetre of way.
    true = np.array([pose_at(time_s, panel.pose, panel.path).centre_m for time_s in film.time_s])
    for axis, column in enumerate(("x_m", "y_m", "z_m")):
        assert np.median(np.abs(found[column] - true[:, axis])) < 0.03
    assert np.median(found["vx_m_per_s"]) == pytest.approx(0.25, rel=0.2)
    paths = write_film(tmp_path / "out", film)
    with Image.open(paths[1]) as picture:
        assert picture.n_frames == len(film.frame)
        assert picture.info["duration"] == pytest.approx(np.median(np.diff(film.time_s)) * 1e3, abs=10)
    with np.load(paths[0]) as held:
        assert held["explained"].shape == held["explained_error"].shape == film.frame.shape
        assert held["explained"].tolist() == [one.share for one in film.explained]
        assert np.median(held["explained"]) > 0.15
    assert not any(one.nothing for one in film.explained)
    rows = list(csv.DictReader(paths[2].read_text().splitlines()))
    assert [float(row["x_m"]) for row in rows] == pytest.approx(found["x_m"].tolist())
    assert [row["frame"] for row in json.loads(paths[3].read_text())] == film.frame.tolist()


def test_two_frames_to_a_picture_take_out_what_alternates(run: Path) -> None:
    """Every other frame runs backwards: of what recedes, the pictures are too high and too low in turn. A track goes
    through their middle."""
    with open_checked(run) as recording:
        if recording.plan.cycle > 1:
            pytest.skip("interleaved frames have no slow direction")
    panel, alternates_m = Surface.model_validate_json(json.dumps(PANEL)), []
    for window in (1, 2):
        film = film_of(run, LCT, window)
        true = np.array([pose_at(time_s, panel.pose, panel.path).centre_m for time_s in film.time_s])
        frame = np.arange(len(film.frame))
        seen = np.isfinite(film.depth_m) & (film.albedo > 0.25 * film.albedo.max(axis=(1, 2), keepdims=True))
        bright = np.where(seen, film.albedo, 0.0)
        places_m = (bright.sum(axis=2) * film.y_m).sum(axis=1) / bright.sum(axis=(1, 2))
        for y_m in (places_m, film.track()["y_m"]):
            off_m = y_m - true[:, 1]
            off_m -= np.polyval(np.polyfit(frame, off_m, 1), frame)
            alternates_m.append(abs(float(off_m @ np.where(frame % 2, -1.0, 1.0))) / len(frame))
    of_pictures, by_lines, of_two, _ = alternates_m
    assert of_pictures > 0.004
    assert max(of_two, by_lines) < of_pictures / 2


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", ["lct", "fk", "phasor", "lfe", "nlost"])
def test_with_a_memory_every_frame_has_a_picture_of_its_own_moment(run: Path, method: str) -> None:
    """Also where a frame holds a fourth of the points; and a panel that comes nearer is not seen alternately too high
    and too low."""
    film = film_of(run, replace(LCT, method=method), memory=True)
    assert film.frame.tolist() == list(range(8))
    assert film.window >= 1
    found, panel = film.track(), Surface.model_validate_json(json.dumps(PANEL))
    true = np.array([pose_at(time_s, panel.pose, panel.path).centre_m for time_s in film.time_s])
    late = slice(3, None)  # of fourths, the first frames have seen a part of the points each
    for axis, column in enumerate(("x_m", "y_m", "z_m")):
        assert np.median(np.abs(found[column] - true[:, axis])[late]) < 0.04  # half a pitch
    assert np.median(found["vx_m_per_s"]) == pytest.approx(0.25, rel=0.25)


def test_two_objects_have_rows_of_their_own(tmp_path: Path) -> None:
    """Drawn photon by photon: one moves, another appears and vanishes, each found within two frames and 3 cm."""
    moving = {
        "panel_m": (0.2, 0.2),
        "centre_m": (-0.25, 0.2, 0.6),
        "path": [{"at_s": 3.0, "centre_m": (0.2, 0.2, 0.6)}],
    }
    passing = {"panel_m": (0.2, 0.2), "centre_m": (0.15, -0.25, 0.8), "appears_s": 0.75, "vanishes_s": 2.0}
    film = film_of(filmed_objects(tmp_path / "two.h5", 1, moving, passing), LCT)
    found = film.objects()
    assert len(found) == 2
    objects = [Surface.model_validate_json(json.dumps(each)) for each in (moving, passing)]
    for each, one in zip(found, objects, strict=True):
        there = np.isfinite(each["x_m"])
        assert np.count_nonzero(there != [one.is_there(time_s) for time_s in film.time_s]) <= 2
        for axis, column in enumerate(("x_m", "y_m", "z_m")):
            true = [pose_at(time_s, one.pose, one.path).centre_m[axis] for time_s in film.time_s[there]]
            assert np.median(np.abs(each[column][there] - true)) < 0.03
    assert np.nanmedian(found[0]["vx_m_per_s"]) == pytest.approx(0.15, rel=0.2)
    write_film(tmp_path / "out", film)
    rows = list(csv.DictReader((tmp_path / "out" / "objects.csv").read_text().splitlines()))
    assert {row["object"] for row in rows} == {"1", "2"}
    assert len(rows) == sum(int(np.isfinite(each["x_m"]).sum()) for each in found)


@pytest.mark.sampled(2)
def test_a_film_is_told_the_response_as_every_picture_is(run: Path, tmp_path: Path) -> None:
    """A picture of a film is the one that `reconstruct --frame` makes, told the same; without a word each takes the
    direct peak of the whole scan."""
    said = {"auto": "the scan's own direct peak", "300": "300 ps FWHM, a Gaussian, as given"}
    films = {}
    for word, words in said.items():
        told = replace(LCT, response=response_wanted(word))
        film = films[word] = film_of(run, told, 1)
        assert words in film.response
        frame = int(film.frame[3])
        one = reconstruct_file(run, told, ResultsFolder(tmp_path / word, volume=False), frame=frame)
        assert np.array_equal(one.albedo, film.albedo[3])
        assert response_words(one) == film.response
    assert not np.array_equal(films["auto"].albedo, films["300"].albedo)


def test_a_film_that_cannot_be_is_refused(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InvalidData, match="9 frames to a picture, but it has 8"):
        film_of(run, LCT, 9)
    film = film_of(run, LCT, 8)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InvalidData, match="no ffmpeg"):
        write_mp4(tmp_path / "film.mp4", film)


def put_ffmpeg(folder: Path, monkeypatch: pytest.MonkeyPatch, does: str) -> None:
    """In place of the computer's ffmpeg, a shell's script."""
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\n{does}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.skipif(sys.platform == "win32", reason="its ffmpeg is a shell's script")
def test_an_mp4_is_asked_for_that_plays_while_it_loads(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put_ffmpeg(tmp_path, monkeypatch, 'for last; do :; done\necho "$*" > "$last"')
    write_mp4(tmp_path / "film.mp4", film_of(run, LCT, 8))
    assert " -movflags +faststart -f mp4 " in (tmp_path / "film.mp4").read_text()


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="there is no ffmpeg on this computer")
def test_the_table_of_an_mp4_comes_before_its_pictures(run: Path, tmp_path: Path) -> None:
    write_mp4(tmp_path / "film.mp4", film_of(run, LCT, 1))
    data = (tmp_path / "film.mp4").read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")


def test_a_bar_below_a_gif_says_how_far_it_is(run: Path, tmp_path: Path) -> None:
    film = film_of(run, LCT, 1)
    write_gif(tmp_path / "film.gif", film)
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.n_frames == len(film.time_s) == 8
        shown = []
        for number in range(gif.n_frames):
            gif.seek(number)
            bar = np.asarray(gif.convert("L"))[-BAR_PX:]
            assert (bar == bar[0]).all()
            shown.append(int(np.count_nonzero(bar[0] > 160)))
    assert shown == [round(gif.width * (number + 1) / 8) for number in range(8)]


@pytest.mark.skipif(sys.platform == "win32", reason="its ffmpeg is a shell's script")
@pytest.mark.parametrize(("does", "said"), [("exec sleep 60", "longer than 0.2 s for 1 picture"),
                                            ("echo no such codec >&2; exit 3", "failed: no such codec")])  # fmt: skip
def test_an_ffmpeg_that_hangs_or_fails_is_named(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, does: str, said: str
) -> None:
    put_ffmpeg(tmp_path, monkeypatch, does)
    monkeypatch.setattr("nlos.film.ENCODING_S", 0.2 if "sleep" in does else 60.0)
    with pytest.raises(InvalidData, match=rf"film\.mp4: ffmpeg .*{said}"):
        write_mp4(tmp_path / "film.mp4", film_of(run, LCT, 8))


@pytest.mark.skipif(sys.platform == "win32", reason="its ffmpeg is a shell's script")
@pytest.mark.parametrize(("does", "why"), [
    ("echo 'Error writing trailer: No space left on device' >&2", "No space left on device"),  # and ends with 0
    ("echo 'Could not write header: No space left on device' >&2; exit 1", "No space left on device"),
    ("kill -XFSZ $$", "File too large"),
])  # fmt: skip
def test_a_disk_that_is_full_is_none_of_an_mp4_whatever_ffmpeg_ends_with(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, does: str, why: str
) -> None:
    """FFmpeg 5 ends with 0 where the disk took a part of the film alone."""
    put_ffmpeg(tmp_path, monkeypatch, f'for last; do :; done\necho a part > "$last"\n{does}')
    there = tmp_path / "run.h5"
    shutil.copyfile(run, there)
    with pytest.raises(StorageError, match=rf"run\.mp4: cannot be written \({why}\)"):
        load_verb("export").main([str(there), "--to", "mp4"], standalone_mode=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ffmpeg", "run.h5"]


@pytest.mark.parametrize("formats", ["gif,mp4", "npz,gif,mp4", "npz,ply"])
def test_formats_of_which_one_cannot_be_written_leave_no_file(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, formats: str
) -> None:
    there = tmp_path / "run.h5"
    shutil.copyfile(run, there)
    monkeypatch.setenv("PATH", str(tmp_path))  # no ffmpeg
    with pytest.raises(Exception, match=r"no ffmpeg|is a format of pictures"):
        load_verb("export").main([str(there), "--to", formats], standalone_mode=False)
    assert [path.name for path in tmp_path.iterdir()] == ["run.h5"]


def test_a_film_is_exported_with_its_scan(run: Path, tmp_path: Path) -> None:
    there = tmp_path / "run.h5"
    shutil.copyfile(run, there)
    load_verb("export").main([str(there), "--to", "gif,npz"], standalone_mode=False)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.gif", "run.h5", "run.npz"]
