"""What a memory of light gains on scenes that move: pictures of single frames and of all light brought to their moment.

`python -m studies.moving docs/moving.md [ROWS.jsonl ...]` draws 20 moving scenes and 4 still ones by the light of the
simulated bench, which no network was trained on, 256 points of 0.4 ms a frame out of 64 x 64, each frame another
sixteenth, and makes the page; `python -m studies.moving ROWS.jsonl 0 1 2 ...` measures these scenes alone, for the page
to take up.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.frames import bayer
from nlos.acquisition.response import Response
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.drivers.simulated.beam import SPEED_OF_LIGHT_M_PER_S, BeamPath, Spot
from nlos.drivers.simulated.moving import Scenery
from nlos.drivers.simulated.scene import SceneLight, SceneSettings
from nlos.drivers.simulated.spad import DetectorSettings
from nlos.drivers.simulated.spad import Response as Jitter
from nlos.drivers.simulated.surfaces import Surface
from nlos.recon.live import LiveReconstruction
from nlos.recon.metrics import image_scores
from nlos.recon.over_time.following import FollowingMemory
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.over_time.moments import Moments, added
from nlos.recon.reconstruct import reconstruct
from nlos.recon.volume import Reconstruction
from studies.by_scene import run

Floats = npt.NDArray[np.float64]

WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(512, 32e-12)
DWELL_S, REPETITION_HZ, AMBIENT_CPS = 0.4e-3, 10e6, 500.0
FRAMES, POINTS, SIDE = 32, 256, 4
MOVING, STILL = range(20), range(100, 104)
LOOKS = (12, 17, 22)
"""Frames at which pictures are compared: 1.3, 1.8 and 2.3 s after the first; most scenes turn just before the first."""
AFTER_1_S = 9
FIGURE = ("..##..", "..##..", "######", ".####.", "..##..", ".#..#.", ".#..#.")
LEAST_M, MOST_M = np.array([-0.55, -0.5, 0.6]), np.array([0.55, 0.5, 1.3])
SNR = (1.0, 0.1, 0.03, 0.01, 0.003)


def objects(scene: int) -> tuple[Surface, ...]:
    """One or two of a letter, a panel, a sphere and a figure, at 0.2 to 1 m/s on straight ways of about a second, some
    of them turning."""
    rng = np.random.default_rng((scene, 77))
    made = []
    for _ in range(int(rng.choice([1, 2], p=[0.65, 0.35]))):
        shape: dict[str, Any] = {}
        match rng.choice(["letter", "letter", "panel", "sphere", "figure"]):
            case "letter":
                shape = {"letter": "ABCEFGHKLNPRSTUXZ3579"[rng.integers(21)], "height_m": float(rng.uniform(0.5, 0.8))}
            case "panel":
                shape = {"panel_m": (float(rng.uniform(0.2, 0.5)), float(rng.uniform(0.2, 0.6)))}
            case "sphere":
                shape = {"sphere_m": float(rng.uniform(0.12, 0.25))}
            case _:
                shape = {"bitmap": FIGURE, "height_m": float(rng.uniform(0.6, 0.9))}
        place = rng.uniform(LEAST_M, MOST_M)
        shape |= {"centre_m": tuple(place.tolist()), "albedo": float(rng.uniform(0.6, 1.0))}
        if scene in MOVING:
            shape["path"] = tuple(_path(rng, place))
        made.append(Surface.model_validate(shape))
    return tuple(made)


def _path(rng: np.random.Generator, place: Floats) -> Iterator[dict[str, Any]]:
    at_s, speed_m_per_s = 0.0, rng.uniform(0.2, 1.0)
    while at_s < FRAMES * POINTS * DWELL_S:
        for _ in range(50):
            way = rng.normal(size=3) * [1, 1, 0.6]
            took_s = rng.uniform(0.8, 1.6)
            there = place + way / np.linalg.norm(way) * speed_m_per_s * took_s
            if ((there > LEAST_M) & (there < MOST_M)).all():
                break
        else:
            there = rng.uniform(LEAST_M, MOST_M)
            took_s = float(np.linalg.norm(there - place)) / speed_m_per_s
        at_s, place = at_s + took_s, there
        turned = {"yaw_deg": float(rng.uniform(-40, 40))} if rng.random() < 0.3 else {}
        turned |= {"roll_deg": float(rng.uniform(-30, 30))} if rng.random() < 0.3 else {}
        yield {"at_s": at_s, "centre_m": tuple(place.tolist()), **turned}


def mean_peak(scene: int) -> float:
    """Counts in the brightest bin of a point, on average: 1 to 5."""
    return float(np.exp(np.random.default_rng((scene, 78)).uniform(0.0, np.log(5.0))))


class Film:
    """The frames of one scene, drawn as they are asked for."""

    def __init__(self, scene: int, shown: tuple[Surface, ...] | None = None) -> None:
        self.scene, self.objects = scene, shown or objects(scene)
        self._scenery = Scenery(self.objects, 0.004)
        row, col = np.divmod(np.arange(WALL.rows * WALL.cols), WALL.cols)
        self._part = bayer(SIDE)[row % SIDE, col % SIDE]
        middle_s = FRAMES * POINTS * DWELL_S / 2
        bright = [self._expected(self._light(1.0), int(point), middle_s) for point in np.flatnonzero(self._part == 0)]
        dark = self._expected(self._light(0.0), 0, 0.0)
        self._seen = self._light(mean_peak(scene) / float(np.mean([(each - dark).max() for each in bright])))

    def frame(self, number: int) -> Moments:
        """Every other one backwards."""
        points = np.flatnonzero(self._part == number % SIDE**2)[:: -1 if number % 2 else 1]
        taken_s = np.asarray((number * POINTS + np.arange(POINTS) + 0.5) * DWELL_S, dtype=np.float64)
        rng = np.random.default_rng((self.scene, number))
        drawn = [
            rng.poisson(self._expected(self._seen, int(point), at_s))
            for point, at_s in zip(points, taken_s, strict=True)
        ]
        row, col = np.divmod(points, WALL.cols)
        places, exposure_s = (WALL.x_m()[col], WALL.y_m()[row]), np.full(POINTS, DWELL_S)
        return Moments(*places, np.array(drawn, np.float32), exposure_s, taken_s, WALL, TIME)

    def truth(self, at_s: float) -> Floats:
        """The front view at one moment: albedo times cosine times coverage."""
        now = self._scenery.at(at_s)
        col = np.rint((now.positions_m[:, 0] / WALL.width_m + 0.5) * WALL.cols - 0.5).astype(np.intp)
        row = np.rint((0.5 - now.positions_m[:, 1] / WALL.height_m) * WALL.rows - 0.5).astype(np.intp)
        seen = (col >= 0) & (col < WALL.cols) & (row >= 0) & (row < WALL.rows) & (now.normals[:, 2] < 0)
        light = now.reflectance_m2 * now.normals[:, 2] ** 2 * WALL.rows * WALL.cols / (WALL.width_m * WALL.height_m)
        flat = np.bincount((row * WALL.cols + col)[seen], light[seen], WALL.rows * WALL.cols)
        return np.asarray(flat.reshape(WALL.rows, WALL.cols), dtype=np.float64)

    def _light(self, hidden_cps: float) -> SceneLight:
        settings = SceneSettings(objects=self.objects, direct_cps=0, hidden_cps=hidden_cps, ambient_cps=AMBIENT_CPS)
        return SceneLight(settings, DetectorSettings(), BeamPath(2.0), REPETITION_HZ, self.scene)

    def _expected(self, light: SceneLight, point: int, at_s: float) -> Floats:
        row, col = divmod(point, WALL.cols)
        x_m, y_m = float(WALL.x_m()[col]), float(WALL.y_m()[row])
        range_m = float(np.sqrt(x_m**2 + y_m**2 + 4))
        spot, wall_s = Spot(x_m, y_m, range_m, 2 / range_m), 2 * range_m / SPEED_OF_LIGHT_M_PER_S
        per_pulse = light.photons_per_pulse(spot, TIME.bin_width_s, wall_s, at_s)
        return per_pulse[: TIME.bins] * DWELL_S * REPETITION_HZ


def response() -> Response:
    """The simulated detector's."""
    _, shares = Jitter(DetectorSettings()).pulse(0.5, 4e-12)
    return Response(shares / shares.sum(), 4e-12, float(shares.argmax()), "the simulated detector's")


def pictured(light: Transient) -> Reconstruction:
    """By NANO as it ships, for speed without averages over mirror images."""
    return reconstruct(replace(light, response=response()), "nano", {"symmetries": False}, explain=False)


def by_lct(light: Transient, snr: float) -> Reconstruction:
    """By the light-cone transform."""
    return reconstruct(replace(light, response=response()), "lct", {"snr": snr}, explain=False)


def psnr(made: Reconstruction, truth: Floats) -> float:
    """At the best least-squares scale."""
    return image_scores(made.albedo, truth)["psnr"]


class Live:
    """A film as it is watched, in one of the `FORMS` that are: each frame with the light of those before it."""

    def __init__(self, form: str) -> None:
        self._memory, self._live = LightMemory(WALL, TIME), LiveReconstruction("nano", finish=form == "video")

    def picture(self, frame: Moments, number: int) -> Reconstruction:
        """Of the newest frame."""
        self._memory.watch(frame)
        seen = self._memory.on_half_grid()
        told = replace(seen, light=replace(seen.light, response=response()))
        return self._live.of_film(told, number).reconstruction


def recorded(frames: Sequence[Moments]) -> Iterator[tuple[Reconstruction, float]]:
    """Pictures of a film that is over, and how many frames' light each holds."""
    memory = FollowingMemory(WALL, TIME)
    for light in memory.each_brought(frames):
        made = pictured(light)
        memory.pictured(made)
        yield made, float(memory.weights.sum())


def measured(scene: int) -> list[dict[str, Any]]:
    """A row a look: of a moving scene single frames and memories, of a still one memories and all light. A film of a
    still one ends after a second."""
    film, rows, still = Film(scene), [], scene in STILL
    looks = (AFTER_1_S,) if still else LOOKS
    seen = max(looks) + (1 if still else 2)
    frames = [film.frame(number) for number in range(seen)]
    live = {form: Live(form) for form in ("half", "video")}
    for number, (frame, (made, light)) in enumerate(zip(frames, recorded(frames), strict=True)):
        watched = {form: each.picture(frame, number) for form, each in live.items()}
        if number not in looks:
            continue
        alone, truth = added([frame], [1.0]), film.truth(frame.mean_s)
        row: dict[str, Any] = {"scene": scene, "frame": number, "objects": len(film.objects), "peak": mean_peak(scene)}
        row |= {"frames": light, "memory": psnr(made, truth)}
        row |= {form: psnr(each, truth) for form, each in watched.items()}
        if not still:
            row["lct"] = max(psnr(by_lct(alone, snr), truth) for snr in SNR)
            row["nano"] = psnr(pictured(alone), truth)
        rows.append(row)
    if still:
        everything = added([film.frame(number) for number in range(FRAMES)], [1.0] * FRAMES)
        rows[0]["long"] = psnr(pictured(everything), film.truth(0.0))
    return rows


FORMS = (
    ("memory", "of a recording, with light of frames before and after, as `--film --memory` makes them"),
    ("half", "with the memory of films that are watched, on half the grid"),
    ("video", "that, unrefined and finished by the network for films, as `nlos live` shows it"),
)
"""Of NANO's pictures, in words."""


def page(rows: list[dict[str, Any]]) -> str:
    """Means over scenes with standard errors, and every look."""
    moving, still = ([row for row in rows if ("nano" in row) == moves] for moves in (True, False))
    lines = [
        "# Moving scenes, measured", "",
        "Made by `python -m studies.moving docs/moving.md`, which says what is drawn: 16 x 16 points of 0.4 ms a",
        "frame, 64 x 64 pictures, mean peaks of 1 to 5 counts, objects at 0.2 to 1 m/s. PSNR at the best least-squares",
        "scale, means over scenes with standard errors; NANO without averages over mirror images. The network that",
        "finishes pictures never saw such scenes or shapes.",
        "", "| NANO's pictures | against | all | one object | two objects |", "| --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for form, made in FORMS:
        for name, words in (("nano", "NANO, frame by frame"), ("lct", "LCT at its best snr, frame by frame")):
            parts = [[row for row in moving if row["objects"] in some] for some in ((1, 2), (1,), (2,))]
            lines.append(f"| {made} | {words} | {' | '.join(_difference(part, form, name) for part in parts)} |")
    long_s = FRAMES * POINTS * DWELL_S
    words = f"the last picture of a film of 1 s, against NANO's of all light of {long_s:.1f} s"
    lines += ["", f"Still scenes, {words}:", ""]
    lines += [f"- {made}: {_difference(still, form, 'long')}." for form, made in FORMS]
    head = "| scene | frame | objects | mean peak | LCT | NANO | memory | half grid | finished |"
    lines += ["", head + " light of frames | all light |", "|" + " --- |" * 11]
    names = ("lct", "nano", "memory", "half", "video", "frames", "long")
    for row in rows:
        figures = [f"{row[name]:.1f}" if name in row else "" for name in names]
        lines.append(
            f"| {row['scene']} | {row['frame']} | {row['objects']} | {row['peak']:.1f} | {' | '.join(figures)} |"
        )
    return "\n".join(lines) + "\n"


def _difference(rows: list[dict[str, Any]], left: str, right: str) -> str:
    scenes = sorted({row["scene"] for row in rows})
    each = [np.mean([row[left] - row[right] for row in rows if row["scene"] == scene]) for scene in scenes]
    if len(each) < 2:
        return ""
    return f"{np.mean(each):+.2f} ± {np.std(each, ddof=1) / np.sqrt(len(each)):.2f} dB of {len(each)}"


if __name__ == "__main__":
    run(measured, (*MOVING, *STILL), page)
