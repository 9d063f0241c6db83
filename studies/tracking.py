"""Where objects of a film are and how fast, against the paths that photons were drawn from.

`python -m studies.tracking docs/tracking.md [ROWS.jsonl ...]` draws 20 scenes, half of them with two objects, by the
light of the simulated bench, which no network was trained on: panels of 20 cm at 0.2 to 1 m/s, some of which appear
after the film has begun; 256 points of 0.4 ms a frame out of 64 x 64, each frame another sixteenth.
`python -m studies.tracking ROWS.jsonl 0 1 2 ...` measures these scenes alone, for the page to take up.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated.motion import pose_at
from nlos.drivers.simulated.surfaces import Surface
from nlos.live.trails import Trails
from nlos.recon.live import LiveReconstruction
from nlos.recon.over_time.half_grid import HalfGrid, on_half_grid
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.track import COLUMNS
from nlos.recon.tracked_objects import tracked_objects
from studies.by_scene import run
from studies.moving import DWELL_S, POINTS, TIME, WALL, Film, mean_peak, recorded, response

Floats = npt.NDArray[np.float64]

FRAMES = 14
SCENES = range(300, 320)
FRAME_S = POINTS * DWELL_S
LEAST_M, MOST_M = np.array([-0.65, -0.65, 0.6]), np.array([0.65, 0.65, 1.2])
APART_M = 0.45
SAME_M = 0.25
"""An object found is one that was there if it is no farther off in the median of its frames."""


def panels(scene: int) -> tuple[Surface, ...]:
    """One or two panels on straight ways, `APART_M` apart at any time; the last of two appears later."""
    rng = np.random.default_rng((scene, 79))
    count = 1 + scene % 2
    times = np.linspace(0.0, FRAMES * FRAME_S, 9)[:, None]
    while True:
        starts = rng.uniform(LEAST_M, MOST_M, (count, 3))
        ways = rng.normal(size=(count, 3)) * [1, 1, 0.6]
        ways *= rng.uniform(0.2, 1.0, (count, 1)) / np.linalg.norm(ways, axis=1, keepdims=True)
        paths = starts[:, None] + ways[:, None] * times
        inside = ((paths > LEAST_M) & (paths < MOST_M)).all()
        if inside and all(np.linalg.norm(a - b, axis=1).min() > APART_M for a, b in combinations(paths, 2)):
            break
    made = []
    for number, (start, way) in enumerate(zip(starts, ways, strict=True)):
        end_s = FRAMES * FRAME_S
        shape: dict[str, Any] = {
            "panel_m": (0.2, 0.2), "centre_m": tuple(start.tolist()), "albedo": 0.9,
            "path": ({"at_s": end_s, "centre_m": tuple((start + way * end_s).tolist())},),
        }  # fmt: skip
        if number:
            shape["appears_s"] = float(rng.uniform(0.3, 0.8))
        made.append(Surface.model_validate(shape))
    return tuple(made)


WAYS = {
    "single": "single frames, as `nlos live` shows them",
    "memory": "with a memory, as `nlos live` shows them",
    "recorded": "of a recording, as `--film --memory` makes them",
}


def measured(scene: int) -> list[dict[str, Any]]:
    """A row an object and way of making NANO's pictures: see `WAYS`."""
    film, memory = Film(scene, panels(scene)), LightMemory(WALL, TIME)
    frames = [film.frame(number) for number in range(FRAMES)]
    time_s = [frame.mean_s for frame in frames]
    found = {name: _Watched(FRAMES) for name in ("single", "memory")}
    for number, frame in enumerate(frames):
        memory.watch(frame)
        for name, light in (("single", ([frame], [1.0])), ("memory", memory.light())):
            half = on_half_grid(*light)
            found[name].add(replace(half, light=replace(half.light, response=response())), number, frame.mean_s)
    made = list(recorded(frames))
    objects = {name: each.objects() for name, each in found.items()}
    objects["recorded"] = tracked_objects(
        np.stack([each.albedo for each, _ in made]), np.stack([each.depth_m for each, _ in made]), WALL.x_m(),
        WALL.y_m(), np.array(time_s),
    )  # fmt: skip
    about = {"scene": scene, "peak": mean_peak(scene)}
    return [{**about, "pictures": name, **row} for name in WAYS for row in held(film, objects[name], time_s)]


class _Watched:
    """What a page says of each object while a film comes: its place and its velocity then, not what later frames
    tell."""

    def __init__(self, frames: int) -> None:
        self._live, self._trails, self._frames = LiveReconstruction("nano"), Trails(), frames
        self._rows: dict[int, dict[str, Floats]] = {}

    def add(self, seen: HalfGrid, number: int, time_s: float) -> None:
        self._trails.add(self._live.of_film(seen, number + 1).reconstruction, time_s)
        for told in self._trails.told:
            row = self._rows.setdefault(told["object"], {name: np.full(self._frames, np.nan) for name in COLUMNS})
            row.setdefault("appears", np.array([number + 1 - len(told["x_m"])]))  # where its trail begins
            places = told["x_m"][-1], told["y_m"][-1], told["z_m"]
            for axis, place, v, error in zip(
                "xyz", places, told["velocity_m_per_s"], told["error_m_per_s"], strict=True
            ):
                row[f"{axis}_m"][number] = place
                row[f"v{axis}_m_per_s"][number] = np.nan if v is None else v
                row[f"v{axis}_error_m_per_s"][number] = np.nan if error is None else error

    def objects(self) -> list[dict[str, Floats]]:
        return list(self._rows.values())


def held(film: Film, found: Sequence[dict[str, Floats]], time_s: Sequence[float]) -> list[dict[str, Any]]:
    """Each object that was there against the one found nearest to it."""
    rows, free = [], list(found)
    for number, panel in enumerate(film.objects):
        true = np.array([pose_at(at_s, panel.pose, panel.path).centre_m for at_s in time_s])
        there = np.array(time_s) > (panel.appears_s or 0.0)
        way = (true[-1] - true[0]) / (time_s[-1] - time_s[0])
        speed = float(np.linalg.norm(way))
        row: dict[str, Any] = {"object": number, "objects": len(film.objects), "speed": speed, "found": False}
        rows.append(row)
        off = [np.nanmedian(_off_m(each, true)[0][there]) if _seen(each)[there].any() else np.inf for each in free]
        if not off or min(off) > SAME_M:
            continue
        one = free.pop(int(np.argmin(off)))
        seen = _seen(one) & there
        off_m, within = _off_m(one, true)
        velocity = np.stack([one[f"v{axis}_m_per_s"] for axis in "xyz"], axis=1)
        errors = np.stack([one[f"v{axis}_error_m_per_s"] for axis in "xyz"], axis=1)
        known = seen & np.isfinite(velocity).all(axis=1)
        wrong = np.linalg.norm(velocity - way, axis=1)
        row |= {
            "found": True, "seen": float(seen.sum() / there.sum()), "off_m": off_m[seen].tolist(),
            "velocity_off": (wrong[known] / speed).tolist(),
            "within": within[seen].mean(axis=1).tolist() if "appears" not in one else [],
            "velocity_within": (np.abs(velocity - way) < 1.645 * errors)[known].mean(axis=1).tolist(),
        }  # fmt: skip
        if panel.appears_s:
            first = one["appears"] if "appears" in one else np.flatnonzero(_seen(one))
            row["appears_off"] = int(first[0]) - int(np.flatnonzero(there)[0])
    return rows


def _seen(one: dict[str, Floats]) -> npt.NDArray[np.bool_]:
    return np.isfinite(one["x_m"])


def _off_m(one: dict[str, Floats], true: Floats) -> tuple[Floats, npt.NDArray[np.bool_]]:
    """Distances (F,), and whether each coordinate lies within its 90 % interval (F, 3)."""
    off = np.stack([one[f"{axis}_m"] for axis in "xyz"], axis=1) - true
    errors = np.stack([one[f"{axis}_error_m"] for axis in "xyz"], axis=1)
    return np.linalg.norm(off, axis=1), np.abs(off) < 1.645 * errors


def page(rows: list[dict[str, Any]]) -> str:
    """Medians over all frames of all objects found."""
    lines = [
        "# Objects in films, measured", "",
        "Made by `python -m studies.tracking docs/tracking.md`, which says what is drawn: panels of 20 cm at 0.2 to",
        "1 m/s, 16 x 16 points of 0.4 ms a frame, mean peaks of 1 to 5 counts; NANO's pictures.",
        "Wanted: within 1 cm and 10 % in the median, appearing within two frames, in 90 % intervals 90 % of the time.",
        "",
        "| pictures | objects | found | position off | velocity off | in 90 % interval | of velocity | appears off |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]  # fmt: skip
    for name, made in WAYS.items():
        for count, words in ((1, "one"), (2, "two apart"), (0, "all")):
            some = [row for row in rows if row["pictures"] == name and count in (0, row["objects"])]
            good = [row for row in some if row["found"]]
            if not good:
                continue
            off, way, inside, way_inside = (
                np.concatenate([row[each] for row in good])
                for each in ("off_m", "velocity_off", "within", "velocity_within")
            )
            late = [row["appears_off"] for row in good if "appears_off" in row]
            shown = f"{np.median(np.abs(late)):.0f} frames, most {max(map(abs, late))}" if late else ""
            lines.append(
                f"| {made} | {words} | {len(good)} of {len(some)} | "
                f"{100 * np.median(off):.1f} cm | {100 * np.median(way):.0f} % | "
                f"{f'{100 * inside.mean():.0f} %' if len(inside) else 'not told'} | "
                f"{100 * way_inside.mean():.0f} % | {shown} |"
            )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    run(measured, SCENES, page)
