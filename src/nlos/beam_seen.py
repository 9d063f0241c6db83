"""Where somebody saw this bench's beam: kept by the bench's name, and told before every plan and scan.

No arrival time tells a scanner that stands aside, a reversed axis, or two that are swapped before a wall that faces it.
"""

import json
import logging
import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from nlos.acquisition.planning.aim import Aiming
from nlos.calibration.bench_facts import INSTRUMENTS, REAL, SIMULATED, changes, facts_of
from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry_fit import Spots
from nlos.calibration.spots_sense import check_sense, span_the_wall
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.file_word import own_word
from nlos.drivers.state_folder import state_folder
from nlos.whole_file import whole_file

RULER_M = 0.02
"""What nobody's ruler is off by."""
FAR_PART = 0.03
"""Of the wall's distance: a scan would be of another part of the wall."""
_LOOK = "`nlos doctor` asks, with light, where it lands at three places; three marks in `nlos jog` tell as well"
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class BeamJudged:
    """What eyes say of where scans land. `wrong`: they land elsewhere; `warning`: nobody knows, or not well enough."""

    wrong: str = ""
    warning: str = ""


def keep_beam_seen(settings: BenchSettings, by: str, spots: Spots) -> None:
    """Keeps what was seen, `by` which verb, in place of what was seen before; spots on one line tell nothing."""
    if not span_the_wall(spots):
        return
    said = {
        "bench": settings.name,
        "by": by,
        "utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "facts": _facts(settings),
        "spots": np.column_stack([spots.x_rad, spots.y_rad, spots.x_m, spots.y_m]).tolist(),
    }
    path = _path(settings)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial:
            partial.write_text(json.dumps(said), "utf-8")
    except OSError as error:
        log.warning("%s: not written (%s): scans will say that nobody has seen the beam", path, error.strerror or error)


def judge_beam(settings: BenchSettings, aim: Aiming, by_spots: bool = False) -> BeamJudged:
    """What was seen of this bench, held against how scans are aimed. `by_spots`: measured spots made that aim."""
    if settings.simulation is not None and not settings.simulation.misalignment.model_dump(exclude_defaults=True):
        return BeamJudged()  # such a table is as its file draws it
    try:
        said = json.loads(_path(settings).read_text("utf-8"))
        spots = Spots(*np.array(said["spots"], np.float64).reshape(-1, 4).T)
        if not span_the_wall(spots):
            raise ValueError("these spots tell nothing")
        seen, then = f"seen by `nlos {said['by']}` on {str(said['utc'])[:10]}", dict(said["facts"])
        if then[INSTRUMENTS] != _kind(settings) or said.get("bench", settings.name) != settings.name:
            raise ValueError("this is of another bench")
    except (OSError, ValueError, KeyError, TypeError):
        if by_spots:
            return BeamJudged()
        rehearsed = "" if settings.simulated or not _path(settings, SIMULATED).exists() else (
            " (a rehearsal on the simulated bench of this name tells nothing of it)"
        )  # fmt: skip
        return BeamJudged(
            warning=f"nobody has seen where this bench's beam goes{rehearsed}: reversed or swapped axes, or a scanner "
            f"off to the side, change no arrival time but turn or shift the picture. {_LOOK}"
        )
    now = _facts(settings)
    if changed := [each for part in ("mirror", "simulation") for each in changes(_of(part, then), _of(part, now))]:
        text = f"the bench file has changed since its beam was {seen}: {'; '.join(changed)}. {_LOOK}"
        return BeamJudged() if by_spots else BeamJudged(warning=text)
    try:
        check_sense(spots)
    except InvalidData as error:
        return BeamJudged(wrong=f"{str(error).partition(';')[0]}, and run `nlos doctor` again ({seen})")
    return _judged_by_place(settings, aim, spots, seen, changes(_of("geometry", then), _of("geometry", now)))


def _judged_by_place(settings: BenchSettings, aim: Aiming, spots: Spots, seen: str, moved: "list[str]") -> BeamJudged:
    x_m, y_m = aim.wall_points(spots.x_rad, spots.y_rad)
    by_size = sorted(zip(spots.x_m - x_m, spots.y_m - y_m, strict=True), key=lambda each: math.hypot(*each))
    off_m = by_size[int(0.75 * (len(by_size) - 1))]  # a quarter of a long table may be mistyped
    if math.hypot(*off_m) <= RULER_M:
        return BeamJudged()
    text = f"the beam lands {off_m[0]:+.3f}, {off_m[1]:+.3f} m from where it is sent, {seen}"
    if moved:
        return BeamJudged(warning=f"{text}, before the bench file changed: {'; '.join(moved)}. {_LOOK}")
    text += ". Mark nine spots with `nlos jog`; `nlos calibrate --spots FILE` says where the scanner stands"
    far = math.hypot(*off_m) > FAR_PART * settings.geometry.wall_distance_m
    return BeamJudged(wrong=text) if far else BeamJudged(warning=text)


def _kind(settings: BenchSettings) -> str:
    return SIMULATED if settings.simulated else REAL


def _path(settings: BenchSettings, kind: str | None = None) -> Path:
    """A file for the real bench and one for the simulated one: a rehearsal replaces nothing that was seen."""
    ending = ".simulated.json" if (kind or _kind(settings)) == SIMULATED else ".json"
    return state_folder() / "beam_seen" / f"{own_word(settings.name)}{ending}"


def _facts(settings: BenchSettings) -> dict[str, object]:
    _, facts = facts_of(settings.model_dump_json())
    found = _of("mirror", facts) | _of("geometry", facts) | {INSTRUMENTS: _kind(settings)}
    if settings.simulation is not None:
        found["simulation.misalignment"] = settings.simulation.misalignment.model_dump_json(exclude_defaults=True)
    return found


def _of(part: str, facts: Mapping[str, object]) -> dict[str, object]:
    return {key: value for key, value in facts.items() if key.startswith(f"{part}.")}
