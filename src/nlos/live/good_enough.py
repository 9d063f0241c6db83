"""`scan --until stable`: ends a scan, or its first pass, when its picture has stopped changing and holds light enough.

The picture is made again whenever a quarter more points are in, so that "change" always means the same: what a
quarter more of the scan did to it. On a simulated bench that happens between two points, at the same points in every
run; on a real one the live process makes the pictures, and only its figures are read here, twice a second.
"""

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.acquisition.recording.recording import Recording
from nlos.calibration.errors import InvalidData
from nlos.chain import calibrate_scan, constants_for
from nlos.cli.exit_codes import UsageError
from nlos.live.process import read_state, state_file
from nlos.live.so_far import gathering_for, new_scan, scan_of
from nlos.recon.errors import ReconError
from nlos.recon.live import GROWTH, LivePicture, LiveReconstruction
from nlos.response import response_wanted, with_response

if TYPE_CHECKING:
    from nlos.acquisition.planning.plan import ScanPlan
    from nlos.acquisition.sample import Sample

LEVEL = 0.05
FIRST_FRACTION = 0.05
AGAIN_S = 0.5


class Enough:
    """The engine's `decide`: fed with every sample, asked after every one."""

    def __init__(
        self,
        run: Path,
        plan: "ScanPlan",
        devices: Mapping[str, str],
        level: float,
        method: str,
        report: Callable[[str, str], None],
        watched: bool,
        resumed: bool = False,
        settings: Mapping[str, object] | None = None,
        bench_json: str = "{}",
        response: str = "auto",
    ) -> None:
        """Before `run` is opened for writing: where it is `resumed`, what it holds is read here. `watched`: the live
        process of `run` makes the pictures, and its figures are read here."""
        self._growth = GROWTH
        self.reached = False
        """Whether the scan, or the first of its passes, ended for being good enough."""
        self._level, self._report, self._devices = level, report, devices
        self._bench_json, self._response = bench_json, response_wanted(response)
        self._state = state_file(run) if watched else None
        self._gathering = gathering_for(plan)
        self._live = LiveReconstruction(method, settings)
        self._next = max(1, math.ceil(FIRST_FRACTION * len(plan)))
        self._looked_s = -math.inf
        self._seen = 0
        if resumed and run.exists():
            with Recording.open(run) as recording:
                for sample in recording.samples():
                    self.add(sample)

    def add(self, sample: "Sample") -> None:
        """One more sample, once it is on its way to the disk."""
        if self._state is None:
            self._gathering.add(sample)

    def __call__(self) -> bool:
        """Whether the scan may end now; said in the event log with its figures."""
        figures = self._computed() if self._state is None else self._polled()
        if figures is None:
            return False
        samples, change, error = figures
        enough = change <= self._level and error <= self._level
        self.reached |= enough
        verdict = "is good enough" if enough else "is not good enough yet"
        self._report(
            "until", f"the picture of {samples} points {verdict}: change {change:.4f}, photon noise {error:.4f}, "
            f"level {self._level:g}"
        )  # fmt: skip
        return enough

    def _computed(self) -> tuple[int, float, float] | None:
        if len(self._gathering) < self._next:
            return None
        self._next = math.ceil(self._growth * self._next)
        picture = self._picture()
        return None if picture is None else (picture.samples, picture.change, picture.error)

    def _picture(self) -> "LivePicture | None":
        try:
            scan = scan_of(new_scan(self._gathering.plan, self._devices, self._bench_json), self._gathering)
            transient = with_response(calibrate_scan(scan, constants=constants_for(scan, None)), self._response)
            return self._live.update(transient, len(self._gathering), scan.falloff)
        except (InvalidData, ReconError) as error:
            self._report("until", f"no picture of {len(self._gathering)} points yet: {error}")
            return None

    def _polled(self) -> tuple[int, float, float] | None:
        assert self._state is not None
        if time.monotonic() - self._looked_s < AGAIN_S:
            return None
        self._looked_s = time.monotonic()
        found = read_state(self._state)
        samples, change, error = found.get("samples"), found.get("change"), found.get("error")
        if not isinstance(samples, int) or samples < self._growth * self._seen:
            return None
        if not isinstance(change, float) or not isinstance(error, float):
            return None
        self._seen = samples
        return samples, change, error


def parse_until(word: str) -> float:
    """The level of `stable` or `stable:LEVEL`. Raises `UsageError`."""
    kind, colon, text = word.partition(":")
    if kind == "stable" and not colon:
        return LEVEL
    try:
        level = float(text)
    except ValueError:
        level = math.nan
    if kind != "stable" or not 0 < level < 1:
        raise UsageError(f"--until {word}: `stable`, or `stable:LEVEL` with a level between 0 and 1, e.g. stable:0.1")
    return level
