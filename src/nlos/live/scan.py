"""A scan watched while it runs: one thread follows the file, another turns what is there into pictures.

Both only read the recording, in a process of their own: nothing here can slow or lose an acquisition. The follower's
thread has the only handle; everybody else asks for what it has seen. When pictures take longer than samples come,
pictures are skipped - and counted -, never samples.

Where the bench's constants are known, pictures in passing are of samples corrected one by one as they came. When the
last sample is in, what is being made is given up, and the last picture is that of the finished recording.
"""

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.follow import follow
from nlos.acquisition.recording.recording import Recording, Status
from nlos.calibration.errors import CalibrationError
from nlos.calibration.errors import InvalidData as InvalidCalibration
from nlos.cli.escaped import escaped
from nlos.cli.terminal import terminal
from nlos.live.calibrated import Calibrated
from nlos.live.file_seen import Seen
from nlos.live.film_pictures import FilmPictures
from nlos.live.gathered import Gathered, nothing_yet
from nlos.live.overtaken import Overtaken, given_up_once
from nlos.live.rehearsal import get_ready, get_ready_for_last
from nlos.live.schedule import Coming, Schedule
from nlos.recon.errors import NO_PICTURE, ReconstructionFailed
from nlos.recon.transport.fourier import on_one_core, threads
from nlos.response import AUTO, ResponseWanted

if TYPE_CHECKING:
    from nlos.live.time_zero import TimeZero
    from nlos.recon.live import LivePicture, LiveReconstruction

Tell = Callable[["LivePicture"], None]


@dataclass
class LiveScan:
    """What is known so far. Fields are replaced, never changed in place, so that a reader needs no lock."""

    run: Path
    lives: "Sequence[LiveReconstruction]"
    """The quickest method first: its picture comes first, and the others' replace it."""
    constants: Path | None = None
    response: ResponseWanted = AUTO
    adds_up: bool = False
    """Of a film every picture is of all frames so far, not of the newest visit to every point."""
    first_fraction: float = 0.05
    """Of which part of the plan's points the first picture is."""
    on_picture: Tell | None = None
    """Called with every picture by the last of the methods."""
    on_explained: Tell | None = None
    """Called with the same picture once it is known how much light it explains."""
    patience_s: float = 60.0
    """How long the recording may take to appear."""
    begun: bool = False
    """It has been there already."""
    seen: Seen | None = None
    gathered: Gathered | None = None
    latest: dict[str, "LivePicture"] = field(default_factory=dict)
    """Method -> its newest picture."""
    pictures: int = 0
    coming: Coming | None = None
    left_aside: int = 0
    """Samples that are damaged or unreadable; known at the end."""
    message: str = ""
    read: bool = False
    """Every sample of the scan is in."""
    over: bool = False
    """The scan has ended and its last picture is made."""
    broke_off: bool = False
    """The pictures ended before the scan, by a fault of ours: what is shown stays, and no more comes."""
    error: Exception | None = None
    """Why the scan could not be followed to its end."""
    no_picture: Exception | None = None
    """Why the newest samples have none."""
    not_kept: OSError | None = None
    """Why the newest picture could not be told: a disk that is full, say. The next one may be."""

    def __post_init__(self) -> None:
        self._stopped, self._news, self._ended = threading.Event(), threading.Event(), threading.Event()
        self._calibrated: Calibrated | None = None
        self._film: FilmPictures | None = None
        self._schedule = Schedule([live.method for live in self.lives], self.first_fraction)
        self._threads = [threading.Thread(target=target, daemon=True) for target in (self._follow, self._paint)]

    def start(self) -> None:
        """Follows and paints until the scan is over or `stop`."""
        for thread in self._threads:
            thread.start()

    @property
    def skipped(self) -> int:
        """Pictures that were due while another was being made."""
        return self._schedule.skipped

    @property
    def picture(self) -> "LivePicture | None":
        """The newest picture of the last method."""
        return self.latest.get(self.lives[-1].method)

    @property
    def failed(self) -> bool:
        """Nothing could be followed: there is nothing to show, and there will not be."""
        return self.error is not None and self.gathered is None

    def stop(self, wait_s: float = 0.0) -> None:
        """Ends both threads after what they are at, and waits for that."""
        self._stopped.set()
        self._news.set()
        for thread in self._threads:
            thread.join(wait_s)

    def wait(self) -> None:
        """Returns when the last picture is made. Raises what kept the scan from being followed to its end."""
        while not self._ended.wait(0.5):
            pass
        for why in (self.error, self.not_kept):
            if why is not None:
                raise why
        if not (self.over or self._stopped.is_set()):
            raise ReconstructionFailed(f"{self.run}: the pictures stopped early, see above. The samples are complete.")

    @property
    def zero(self) -> "TimeZero | None":
        """When direct light arrives, as the newest picture has it."""
        return self._calibrated.zero if self._calibrated is not None else None

    def _follow(self) -> None:
        try:
            for sample in follow(self.run, patience_s=self.patience_s, begun=self.begun, look=self._look):
                assert self.gathered is not None
                over = self.gathered.frames_over
                self.gathered.add(sample)
                self._schedule.pace.saw(time.monotonic())
                if self.gathered.film is None or self.gathered.frames_over > over:
                    self._news.set()  # of a film nothing is due in between, and to wake the painter takes time
                if self._stopped.is_set():
                    return
        except (InvalidData, CalibrationError, StorageError, OSError) as error:
            self.error = error
            self._say(str(error))
        finally:
            if self.gathered is not None:
                self.gathered.finish()
            self.read = True
            self._news.set()

    def _look(self, recording: "Recording") -> None:
        """In the follower's thread. Raises `ForeignConstants` for constants given that are of another bench."""
        if self.gathered is None:
            if not self.adds_up:
                self._schedule.follow_frames(recording.plan)
            self.gathered = nothing_yet(recording, self.constants, self.response, self.adds_up, self._say)
        if recording.status is not Status.RUNNING and (len(self.gathered.samples) or not len(recording)):
            self.left_aside = recording.left_aside()
        self.seen = Seen.of(recording)

    def _paint(self) -> None:
        ready = False
        try:
            get_ready(self.lives)
            while not self._stopped.is_set():
                self._news.wait(0.2)
                self._news.clear()
                last, held = self.read, self.gathered
                count, planned = (0, 0) if held is None else (len(held), held.planned)
                growing = held is None or held.growing
                film = self._film_pictures(held)
                if film is not None and last:
                    film.finish()
                if film is not None and film.full:
                    film.watch()
                    continue
                due = self._schedule.due(count, planned, growing, last)
                if due is not None and held is not None:
                    self._paint_next(next(live for live in self.lives if live.method == due), held, film)
                    if held.film is not None and held.film.waiting:
                        self._news.set()  # for the picture of one that has waited
                elif last and self._schedule.done(0 if held is None else len(held)):
                    self.over = True
                    return
                elif film is not None:
                    film.watch()
                elif held is not None and not ready and self._schedule.ending(count, planned, growing):
                    ready = True
                    get_ready_for_last(self.lives, held, lambda: self.read)
                self.coming = self._schedule.coming(count, planned, growing, last) if planned else None
        finally:
            if self._film is not None:
                self._film.stop()
            self.coming = None
            if not (self.over or self._stopped.is_set()):
                self.broke_off = True
                self._say(f"{self.run.name}: the pictures stopped because of a bug. The scan and its samples are safe")
            self._ended.set()

    def _paint_next(self, live: "LiveReconstruction", held: Gathered, film: FilmPictures | None) -> None:
        self.coming = Coming(live.method, len(held), True, self._schedule.pace.picture_s(live.method) or None)
        with suppress(Overtaken):
            if film is not None and not self.read:
                self._begin_frame(live, held, film, time.monotonic())
            else:
                self._picture(live, held, len(held), time.monotonic())

    def _begin_frame(self, live: "LiveReconstruction", held: Gathered, film: FilmPictures, began_s: float) -> None:
        """The newest frame's picture, made while the next one is waited for."""
        count = len(held)

        def show(picture: "LivePicture") -> None:
            named = replace(picture, reconstruction=replace(picture.reconstruction, scan=escaped(self.run.name)))
            self._shown(live, named, began_s)

        def failed(error: Exception) -> None:
            self._no_picture(live, held, count, began_s, error)

        try:
            with on_one_core():
                known = self._light_for(live, held, count)
            if known.whole:
                return  # the last one is made when those before it are shown
            count = known.samples
            film.begin(live, known, self._schedule.frame_s(), show, failed)
        except (InvalidCalibration, *NO_PICTURE) as error:
            self._no_picture(live, held, count, began_s, error)
            return
        self._schedule.begun(live.method, count, held.planned, held.growing)

    def _picture(self, live: "LiveReconstruction", held: Gathered, count: int, began_s: float) -> None:
        """One picture of `count` samples: a slower method's is of those of the quickest one's."""
        try:
            known = self._light_for(live, held, count)
            count = known.samples
            if held.film is None or known.of_film is None:
                with given_up_once(lambda: self.read and not known.whole):
                    picture = live.update(known.transient, count, known.falloff)
            else:
                picture = live.of_film(known.of_film, count, known.falloff)
                if live is self.lives[-1]:
                    held.film.shown(picture.reconstruction, known.frame)
            told = replace(picture.reconstruction, left_aside=self.left_aside, scan=escaped(self.run.name))
            picture = replace(picture, reconstruction=told)
        except (InvalidCalibration, *NO_PICTURE) as error:
            self._no_picture(live, held, count, began_s, error)
            return
        self._schedule.begun(live.method, count, held.planned, held.growing)
        self._shown(live, picture, began_s)
        if known.of_film is None or known.whole:  # after the picture, which nobody should have to wait for
            with given_up_once(lambda: self.read and not known.whole):
                self._show(live, live.explained(picture, known.transient, known.falloff), self.on_explained)

    def _no_picture(self, live: "LiveReconstruction", of: Gathered, count: int, began_s: float, why: Exception) -> None:
        self._say(f"no picture of {count} points yet: {why}")
        self.no_picture = why
        self._schedule.made(live.method, count, of.planned, time.monotonic() - began_s, of.growing)

    def _shown(self, live: "LiveReconstruction", picture: "LivePicture", began_s: float) -> None:
        self.message, self.no_picture = "", None
        self._show(live, picture, self.on_picture)
        self.pictures += 1  # whoever waits for that finds the picture
        self._schedule.pace.took(live.method, time.monotonic() - began_s)
        self.coming = None

    def _film_pictures(self, held: Gathered | None) -> FilmPictures | None:
        """Those of a film that is under way; else None."""
        if self._film is None and held is not None and held.film is not None and held.growing:
            self._film = FilmPictures(held.film, self.lives, threads(), held.so_far, self._news.set)
        return self._film

    def _light_for(self, live: "LiveReconstruction", held: Gathered, count: int) -> Calibrated:
        """What the picture before was made from, unless this method has had it, or it is to be of what is new."""
        known, had = self._calibrated, self._schedule.of(live.method)
        fresh = live is self.lives[0] or self.read
        if known is None or known.whole != self.read or known.samples < max(had + 1, count if fresh else 0):
            known = self._calibrated = held.calibrated(self.read)
        return known

    def _show(self, live: "LiveReconstruction", picture: "LivePicture", tell: Tell | None) -> None:
        self.latest = {**self.latest, live.method: picture}
        if tell is None or live is not self.lives[-1]:
            return
        try:
            tell(picture)
            self.not_kept = None
        except OSError as error:
            self.not_kept = error
            self._say(str(error))

    def _say(self, message: str) -> None:
        self.message = message
        terminal.log(message)
