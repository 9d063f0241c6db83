"""The steps of a finished scan's slider: its twentieths; of a film its frames, as they were shown while it was live."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.calibration.errors import InvalidData
from nlos.live.so_far import scan_of, shown_of

if TYPE_CHECKING:
    from nlos.acquisition.sample import Sample
    from nlos.live.film import LiveFilm
    from nlos.live.gathered import Gathered
    from nlos.recon.live import LivePicture, LiveReconstruction

FRAMES = 20
"""Steps of a scan that is no film."""
MOST_OF_FILM = 100
"""Steps of a film at most: of a longer one as many of its frames, evenly spread."""
REMEMBERED = 24
"""Frames before a step whose light its picture may hold: those in between steps that are farther are passed over."""


@dataclass(frozen=True)
class Step:
    """One place of the slider, valid until the next one is asked for."""

    samples: int
    rates_hz: npt.NDArray[np.float32]
    """At every place, as they were then."""
    picture: "Callable[[LiveReconstruction], LivePicture]"
    """Raises what calibrating and reconstructing raise."""
    told: Callable[[], dict[str, Any]] = dict
    """What else is to be said of the picture, once it is made."""


def film_frames(count: int) -> list[int]:
    """The frames of a film of `count` that the slider shows; the last one is always there."""
    steps = min(count, MOST_OF_FILM)
    return [round((k + 1) * count / steps) - 1 for k in range(steps)]


def steps_of_scan(held: "Gathered", samples: "Iterator[Sample]") -> Iterator[Step]:
    """Step k is the scan after (k + 1) / `FRAMES` of its samples."""
    total = len(held.samples)
    cuts = [max(1, round((k + 1) / FRAMES * total)) for k in range(FRAMES)]
    gathering, step = shown_of(held.samples.plan), 0

    def picture(live: "LiveReconstruction") -> "LivePicture":
        so_far = scan_of(held.empty, gathering)
        transient = held.calibrated_part(so_far).transient
        return live.explained(live.update(transient, len(gathering), so_far.falloff), transient, so_far.falloff)

    for sample in samples:
        gathering.add(sample)
        while step < FRAMES and len(gathering) == cuts[step]:
            yield Step(cuts[step], gathering.place_rates_hz(), picture)
            step += 1


def steps_of_film(held: "Gathered", samples: "Iterator[Sample]", frames: Sequence[int]) -> Iterator[Step]:
    """Step k is frame `frames[k]` with its memory of those before it: by the same code as while it was live, with no
    frame dropped."""
    assert held.film is not None
    film, gathering, step = held.film.again(), shown_of(held.samples.plan), 0
    for sample in samples:
        gathering.add(sample)
        film.add(sample)
        while step < len(frames) and film.over >= frames[step]:
            yield _frame(held, film, film.samples, gathering.place_rates_hz())
            step += 1
        if film.waiting and step < len(frames) and frames[step] - film.over <= REMEMBERED:
            with suppress(InvalidData):  # the picture will say it
                film.watch(held.so_far)
    film.finish()
    for _ in frames[step:]:
        yield _frame(held, film, film.samples, gathering.place_rates_hz())


def _frame(held: "Gathered", film: "LiveFilm", samples: int, rates_hz: npt.NDArray[np.float32]) -> Step:
    def picture(live: "LiveReconstruction") -> "LivePicture":
        known = film.calibrated(True, held.so_far)
        assert known.of_film is not None
        made = live.of_film(known.of_film, known.samples, known.falloff)
        film.shown(made.reconstruction, known.frame)
        return live.explained(made, known.transient, known.falloff)

    def told() -> dict[str, Any]:
        frame, time_s = film.newest
        return {"of_film": {"frame": frame, "time_s": time_s, "objects": film.trails.told}}

    return Step(samples, rates_hz, picture, told)
