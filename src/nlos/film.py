"""A recording of several frames as a film: a picture of each, and where what it shows is and how fast."""

import csv
import errno
import json
import logging
import math
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import colormaps
from PIL import Image, ImageDraw

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.condition import listed
from nlos.acquisition.recording.frames import PicturedFrames, frame_table
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.acquisition.transient import Transient
from nlos.chain import arrivals_of, calibrate_scan, constants_for
from nlos.film_memory import FilmMemory
from nlos.loaded import loaded_frames
from nlos.recipe import Recipe
from nlos.recon.errors import NoLight
from nlos.recon.explained_share import NOT_LOOKED_FOR, Explained
from nlos.recon.reconstruct import reconstruct
from nlos.recon.track import track
from nlos.recon.tracked_objects import tracked_objects
from nlos.recon.volume import Reconstruction, response_words
from nlos.recon.whole_files import whole_files
from nlos.response import say_response, with_response

log = logging.getLogger(__name__)

LONGEST_SIDE_PX = 384
BAR_PX, BAR_GREYS = 6, (96, 224)
"""Height of the bar below a GIF's pictures, and how bright what is still to come and what has been shown are."""
ENCODING_S = 600.0
"""What ffmpeg gets for a film."""
_TOO_LARGE = -signal.SIGXFSZ if hasattr(signal, "SIGXFSZ") else None
"""What ffmpeg ends with where files may not be as large as that (`ulimit -f`)."""
_OF_THE_DISK = (errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG, errno.EROFS, errno.EIO)
TRAILS = ("#4cc9f0", "#80ed99", "#f15bb5", "#ffffff")
NAMES = ("film.npz", "film.gif", "track.csv", "track.json", "objects.csv")


@dataclass(frozen=True, eq=False)
class Film:
    """Pictures in the order of time, all on one scale; `frame` is the last that each is made from."""

    albedo: npt.NDArray[np.float32]  # (F, H, W)
    depth_m: npt.NDArray[np.float32]  # (F, H, W), NaN where nothing is seen
    frame: npt.NDArray[np.int64]  # (F,)
    time_s: npt.NDArray[np.float64]  # (F,), the mean moment of exposure since the scan's start
    x_m: npt.NDArray[np.float64]
    y_m: npt.NDArray[np.float64]
    window: int
    response: str
    """Which response of the instrument the method was told, in words."""
    explained: tuple[Explained, ...]
    """How much of light that it was not made from each picture accounts for."""
    settings: Mapping[str, Any] = field(default_factory=dict)
    """The method and its settings, as each picture was made."""
    memory: bool = False
    """Whether each holds light of other frames, moved along."""

    def track(self) -> dict[str, npt.NDArray[Any]]:
        """Centroid, extent and velocity of what is seen, a row a picture; see `recon.track`."""
        found = track(self.albedo, self.depth_m, self.x_m, self.y_m, self.time_s, self.window)
        return {**found, "frame": self.frame}

    def objects(self) -> list[dict[str, npt.NDArray[Any]]]:
        """The same of each object alone, NaN while it is not there; see `recon.tracked_objects`."""
        found = tracked_objects(self.albedo, self.depth_m, self.x_m, self.y_m, self.time_s, self.window)
        return [{**each, "frame": self.frame} for each in found]


def film_of(
    run: Path,
    recipe: Recipe,
    window: int | None = None,
    step: Callable[[int], None] = lambda frames: None,
    memory: bool = False,
) -> Film:
    """Every frame of a recording by `recipe`, each from `window` successive ones: by default as many as it takes for
    all points; with a `memory` each from its own light, and that of others moved along. Aligned by the direct light of
    all. A frame without light behind it is dark; what is not there whole, or was taken in pieces, is skipped, and
    said. `step` is told how many there will be, after each. Raises `InvalidData`, and what the first frame raises
    where none has a picture."""
    with open_checked(run) as recording:
        plan = recording.plan
        if plan.frames == 1:
            raise InvalidData(f"{run}: is a scan of one frame; `frames` in a scan file makes more")
        each = (1 if memory else plan.cycle) if window is None else window
        if each > plan.frames:
            raise InvalidData(f"{run}: {each} frames to a picture, but it has {plan.frames}")
        table = frame_table(plan, recording.intact_records())
        found = table.pictured(each)
        _say_skipped(run, found)
        if not found.frames:
            none = "no frame of it was" if each == 1 else f"no {each} successive frames of it were"
            raise InvalidData(f"{run}: {none} taken whole; `nlos info` says what was")
        whole = loaded_frames(recording, None)
        known = constants_for(whole, recipe.constants)
        arrivals = arrivals_of(whole, known)
        remembered = FilmMemory(recording, calibrate_scan(whole, False, known, arrivals)) if memory else None
        made: list[Reconstruction | None] = []
        nothing: NoLight | None = None

        def scans() -> Iterator[tuple[int, Transient]]:
            for frames in found.frames:
                scan = loaded_frames(recording, frames)
                yield frames.stop - 1, with_response(calibrate_scan(scan, False, known, arrivals), recipe.response)
                step(len(found.frames))

        for last, transient in scans() if remembered is None else remembered.brought(scans()):
            if not made:
                say_response(transient)
            try:
                picture = reconstruct(transient, recipe.method, recipe.settings, recipe.device)
            except NoLight as error:
                log.warning("%s: frame %d shows nothing, its picture is dark: %s", run, last, error)
                made.append(None)
                nothing = nothing or error
                continue
            made.append(picture)
            if remembered is not None:
                remembered.pictured(picture)
    first = next((one for one in made if one is not None), None)
    if first is None:
        assert nothing is not None
        raise nothing
    dark = replace(
        first, albedo=np.zeros_like(first.albedo), depth_m=np.full_like(first.depth_m, np.nan), explained=None
    )
    pictures = [one or dark for one in made]
    wall = first.wall
    return Film(
        np.stack([one.albedo for one in pictures]), np.stack([one.depth_m for one in pictures]),
        np.array([frames.stop - 1 for frames in found.frames]),
        np.array([table.mean_of(frames) for frames in found.frames]),
        wall.x_m(), wall.y_m(), each if remembered is None else remembered.frames_to_a_picture,
        response_words(first), tuple(one.explained or NOT_LOOKED_FOR for one in pictures),
        {"method": first.method, **first.settings}, memory,
    )  # fmt: skip


def _say_skipped(run: Path, found: PicturedFrames) -> None:
    for frames, why in (
        (found.short, "a part of the points only"),
        (found.late, "points taken at quite another moment"),
    ):
        if frames:
            log.warning("%s: skipped, with %s: frames %s. --frame shows one.", run, why, listed(frames))


def write_film(folder: Path, film: Film, *, new: bool = False) -> list[Path]:
    """film.npz (`albedo`, `depth_m`, `frame`, `time_s`, `x_m`, `y_m`, `explained`, `explained_error`, `settings`
    as JSON, `memory`), film.gif, track.csv and track.json of all that is seen as one, and objects.csv of each object
    alone. Raises as `whole_files` does."""
    with whole_files(folder, new=new) as fresh:
        _write_film(fresh, film)
    return [folder / name for name in NAMES]


def made_of(folder: Path) -> tuple[str, bool] | None:
    """By which method the film in `folder` was made, and whether with a memory; None where it does not say."""
    try:
        with np.load(folder / NAMES[0]) as held:
            return str(json.loads(str(held["settings"]))["method"]), bool(held["memory"])
    except (OSError, ValueError, LookupError, TypeError):
        return None


def _write_film(folder: Path, film: Film) -> None:
    paths = [folder / name for name in NAMES]
    arrays: dict[str, Any] = {
        name: getattr(film, name) for name in ("albedo", "depth_m", "frame", "time_s", "x_m", "y_m")
    }
    for name, figure in (("explained", "share"), ("explained_error", "error")):
        arrays[name] = np.array([getattr(one, figure) for one in film.explained], dtype=np.float64)  # None becomes NaN
    arrays["settings"] = np.array(json.dumps(film.settings))
    arrays["memory"] = np.array(film.memory)
    np.savez_compressed(paths[0], **arrays)
    write_gif(paths[1], film)
    columns = film.track()
    known = _rows(columns)
    _write_csv(paths[2], list(columns), known)
    whole = [dict.fromkeys(columns) | row for row in known]
    paths[3].write_text(json.dumps(whole, indent=1) + "\n", encoding="utf-8")
    apart = [
        {"frame": row.pop("frame"), "object": number, **row}
        for number, each in enumerate(film.objects(), 1)
        for row in _rows(each)
        if "x_m" in row
    ]
    _write_csv(paths[4], ["frame", "object", *(name for name in columns if name != "frame")], apart)


def _rows(columns: Mapping[str, npt.NDArray[Any]]) -> list[dict[str, Any]]:
    """A dictionary a frame, without what is not known in it."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [{key: value for key, value in zip(columns, row, strict=True) if not math.isnan(value)} for row in rows]


def _write_csv(path: Path, names: list[str], rows: list[dict[str, Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)


def write_gif(path: Path, film: Film) -> None:
    """The pictures at the pace at which they were taken, in hundredths of a second as GIF has them, 2 at least. A bar
    below each says how far the film is: programs that show a GIF say it nowhere, and start it over and over."""
    drawn = _drawn(film)
    images = []
    for number, picture in enumerate(drawn, 1):
        bar = np.full((BAR_PX, picture.shape[1], 3), BAR_GREYS[0], dtype=np.uint8)
        bar[:, : round(picture.shape[1] * number / len(drawn))] = BAR_GREYS[1]
        images.append(Image.fromarray(np.concatenate([picture, bar])).convert("P", palette=Image.Palette.ADAPTIVE))
    pace_ms = max(round(_pace_s(film) * 100), 2) * 10
    images[0].save(path, "GIF", save_all=True, append_images=images[1:], duration=pace_ms, loop=0)


def ffmpeg() -> str:
    """Where the computer's ffmpeg is. Raises `InvalidData` where there is none."""
    if (encoder := shutil.which("ffmpeg")) is None:
        raise InvalidData("mp4: there is no ffmpeg on this computer. Install it, or export gif.")
    return encoder


def write_mp4(path: Path, film: Film) -> None:
    """The same by the computer's ffmpeg, its table before its pictures: a browser plays it while it loads. Raises
    `InvalidData` where there is none, it fails or does not end, and `OSError` where the disk does not take the film:
    ffmpeg says so, and ends as if it were whole."""
    encoder = ffmpeg()
    drawn = _drawn(film)
    rows, cols = drawn.shape[1:3]
    command = [
        encoder, "-loglevel", "error", "-xerror", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{cols}x{rows}",
        "-r", f"{1 / _pace_s(film):.6f}", "-i", "-", "-pix_fmt", "yuv420p", "-movflags", "+faststart",
        "-f", "mp4", str(path),
    ]  # fmt: skip
    try:
        done = subprocess.run(command, input=drawn.tobytes(), capture_output=True, timeout=ENCODING_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise InvalidData(
            f"{path}: ffmpeg was ended, it took longer than {ENCODING_S:g} s for {len(drawn)} pictures of {cols} x "
            f"{rows}. Export gif, or try again when the computer has less to do."
        ) from error
    said = done.stderr.decode(errors="replace")
    if done.returncode == _TOO_LARGE:
        said = os.strerror(errno.EFBIG)
    for number in _OF_THE_DISK:
        if os.strerror(number) in said:
            raise OSError(number, os.strerror(number), str(path))
    if done.returncode:
        raise InvalidData(f"{path}: ffmpeg failed: {said[-200:]}")


def _pace_s(film: Film) -> float:
    return float(np.median(np.diff(film.time_s))) if len(film.time_s) > 1 else 1.0


def _drawn(film: Film) -> npt.NDArray[np.uint8]:
    """RGB pictures (F, R, C, 3), pixels enlarged by a whole number, sides even; the brightest of the film is white. A
    line behind each object shows where it was."""
    scaled = np.clip(film.albedo / max(float(film.albedo.max()), 1e-30), 0.0, 1.0)
    times = max(LONGEST_SIDE_PX // max(scaled.shape[1:]), 1)
    times += times % 2
    large = scaled.repeat(times, axis=1).repeat(times, axis=2)
    drawn = np.asarray(colormaps["inferno"](large)[..., :3] * 255).astype(np.uint8)
    for colour, each in zip(cycle(TRAILS), film.objects(), strict=False):
        col = np.interp(each["x_m"], film.x_m, np.arange(len(film.x_m)))
        row = np.interp(-each["y_m"], -film.y_m, np.arange(len(film.y_m)))
        places = np.stack([col, row], axis=1) * times + times / 2
        for frame in range(1, len(drawn)):
            way = places[: frame + 1][np.isfinite(places[: frame + 1, 0])]
            if len(way) > 1 and np.isfinite(places[frame, 0]):
                picture = Image.fromarray(drawn[frame])
                ImageDraw.Draw(picture).line([tuple(place) for place in way.tolist()], fill=colour, width=2)
                drawn[frame] = np.asarray(picture)
    return drawn
