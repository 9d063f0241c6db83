"""A scan watched while it runs: one thread follows the file, another turns what is there into pictures.

Both only read the recording, in a process of their own: nothing here can slow or lose an acquisition. When pictures
take longer than samples come, pictures are left out - and counted -, never samples.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.terminal import terminal

if TYPE_CHECKING:
    from acquisition.plan import ScanPlan
    from acquisition.sample import Sample
    from recon.live import LivePicture, LiveReconstruction


@dataclass
class LiveScan:
    """What is known so far. Fields are replaced, never changed in place, so that a reader needs no lock."""

    run: Path
    live: "LiveReconstruction"
    every_fraction: float = 0.05
    """A new picture is due after this part of the plan's points ..."""
    every_s: float = 2.0
    """... or when this much time has passed with something new."""
    on_picture: Callable[["LivePicture"], None] | None = None
    samples: "list[Sample]" = field(default_factory=list)
    picture: "LivePicture | None" = None
    pictures: int = 0
    skipped: int = 0
    """Pictures that were due while another was being made."""
    message: str = ""
    over: bool = False
    """The scan has ended and its last picture is made."""
    _plan: "ScanPlan | None" = None

    def start(self) -> None:
        """Follows and paints until the scan is over or `stop`."""
        self._all_read = threading.Event()
        self._stopped = threading.Event()
        self._news = threading.Event()
        for target in (self._follow, self._paint):
            threading.Thread(target=target, daemon=True).start()

    def stop(self) -> None:
        """Ends both threads after what they are at."""
        self._stopped.set()
        self._news.set()

    def wait(self) -> None:
        """Returns when the last picture is made."""
        while not (self.over or self._stopped.is_set()):
            time.sleep(0.05)

    def _follow(self) -> None:
        from acquisition.errors import InvalidData, StorageError
        from acquisition.follow import follow

        try:
            for sample in follow(self.run):
                self.samples.append(sample)
                self._news.set()
                if self._stopped.is_set():
                    return
        except (InvalidData, StorageError, TimeoutError) as error:
            self._say(str(error))
        finally:
            self._all_read.set()
            self._news.set()

    def _paint(self) -> None:
        from calibration.errors import InvalidData
        from nlos.chain import transient_of
        from recon.errors import ReconError

        painted, painted_s = 0, time.monotonic()
        while not self._stopped.is_set():
            self._news.wait(0.2)
            self._news.clear()
            last = self._all_read.is_set()
            count = len(self.samples)
            step = max(1, int(self.every_fraction * self._planned()))
            due = count - painted >= step or (count > painted and time.monotonic() - painted_s >= self.every_s)
            if due or (last and count > painted):
                self.skipped += max(0, (count - painted) // step - 1)
                try:
                    transient = transient_of(self.samples[:count], self._recording_plan().wall)
                    picture = self.live.update(transient, count)
                except (InvalidData, ReconError) as error:
                    self._say(f"no picture of {count} points yet: {error}")
                else:
                    self.picture, self.pictures, self.message = picture, self.pictures + 1, ""
                    if self.on_picture is not None:
                        self.on_picture(picture)
                painted, painted_s = count, time.monotonic()
            if last and len(self.samples) <= painted:
                self.over = True
                return

    def _planned(self) -> int:
        return len(self._recording_plan()) if self.samples else 1

    def _recording_plan(self) -> "ScanPlan":
        from acquisition.recording import Recording

        if self._plan is None:
            with Recording.open(self.run) as recording:
                self._plan = recording.plan
        return self._plan

    def _say(self, message: str) -> None:
        self.message = message
        terminal.log(message)
