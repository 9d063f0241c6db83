"""What has come of a scan so far, and what its pictures are made from."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.recording import Recording, Status
from nlos.calibration.told import told_to
from nlos.chain import constants_for
from nlos.live.calibrated import Calibrated, calibrated
from nlos.live.calibration import SampleCalibration
from nlos.live.film import LiveFilm
from nlos.live.so_far import empty_scan, gathering_for, scan_of, shown_of
from nlos.response import AUTO, ResponseWanted, with_response
from nlos.said_once import SaidOnce
from nlos.time_left import TimeLeft

if TYPE_CHECKING:
    from nlos.acquisition.sample import Sample
    from nlos.acquisition.scanning.free_points import FreePoints
    from nlos.acquisition.scanning.gathering import Gathering
    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.loaded import LoadedScan


@dataclass
class Gathered:
    """The follower's thread adds samples, others ask: whoever looks at `samples`, `recent` or `left_s` holds `lock`."""

    samples: "Gathering | FreePoints"
    """What a viewer shows."""
    empty: "LoadedScan"
    """The file as a scan without samples."""
    identity: str
    """Of the recording."""
    growing: bool
    """Whether its scan was under way when it was opened: of a finished recording there is one picture, not one in
    passing."""
    constants: "BenchConstants | None" = None
    response: ResponseWanted = AUTO
    film: LiveFilm | None = None
    """Of a scan of several frames; None where they are added up."""
    each: SampleCalibration | None = None
    """Samples corrected one by one as they come, where the bench's constants are known."""
    lock: threading.Lock = field(default_factory=threading.Lock)
    recent: "deque[tuple[int, float]]" = field(default_factory=lambda: deque(maxlen=64))
    """Detections and live time of the newest samples."""

    def __post_init__(self) -> None:
        self._tell = SaidOnce()
        self._time = TimeLeft(self.samples.plan)

    def __len__(self) -> int:
        """Samples that there may be a picture of: of a film those up to the end of its newest frame."""
        return len(self.samples) if self.film is None else self.film.samples

    @property
    def frames_over(self) -> int:
        """Of a film: the number of frames that are over; else 0."""
        return 0 if self.film is None else self.film.over + 1

    @property
    def planned(self) -> int:
        """Samples of the whole scan."""
        return self.samples.plan.most_samples

    @property
    def elapsed_s(self) -> float:
        """Bench time from the scan's start to the end of the last sample."""
        return self._time.elapsed_s

    @property
    def left_s(self) -> float | None:
        """Bench time until the last point of the plan is over; None before the first."""
        return self._time.left_s

    def add(self, sample: "Sample") -> None:
        """One sample, in the order of the file."""
        with self.lock:
            if self.samples.add(sample):
                if self.each is not None:
                    self.each.add(sample)
                if self.film is not None:
                    self.film.add(sample)
                self._time.took(sample)
            self.recent.append((sample.histogram.total_count, sample.histogram.live_time_s))
            self._time.passed(sample)

    def finish(self) -> None:
        """No sample will come any more."""
        if self.film is not None:
            self.film.finish()

    def calibrated(self, whole: bool) -> Calibrated:
        """What came so far; `whole` once that is all. Raises what calibrating raises."""
        if self.film is not None:
            return self.film.calibrated(whole, self.so_far)
        with self.lock, told_to(self._tell):
            count, scan = len(self.samples), scan_of(self.empty, self.samples)
            corrected = None if self.each is None or whole else with_response(self.each.transient(), self.response)
        if corrected is None or self.each is None:
            return calibrated(scan, count, whole, self.constants, self.response, self._tell)
        return Calibrated(count, whole, corrected, scan.falloff, self.each.zero)

    def as_last(self) -> "tuple[Transient, int | None]":
        """The samples so far, calibrated as all of them will be, in silence; and the falloff that the file says. Raises
        what calibrating raises."""
        scan = self.so_far()
        known = calibrated(scan, len(self.samples), False, self.constants, self.response, lambda *said: None)
        return known.transient, scan.falloff

    def calibrated_part(self, scan: "LoadedScan") -> Calibrated:
        """What `reconstruct` would work on, of a part of the finished scan. Raises what calibrating raises."""
        return calibrated(scan, len(self.samples), True, self.constants, self.response, self._tell)

    def so_far(self) -> "LoadedScan":
        """The file with the samples that came so far."""
        with self.lock:
            return scan_of(self.empty, self.samples)


def nothing_yet(
    recording: Recording, constants: Path | None, response: ResponseWanted, adds_up: bool, say: Callable[[str], None]
) -> Gathered:
    """Of an open recording, before its first sample; `adds_up`: of a film every picture is of all frames so far.
    `say` is told where samples cannot be corrected one by one, and where frames cannot be shown one by one.

    Raises `ForeignConstants` for constants given that are of another bench, `InvalidData` where the scan needs too
    much memory.
    """
    plan, empty = recording.plan, empty_scan(recording)
    known = constants_for(empty, constants)
    samples = gathering_for(plan) if adds_up else shown_of(plan)
    gathered = Gathered(samples, empty, recording.header.identity, recording.status is Status.RUNNING, known, response)
    if plan.frames > 1 and not recording.on_grid and not adds_up:
        say(f"points off the grid: the {plan.frames} frames are added up here; `nlos reconstruct --film` shows each")
    if empty.rectified or not recording.on_grid:
        return gathered
    if plan.frames > 1 and not adds_up:
        gathered.film = LiveFilm(plan, known, response)
    elif gathered.growing:
        gathered.each = SampleCalibration.where_known(plan, known, say)
    return gathered
