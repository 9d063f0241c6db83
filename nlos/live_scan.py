"""A scan watched while it runs: one thread follows the file, another turns what is there into pictures.

Both only read the recording, in a process of their own: nothing here can slow or lose an acquisition. When pictures
take longer than samples come, pictures are left out - and counted -, never samples.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.terminal import terminal

if TYPE_CHECKING:
    from acquisition.gathering import Gathering
    from nlos.chain import LoadedScan
    from recon.live import LivePicture, LiveReconstruction


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
        for target in (self._follow, self._paint):
            threading.Thread(target=target, daemon=True).start()

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

    def scan(self) -> "LoadedScan":
        """All samples so far, as read from a file. Raises `InvalidData` where there are none."""
        from acquisition.errors import InvalidData

        if self.gathering is None:
            raise InvalidData(f"{self.run}: no sample yet")
        with self._lock:
            return loaded(self.run, self.gathering)

    def _follow(self) -> None:
        from acquisition.errors import InvalidData, StorageError
        from acquisition.follow import follow
        from acquisition.gathering import Gathering
        from acquisition.recording import Recording, Status

        try:
            for sample in follow(self.run, patience_s=self.patience_s):
                if self.gathering is None:
                    with Recording.open(self.run) as recording:
                        # Of a finished recording there is one picture, not one in passing.
                        self._growing = recording.status is Status.RUNNING
                        self.gathering = Gathering(recording.plan)
                with self._lock:
                    self.gathering.add(sample)
                self._news.set()
                if self._stopped.is_set():
                    return
        except (InvalidData, StorageError, TimeoutError) as error:
            self.error = error
            self._say(str(error))
        finally:
            self.read = True
            self._news.set()

    def _paint(self) -> None:
        painted, painted_s = 0, time.monotonic()
        try:
            while not self._stopped.is_set():
                self._news.wait(0.2)
                self._news.clear()
                last, count = self.read, len(self.gathering or ())
                step = max(1, int(self.every_fraction * len(self.gathering.plan))) if self.gathering else 1
                late = count > painted and time.monotonic() - painted_s >= self.every_s
                if (self._growing and (count - painted >= step or late)) or (last and count > painted):
                    if self._growing:
                        self.skipped += max(0, (count - painted) // step - 1)
                    painted, painted_s = self._picture(), time.monotonic()
                if last and len(self.gathering or ()) <= painted:
                    self.over = True
                    return
        finally:
            self._ended.set()

    def _picture(self) -> int:
        """Makes one picture of everything so far; returns of how many samples."""
        from acquisition.errors import InvalidData as RecordingInvalid
        from calibration.errors import InvalidData
        from nlos.chain import calibrate_scan, constants_for
        from recon.errors import ReconError

        assert self.gathering is not None
        with self._lock:
            count, scan = len(self.gathering), loaded(self.run, self.gathering)
        try:
            transient = calibrate_scan(scan, constants=constants_for(scan, self.constants))
            picture = self.live.update(transient, count, scan.falloff)
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


def loaded(run: Path, gathering: "Gathering") -> "LoadedScan":
    """What was gathered from `run`, as a file of just these samples would be loaded."""
    from acquisition.recording import Recording
    from nlos.chain import as_recorded

    with Recording.open(run) as recording:
        return as_recorded(recording, gathering.transient(), gathering.sync_count.copy(), gathering.total_count.copy())
