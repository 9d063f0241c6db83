"""A scan watched while it runs: one thread follows the file, another turns what is there into pictures.

Both only read the recording, in a process of their own: nothing here can slow or lose an acquisition. The follower's
thread has the only handle; everybody else asks for what it has seen. When pictures take longer than samples come,
pictures are skipped - and counted -, never samples.

Where the bench's constants are known, pictures in passing are of samples corrected one by one as they came. When the
last sample is in, what is being made is given up, and the last picture is that of the finished recording.
"""

import threading
import time
from collections import deque
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
from nlos.chain import constants_for
from nlos.cli.terminal import terminal
from nlos.live.calibrated import Calibrated, calibrated
from nlos.live.calibration import SampleCalibration
from nlos.live.file_seen import Seen
from nlos.live.film import LiveFilm
from nlos.live.overtaken import Overtaken, given_up_once
from nlos.live.rehearsal import get_ready
from nlos.live.schedule import Coming, Schedule
from nlos.live.so_far import empty_scan, gathering_for, scan_of, shown_of
from nlos.recon.errors import ReconError, ReconstructionFailed
from nlos.response import AUTO, ResponseWanted, with_response
from nlos.said_once import SaidOnce

if TYPE_CHECKING:
    from nlos.acquisition.scanning.free_points import FreePoints
    from nlos.acquisition.scanning.gathering import Gathering
    from nlos.calibration.constants import BenchConstants
    from nlos.live.time_zero import TimeZero
    from nlos.loaded import LoadedScan
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
    seen: Seen | None = None
    gathering: "Gathering | FreePoints | None" = None
    lock: threading.Lock = field(default_factory=threading.Lock)
    """Held while a sample is added."""
    latest: dict[str, "LivePicture"] = field(default_factory=dict)
    """Method -> its newest picture."""
    pictures: int = 0
    coming: Coming | None = None
    left_aside: int = 0
    """Samples that are damaged or unreadable; known at the end."""
    message: str = ""
    recent: "deque[tuple[int, float]]" = field(default_factory=lambda: deque(maxlen=64))
    """Detections and live time of the newest samples."""
    elapsed_s: float = 0.0
    """Bench time from the scan's start to the end of the last sample."""
    read: bool = False
    """Every sample of the scan is in."""
    over: bool = False
    """The scan has ended and its last picture is made."""
    broke_off: bool = False
    """The pictures ended before the scan, by a fault of ours: what is shown stays, and no more comes."""
    error: Exception | None = None
    """Why the scan could not be followed to its end."""

    def __post_init__(self) -> None:
        self._stopped, self._news, self._ended = threading.Event(), threading.Event(), threading.Event()
        self._growing, self._tell = True, SaidOnce()
        self._empty: LoadedScan | None = None
        self._constants: BenchConstants | None = None
        self._each: SampleCalibration | None = None
        self._calibrated: Calibrated | None = None
        self.film: LiveFilm | None = None
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
        return self.error is not None and self.gathering is None

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
        if self.error is not None:
            raise self.error
        if not (self.over or self._stopped.is_set()):
            raise ReconstructionFailed(f"{self.run}: the pictures stopped early, see above. The samples are complete.")

    @property
    def zero(self) -> "TimeZero | None":
        """When direct light arrives, as the newest picture has it."""
        return self._calibrated.zero if self._calibrated is not None else None

    def calibrated(self, scan: "LoadedScan") -> "Calibrated":
        """What `reconstruct` would work on. Raises what calibrating raises."""
        assert self.gathering is not None
        return calibrated(scan, len(self.gathering), self.read, self._constants, self.response, self._tell)

    @property
    def empty(self) -> "LoadedScan":
        """The file as a scan without samples; once `seen`."""
        assert self._empty is not None
        return self._empty

    def _follow(self) -> None:
        try:
            for sample in follow(self.run, patience_s=self.patience_s, look=self._look):
                assert self.gathering is not None
                with self.lock:
                    if self.gathering.add(sample):
                        if self._each is not None:
                            self._each.add(sample)
                        if self.film is not None:
                            self.film.add(sample)
                    self.recent.append((sample.histogram.total_count, sample.histogram.live_time_s))
                    self.elapsed_s = max(self.elapsed_s, sample.taken_s + sample.histogram.live_time_s)
                self._schedule.pace.saw(time.monotonic())
                self._news.set()
                if self._stopped.is_set():
                    return
        except (InvalidData, CalibrationError, StorageError, TimeoutError) as error:
            self.error = error
            self._say(str(error))
        finally:
            if self.film is not None:
                self.film.finish()
            self.read = True
            self._news.set()

    def _look(self, recording: "Recording") -> None:
        """In the follower's thread. Raises `ForeignConstants` for constants given that are of another bench."""
        if self.gathering is None:
            self._begin(recording)
        if recording.status is not Status.RUNNING and (len(self.gathering or ()) or not len(recording)):
            self.left_aside = recording.left_aside()
        self.seen = Seen.of(recording)

    def _begin(self, recording: "Recording") -> None:
        # Of a finished recording there is one picture, not one in passing.
        self._growing = recording.status is Status.RUNNING
        self._empty = empty = empty_scan(recording)
        self._constants = constants_for(empty, self.constants)
        single = recording.on_grid and (self.adds_up or recording.plan.frames == 1)
        if self._growing and single and not empty.rectified:
            self._each = SampleCalibration.where_known(recording.plan, self._constants, self._say)
        if not self.adds_up:
            self._schedule.follow_frames(recording.plan)
            if recording.plan.frames > 1 and recording.on_grid and not empty.rectified:
                self.film = LiveFilm(recording.plan, self._constants, self.response)
        self.gathering = gathering_for(recording.plan) if self.adds_up else shown_of(recording.plan)

    def _paint(self) -> None:
        try:
            get_ready(self.lives)
            while not self._stopped.is_set():
                self._news.wait(0.2)
                self._news.clear()
                last = self.read
                count, planned = self._count, self._planned
                due = self._schedule.due(count, planned, self._growing, last)
                if due is not None:
                    self._paint_next(next(live for live in self.lives if live.method == due), count)
                elif last and self._schedule.done(self._count):
                    self.over = True
                    return
                self.coming = self._schedule.coming(count, planned, self._growing, last) if planned else None
        finally:
            self.coming = None
            if not (self.over or self._stopped.is_set()):
                self.broke_off = True
                self._say(
                    f"{self.run.name}: the pictures stopped because of a bug. The scan and its samples are not affected"
                )
            self._ended.set()

    @property
    def _count(self) -> int:
        """Samples that there may be a picture of: of a film those up to the end of its newest frame."""
        return len(self.gathering or ()) if self.film is None else self.film.samples

    @property
    def _planned(self) -> int:
        return 0 if self.gathering is None else len(self.gathering.plan)

    def _paint_next(self, live: "LiveReconstruction", count: int) -> None:
        began_s, expected_s = time.monotonic(), self._schedule.pace.picture_s(live.method)
        self.coming = Coming(live.method, count, True, expected_s or None)
        with suppress(Overtaken):
            count = self._picture(live, count, self._schedule.of(live.method))
            self._schedule.made(live.method, count, self._planned, time.monotonic() - began_s, self._growing)

    def _picture(self, live: "LiveReconstruction", count: int, painted: int) -> int:
        """One picture, of how many samples it returns: a slower method's of those of the quickest one's."""
        known = self._calibrated
        fresh = live is self.lives[0] or self.read
        try:
            if (
                known is None
                or known.whole != self.read
                or known.samples <= painted
                or (fresh and known.samples < count)
            ):
                known = self._calibrated = self._calibrate()
            count = known.samples
            if self.film is None or known.of_film is None:
                with given_up_once(lambda: self.read and not known.whole):
                    picture = live.update(known.transient, count, known.falloff)
            else:
                picture = live.of_film(known.of_film, count, known.falloff)
                if live is self.lives[-1]:
                    self.film.shown(picture.reconstruction)
            told = replace(picture.reconstruction, left_aside=self.left_aside, scan=self.run.name)
            picture = replace(picture, reconstruction=told)
        except (InvalidCalibration, InvalidData, ReconError) as error:
            self._say(f"no picture of {count} points yet: {error}")
            return count
        self.pictures, self.message = self.pictures + 1, ""
        self._show(live, picture, self.on_picture)
        self.coming = None
        if self.film is None or known.of_film is None:  # after the picture, which nobody should have to wait for
            with given_up_once(lambda: self.read and not known.whole):
                self._show(live, live.explained(picture, known.transient, known.falloff), self.on_explained)
        return count

    def _show(self, live: "LiveReconstruction", picture: "LivePicture", tell: Tell | None) -> None:
        self.latest = {**self.latest, live.method: picture}
        if tell is not None and live is self.lives[-1]:
            tell(picture)

    def _calibrate(self) -> "Calibrated":
        assert self.gathering is not None
        whole = self.read
        if self.film is not None:
            return self.film.calibrated(self.read, self.gathered)
        with self.lock:
            count, scan = len(self.gathering), scan_of(self.empty, self.gathering)
            corrected = None if self._each is None or whole else with_response(self._each.transient(), self.response)
        if corrected is None or self._each is None:
            return calibrated(scan, count, whole, self._constants, self.response, self._tell)
        return Calibrated(count, whole, corrected, scan.falloff, self._each.zero)

    def gathered(self) -> "LoadedScan":
        assert self.gathering is not None
        with self.lock:
            return scan_of(self.empty, self.gathering)

    def _say(self, message: str) -> None:
        self.message = message
        terminal.log(message)
