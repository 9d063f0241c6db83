"""A film's pictures while it is scanned: made a core each, shown in order, the first as quickly as the later ones."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.errors import CalibrationError
from nlos.live.calibrated import Calibrated
from nlos.live.film import LiveFilm
from nlos.live.hurry import Hurry
from nlos.live.in_order import InOrder
from nlos.recon.errors import NO_PICTURE, ReconError
from nlos.recon.transport.fourier import on_one_core

if TYPE_CHECKING:
    from nlos.loaded import LoadedScan
    from nlos.recon.live import LivePicture, LiveReconstruction
    from nlos.recon.volume import Reconstruction

MOST_AT_A_TIME = 4
"""Pictures that are being made at most: with more, more than four frames would have passed before each."""
REHEARSED_BY = 0.06
"""Of the points of the first whole scan: with these pictures are made that nobody is shown; where they cannot be, with
twice as many."""
KEEPS_UP = 0.65
"""Of what all cores have of time for a frame: a picture that is made in that leaves enough to remember and to show."""


class FilmPictures:
    """Asked by one thread, the painter's; pictures are made and shown in others."""

    def __init__(
        self, film: LiveFilm, lives: "Sequence[LiveReconstruction]", cores: int, gathered: "Callable[[], LoadedScan]",
        freed: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        """Frames are aligned by what is `gathered`; the dropped ones are those without a picture by the last of
        `lives`. `freed` is called whenever a core is free again."""
        self._film, self._lives, self._gathered = film, lives, gathered
        self._cores = min(cores, MOST_AT_A_TIME)
        self._aside, self._hurry = InOrder(self._cores, freed), Hurry()
        self._rehearsed, self._rehearsed_by = False, REHEARSED_BY
        self._ready = False
        self._built_for: TimeAxis | None = None

    @property
    def full(self) -> bool:
        """Whether every core has a picture to make. Raises what making or showing one has raised."""
        return self._aside.full

    def watch(self) -> None:
        """While no picture is due, or every core makes one: what comes is remembered, and what the first pictures will
        need is got ready. What is wrong with it the next picture will say."""
        with on_one_core(), suppress(CalibrationError, *NO_PICTURE):
            if self._film.can_be_aligned:
                if self._film.waiting:
                    self._film.watch(self._gathered, 0 if self.full else None)
                if not self._ready:
                    self._get_ready(self._film.calibrated(False, self._gathered))
                    self._ready = True
            elif not self._rehearsed and self._film.share_of_whole_scan >= self._rehearsed_by:
                self._rehearsed_by *= 2
                self._get_ready(self._film.by_now().calibrated(False, self._gathered))

    def begin(
        self, live: "LiveReconstruction", known: Calibrated, frame_s: float,
        show: "Callable[[LivePicture], None]", failed: Callable[[Exception], None],
    ) -> None:  # fmt: skip
        """The picture of one frame; frames come every `frame_s`. One of the two is called once the pictures that were
        begun before are shown. Raises what building a method raises."""
        self._ready = True
        with on_one_core():
            self._build_for(known)
        light = known.of_film
        assert light is not None
        hurried = live is self._lives[-1] and self._hurry.next()

        def make() -> "tuple[Reconstruction | ReconError | InvalidData, float]":
            began_s = time.monotonic()
            try:
                return live.made_of_film(light, known.falloff, hurried), time.monotonic() - began_s
            except NO_PICTURE as error:
                return error, 0.0

        def shown(made: "tuple[Reconstruction | ReconError | InvalidData, float]") -> None:
            result, took_s = made
            if isinstance(result, ReconError | InvalidData):
                failed(result)
                return
            picture = live.judged_of_film(light, result, known.samples)
            if live is self._lives[-1]:
                dropped = self._film.shown(picture.reconstruction, known.frame)
                self._hurry.shown(dropped, hurried, took_s < KEEPS_UP * frame_s * self._cores)
            show(picture)

        self._aside.begin(make, shown)

    def finish(self) -> None:
        """Returns when all are shown. Raises what making or showing one has raised."""
        self._aside.finish()

    def stop(self) -> None:
        """The same, whatever they raise; nothing can be begun any more."""
        self._aside.stop()

    def _get_ready(self, known: Calibrated) -> None:
        self._build_for(known)
        if not self._rehearsed:
            self._rehearsed = True
            self._rehearse(known)

    def _build_for(self, known: Calibrated) -> None:
        """What pictures of such a frame need, unless that is built."""
        if known.of_film is None or known.of_film.light.time == self._built_for:
            return
        for live in self._lives:
            for hurried in (False, True):
                live.get_ready_for_film(known.of_film, known.falloff, hurried)
        self._built_for = known.of_film.light.time

    def _rehearse(self, known: Calibrated) -> None:
        """A picture of each kind in every thread, of the points that have come: what is used for the first time takes
        its time then, and every thread asks for its memory."""
        light = known.of_film
        assert light is not None

        def make() -> None:
            for live in self._lives:
                for hurried in (False, True) if live.can_hurry(light) else (False,):
                    alone = live.anew()
                    with suppress(*NO_PICTURE):
                        made = alone.made_of_film(light, known.falloff, hurried)
                        alone.judged_of_film(light, made, known.samples)

        for _ in range(self._cores):
            self._aside.begin(make, lambda nothing: None)
