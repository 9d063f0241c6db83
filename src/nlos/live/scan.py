"""A scan watched while it runs: one thread follows the file, another turns what is there into pictures.

Both only read the recording, in a process of their own: nothing here can slow or lose an acquisition. When pictures
take longer than samples come, pictures are left out - and counted -, never samples.

Where the bench's constants are known, pictures in passing are of samples corrected one by one as they came. When the
last sample is in, the last picture is that of the finished recording.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.acquisition.scanning.gathering import Gathering
    from nlos.calibration.constants import BenchConstants
    from nlos.live.calibration import SampleCalibration
    from nlos.loaded import LoadedScan
    from nlos.recon.live import LivePicture, LiveReconstruction


@dataclass
class LiveScan:
    """What is known so far. Fields are replaced, never changed in place, so that a reader needs no lock."""

    run: Path
    live: "LiveReconstruction"
    constants: Path | None = None
    every_fraction: float = 0.05
    """A new picture is due after this part of the plan's points ..."""
    every_s: float = 2.0
    """... or when this much time has passed with something new."""
    on_picture: Callable[["LivePicture"], None] | None = None
    patience_s: float = 60.0
    """How long the recording may take to appear."""
    gathering: "Gathering | None" = None
    picture: "LivePicture | None" = None
    pictures: int = 0
    skipped: int = 0
    """Pictures that were due while another was being made."""
    left_aside: int = 0
    """Samples that are damaged or unreadable; known at the end."""
    message: str = ""
    read: bool = False
    """Every sample of the scan is in."""
    over: bool = False
    """The scan has ended and its last picture is made."""
    error: Exception | None = None
    """Why the scan could not be followed to its end."""

    def start(self) -> None:
        """Follows and paints until the scan is over or `stop`."""
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._news = threading.Event()
        self._ended = threading.Event()
        self._growing = True
        self._constants: BenchConstants | None = None
        self._each: SampleCalibration | None = None
        self._pace = Pace()
        for target in (self._follow, self._paint):
            threading.Thread(target=target, daemon=True).start()

    @property
    def failed(self) -> bool:
        """Nothing could be followed: there is nothing to show, and there will not be."""
        return self.error is not None and self.gathering is None

    def stop(self) -> None:
        """Ends both threads after what they are at."""
        self._stopped.set()
        self._news.set()

    def wait(self) -> None:
        """Returns when the last picture is made. Raises what kept the scan from being followed to its end."""
        while not self._ended.wait(0.5):
            pass
        if self.error is not None:
            raise self.error
        if not (self.over or self._stopped.is_set()):
            from nlos.recon.errors import ReconstructionFailed

            raise ReconstructionFailed(f"{self.run}: the pictures broke off, see above. The samples are all there.")

    def _follow(self) -> None:
        from nlos.acquisition.errors import InvalidData, StorageError
        from nlos.acquisition.recording.follow import follow
        from nlos.acquisition.recording.recording import Recording
        from nlos.calibration.errors import CalibrationError

        try:
            for sample in follow(self.run, patience_s=self.patience_s):
                if self.gathering is None:
                    self._begin()
                assert self.gathering is not None
                with self._lock:
                    if self.gathering.add(sample) and self._each is not None:
                        self._each.add(sample)
                self._pace.saw(time.monotonic())
                self._news.set()
                if self._stopped.is_set():
                    return
            with Recording.open(self.run) as recording:
                self.left_aside = recording.left_aside()
        except (InvalidData, CalibrationError, StorageError, TimeoutError) as error:
            self.error = error
            self._say(str(error))
        finally:
            self.read = True
            self._news.set()

    def _begin(self) -> None:
        """Once the plan is known. Raises `ForeignConstants` for constants given that are of another bench."""
        from nlos.acquisition.recording.recording import Recording, Status
        from nlos.acquisition.scanning.gathering import Gathering
        from nlos.calibration.errors import CalibrationError
        from nlos.chain import constants_for
        from nlos.live.calibration import SampleCalibration

        with Recording.open(self.run) as recording:
            # Of a finished recording there is one picture, not one in passing.
            self._growing = recording.status is Status.RUNNING
            gathering = Gathering(recording.plan)
        scan = self._file = loaded(self.run, gathering)
        self._constants = constants_for(scan, self.constants)
        if self._constants is not None and self._growing and not scan.rectified:
            try:
                self._each = SampleCalibration(gathering.plan, self._constants)
            except CalibrationError as error:
                self._say(f"samples are not corrected one by one: {error}")
        self.gathering = gathering

    def _paint(self) -> None:
        painted, painted_s = 0, time.monotonic()
        try:
            while not self._stopped.is_set():
                self._news.wait(0.2)
                self._news.clear()
                last, count = self.read, len(self.gathering or ())
                if count == 0:
                    painted_s = time.monotonic()
                if self._is_due(count, painted, painted_s, last):
                    painted, painted_s = self._paint_next(painted), time.monotonic()
                if last and len(self.gathering or ()) <= painted:
                    self.over = True
                    return
        finally:
            self._ended.set()

    def _is_due(self, count: int, painted: int, painted_s: float, last: bool) -> bool:
        """Whether to make a picture now. One that would not be ready before the last sample is left to the last."""
        if last or self.gathering is None or not self._growing:
            return last and count > painted
        planned, now_s = len(self.gathering.plan), time.monotonic()
        late = count > painted and now_s - painted_s >= self.every_s
        due = count - painted >= self._step() or late
        return due and (painted == 0 or self._pace.left_s(planned - count, now_s) > 1.5 * self._pace.picture_s)

    def _step(self) -> int:
        assert self.gathering is not None
        return max(1, int(self.every_fraction * len(self.gathering.plan)))

    def _paint_next(self, painted: int) -> int:
        """Makes one picture of everything so far; returns of how many samples."""
        assert self.gathering is not None
        began_s = time.monotonic()
        count = self._picture()
        if self._growing:
            self.skipped += max(0, (count - painted) // self._step() - 1)
        self._pace.picture_s = time.monotonic() - began_s
        return count

    def _picture(self) -> int:
        """One picture of everything so far, of how many samples it returns."""
        from nlos.acquisition.errors import InvalidData as RecordingInvalid
        from nlos.calibration.errors import InvalidData
        from nlos.chain import calibrate_scan
        from nlos.recon.errors import ReconError

        assert self.gathering is not None
        with self._lock:
            count, scan = len(self.gathering), gathered(self._file, self.gathering)
            corrected = None if self._each is None or self.read else self._each.transient()
        try:
            transient = corrected or calibrate_scan(scan, constants=self._constants)
            picture = self.live.update(transient, count, scan.falloff)
            told = replace(picture.reconstruction, left_aside=self.left_aside)
            picture = replace(picture, reconstruction=told)
        except (InvalidData, RecordingInvalid, ReconError) as error:
            self._say(f"no picture of {count} points yet: {error}")
        else:
            self.picture, self.pictures, self.message = picture, self.pictures + 1, ""
            if self.on_picture is not None:
                self.on_picture(picture)
        return count

    def _say(self, message: str) -> None:
        self.message = message
        terminal.log(message)


class Pace:
    """How fast samples come, over the last seconds, and how long a picture takes."""

    OVER_S = 2.0

    def __init__(self) -> None:
        self._came_s: deque[float] = deque()
        self.picture_s = 0.0

    def saw(self, now_s: float) -> None:
        """One more sample."""
        self._came_s.append(now_s)
        while now_s - self._came_s[0] > self.OVER_S:
            self._came_s.popleft()

    def left_s(self, samples: int, now_s: float) -> float:
        """How long so many more take, at least; infinite while none come."""
        came_s = [at_s for at_s in tuple(self._came_s) if now_s - at_s <= self.OVER_S]
        return samples * (now_s - came_s[0]) / len(came_s) if came_s else math.inf


def loaded(run: Path, gathering: "Gathering") -> "LoadedScan":
    """What was gathered from `run`, as a file of just these samples would be loaded."""
    from nlos.acquisition.recording.recording import Recording
    from nlos.loaded import as_recorded

    with Recording.open(run) as recording:
        return as_recorded(recording, gathering.transient(), gathering.sync_count.copy(), gathering.total_count.copy())


def gathered(scan: "LoadedScan", gathering: "Gathering") -> "LoadedScan":
    """The same file once more samples are in, without opening it."""
    return replace(
        scan,
        transient=gathering.transient(),
        sync_count=gathering.sync_count.copy(),
        total_count=gathering.total_count.copy(),
    )
