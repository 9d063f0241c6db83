"""A film while it is scanned: the newest frame that is over, with the light of those before it moved along."""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from nlos.acquisition.planning.exposure import unbiased_live_s
from nlos.acquisition.recording.frames import LEAST_PART
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.correct import CorrectedPoints, correct_points
from nlos.calibration.known_arrivals import known_arrival_bins
from nlos.calibration.known_direct import KnownDirect
from nlos.calibration.raw_points import RawPoints
from nlos.chain import calibrate_scan
from nlos.live.calibrated import Calibrated
from nlos.live.time_zero import TimeZero
from nlos.live.trails import Trails
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.over_time.memory import LightMemory
from nlos.recon.over_time.moments import Moments
from nlos.recon.volume import Reconstruction
from nlos.response import ResponseWanted, with_response

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.response import Response
    from nlos.acquisition.sample import Sample
    from nlos.calibration.constants import BenchConstants
    from nlos.loaded import LoadedScan

BACKLOG = 8
"""Frames that wait at most to be remembered: of the oldest the light is not."""
QUEUE = 2
"""Frames that wait at most for a picture while all cores make one: of more, only the newest gets one."""
ALIGNED_BY = 0.6
"""Of the frames of the first whole scan: of the points between theirs the wall's fit says when direct light arrives."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """What a frame, of far fewer photons than a whole scan, is aligned by."""

    direct: KnownDirect  # of H * W points
    response: "Response | None"
    bins: int
    """That all points have behind their direct light."""


class LiveFilm:
    """Samples come in the follower's thread, light is asked for in the painter's. A frame is over once all of its
    points are in, or one of a later frame is; points taken again later come too late."""

    def __init__(self, plan: "ScanPlan", constants: "BenchConstants | None", response: ResponseWanted) -> None:
        self._plan, self._constants, self._wanted = plan, constants, response
        self._planned = plan.frame_points
        self._whole = plan.cycle
        self._lock = threading.Lock()
        self._coming: list[Sample] = []
        self._frame = -1
        self._waiting: deque[tuple[int, list[Sample], int]] = deque(maxlen=BACKLOG)
        self._came = self._watched = 0
        self._alignment: Alignment | None = None
        self._memory: LightMemory | None = None
        self._light: HalfGrid | None = None
        self._falloff: int | None = None
        self.samples = 0
        """That had come when the newest frame was over."""
        self.shown_frame = -1
        """The newest one that there is a picture of."""
        self.over = -1
        """The newest frame that is over."""
        self.dropped = 0
        """Frames that got no picture, since the first that did."""
        self.trails = Trails()
        self._zero: TimeZero | None = None
        self.newest = -1, 0.0
        """The newest frame whose light is known, and the mean moment of its exposure."""

    def again(self) -> "LiveFilm":
        """The same film from its beginning, aligned as this one was."""
        film = LiveFilm(self._plan, self._constants, self._wanted)
        film._alignment, film._falloff, film._zero = self._alignment, self._falloff, self._zero
        return film

    def by_now(self) -> "LiveFilm":
        """The same film as if it ended here, for a look at what has come since the last one."""
        film = self.again()
        with self._lock:
            film._waiting.extend(self._waiting)
            if not film._waiting and self._coming:
                film._waiting.append((self._frame, list(self._coming), self._came))
            film.samples = self._came
        return film

    @property
    def share_of_whole_scan(self) -> float:
        """How many of the points of the first whole scan have come; more than 1 once others have."""
        return self._came / int(self._planned[: self._whole].sum())

    @property
    def can_be_aligned(self) -> bool:
        """Whether enough frames of the first whole scan are over."""
        return self._alignment is not None or self.over + 1 >= math.ceil(ALIGNED_BY * self._whole)

    @property
    def waiting(self) -> bool:
        """Whether a frame is over whose light is not known yet."""
        return bool(self._waiting)

    def add(self, sample: "Sample") -> None:
        """One sample of the plan."""
        frame = sample.point.pass_
        with self._lock:
            if frame > self._frame:
                self._end()
                self._frame = frame
            self._came += 1
            if frame == self._frame:
                self._coming.append(sample)
                if len(self._coming) == self._planned[frame]:
                    self._end()

    def finish(self) -> None:
        """No sample will come any more."""
        with self._lock:
            self._end()
            self.samples = self._came

    def _end(self) -> None:
        if self._coming:
            # A part of a frame is no picture, unless there is nothing else.
            if self.over < 0 or len(self._coming) >= LEAST_PART * self._planned[self._frame]:
                self._waiting.append((self._frame, self._coming, self._came))
                self.samples, self.over = self._came, self._frame
            self._coming = []

    def calibrated(self, whole: bool, gathered: "Callable[[], LoadedScan]") -> Calibrated:
        """The light of the next frame that waits for its picture, of the newest one if `whole`, with what those before
        it add: aligned by the direct light of what is `gathered` when that is first asked for. Raises what calibrating
        raises."""
        self.watch(gathered, None if whole else 1)
        assert self._memory is not None
        assert self._alignment is not None
        assert self._zero is not None
        if self._light is None:
            held = self._memory.on_half_grid()
            self._light = replace(held, light=replace(held.light, response=self._alignment.response))
        count = self.samples if whole else self._watched
        return Calibrated(count, whole, self._light.light, self._falloff, self._zero, self._light, self.newest)

    def watch(self, gathered: "Callable[[], LoadedScan]", pictured: int | None = None) -> None:
        """Takes the frames that are over into the memory: all of them, or of those that wait for pictures the first
        `pictured`, if no more than `QUEUE` wait. Raises what calibrating raises."""
        scan = None if self._alignment is not None else gathered()
        if scan is not None:
            self._align(scan)
            self._falloff = scan.falloff
        with self._lock:
            count = len(self._waiting)
            due = sum(frame >= self._whole - 1 for frame, _, _ in self._waiting)
            if pictured is not None and due <= QUEUE:
                count += min(pictured, due) - due
            waiting = [self._waiting.popleft() for _ in range(count)]
        for frame, samples, came in waiting:
            moments = self._moments(samples)
            self._memory = self._memory or LightMemory(moments.wall, moments.time)
            self._memory.watch(moments)
            self.newest, self._light, self._watched = (frame, moments.mean_s), None, came

    def shown(self, picture: Reconstruction, frame: tuple[int, float]) -> int:
        """A picture of a frame was made; its number and moment. Returns how many were dropped before it."""
        before, (self.shown_frame, moment_s) = self.shown_frame, frame
        dropped = max(self.shown_frame - before - 1, 0) if before >= 0 else 0
        self.dropped += dropped
        self.trails.add(picture, moment_s)
        return dropped

    def _align(self, scan: "LoadedScan") -> None:
        found: list[CorrectedPoints] = []
        transient = with_response(calibrate_scan(scan, constants=self._constants, hear=found.append), self._wanted)
        if found[0].offsets is not None:
            arrival_bins = found[0].offsets.offset_bins
        else:
            assert self._constants is not None
            x_m, y_m = (grid.reshape(-1) for grid in np.meshgrid(scan.transient.wall.x_m(), scan.transient.wall.y_m()))
            arrival_bins = known_arrival_bins(self._constants, x_m, y_m, scan.transient.time)
        self._alignment = Alignment(found[0].known(arrival_bins), transient.response, transient.time.bins)
        self._zero = TimeZero.of(scan, found[0], self._constants)

    def _moments(self, samples: "list[Sample]") -> Moments:
        """The frame's points, calibrated; those where no direct light is known are not in it."""
        known, plan = self._alignment, self._plan
        assert known is not None
        samples = sorted(samples, key=lambda each: (each.point.row, each.point.col))  # as they lie on a grid
        number = np.array([each.point.number for each in samples])
        row, col = plan.positions.row[number], plan.positions.col[number]
        held = [each.histogram for each in samples]
        live_s = unbiased_live_s(
            np.array([each.live_time_s for each in held]),
            np.array([each.flags for each in held], dtype=np.uint16), plan.stop,
        )  # fmt: skip
        raw = RawPoints(
            np.stack([each.counts for each in held]).astype(np.float32),
            plan.wall.x_m()[col], plan.wall.y_m()[row], live_s,
            np.array([each.sync_count for each in held], dtype=np.float64),
            np.array([each.total_count for each in held], dtype=np.float64),
            TimeAxis(plan.axis.bins, plan.axis.bin_width_s, plan.axis.offset_s),
        )  # fmt: skip
        done = correct_points(raw, self._constants, known=known.direct.at(row * plan.wall.cols + col))
        taken_s = np.array([each.taken_s + each.histogram.live_time_s / 2 for each in samples])
        used = done.exposure_s > 0
        counts = np.zeros((int(used.sum()), known.bins), dtype=np.float32)
        shared = min(known.bins, done.time.bins)
        counts[:, :shared] = done.counts[used, :shared]
        return Moments(
            raw.x_m[used], raw.y_m[used], counts, done.exposure_s[used], taken_s[used], plan.wall,
            replace(done.time, bins=known.bins),
        )  # fmt: skip
