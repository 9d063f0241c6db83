"""What may go wrong while a scan runs without any device saying so, and what is done about it.

Alarms are level-triggered: looked at before the light is switched on, at every sample and, the disk, at every block. An
alarm that was raised clears only well on the good side of its limit, so that a value at the limit does not make it
flutter; one that skips points judges each by itself. Samples taken under an alarm are not kept: their points are taken
again.
"""

import shutil
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from pydantic import Field

from nlos.acquisition.digits import two_digits
from nlos.acquisition.sample import Sample
from nlos.configs.settings import Settings
from nlos.drivers.bench import Bench
from nlos.drivers.errors import SafetyTrip
from nlos.drivers.tcspc.counter import CountRates, HistogramFlag

CLEARS_AT = 0.5
"""Share of the distance to the limit at which an alarm clears again."""
BLANK_PHOTONS = 25.0
"""So many photons expected and none seen: as good as never by chance (exp(-25))."""
USUAL_TIMES, USUAL_SPARE_HZ = 3.0, 1e3
"""Counts with the shutter closed are usual up to so many times what they were at first light, and so many more."""
RATE_S = 1e-3
LIVE_S = 1e-6
"""How finely counters say how long they counted; a point that stops after five photons counts for no more than ten."""
BLOCK = 64


class Action(Enum):
    """What an alarm does to the scan."""

    PAUSE = "pause"
    """Light off until somebody decides."""
    SKIP = "skip"
    """The point is left for the end of the scan."""
    ABORT = "abort"
    """The scan ends; what was taken is safe."""


DONE = {
    Action.PAUSE: "The light is off and the scan is paused.",
    Action.SKIP: "The point is left for the end of the scan.",
    Action.ABORT: "The light is off and the scan ends.",
}
"""What a person is told of each."""


def sentence(text: str) -> str:
    """With a full stop, where it does not end in a question."""
    return text if text.endswith((".", "?", "!")) else f"{text}."


class AlarmSettings(Settings):
    """The alarms block of a scan file: limits, and what to do at each."""

    sync_tolerance: float = Field(default=0.05, gt=0, lt=1)
    """How far the laser's pulse rate may be from the bench file's, as a fraction."""
    on_sync: Action = Field(default=Action.PAUSE, strict=False)
    """What a laser whose pulse rate is off does to the scan."""
    pile_up: float = Field(default=0.05, gt=0, le=1)
    """Detector counts per laser pulse above which histograms are distorted by pile-up."""
    on_count_rate: Action = Field(default=Action.ABORT, strict=False)
    """What pile-up, or a bin that holds no more counts, does to the scan."""
    max_dark_hz: float | None = Field(default=None, gt=0)
    """Detector rate allowed with the shutter closed, before the scan."""
    on_dark_rate: Action = Field(default=Action.ABORT, strict=False)
    """What too many dark counts do to the scan."""
    on_blank: Action = Field(default=Action.PAUSE, strict=False)
    """No photons at all where photons came before: a shutter, a cable or a detector that went off."""
    expect_direct: bool = True
    """Whether the time window is to hold direct light; false for a detector that is gated to leave it out."""
    on_direct: Action = Field(default=Action.PAUSE, strict=False)
    """No direct light in the first points, or at another time than first light found it."""
    on_aim: Action = Field(default=Action.PAUSE, strict=False)
    """A beam that goes elsewhere than it is sent, by what `nlos doctor` or `nlos jog` saw of this bench."""
    min_free_mb: float = Field(default=100.0, ge=0)
    """Free space on the recording's disk below which `on_disk` applies."""
    on_disk: Action = Field(default=Action.ABORT, strict=False)
    """What a disk that fills up does to the scan."""


class AlarmRaised(SafetyTrip):
    """A scan was ended by an alarm."""


@dataclass(frozen=True)
class Trouble:
    """An alarm that stands: which one, what was seen, what to do."""

    name: str
    text: str
    action: Action

    @property
    def cure(self) -> str:
        """What to do once it has ended a scan; what resumes it says who knows of its recording."""
        return _CURES.get(self.name, "Fix it.")


_ANEW = "changed, it is another scan: start a new recording with -o."
_CURES = {
    "direct": f"Fix it. With the scan file, or the constants that aim the scan, {_ANEW}",
    "aim": f"Fix it. With the constants that aim the scan {_ANEW}",
    "full bin": f"Shorten dwell_ms (passes add up), or attenuate the light. With the scan file {_ANEW}",
}
"""Where the cure may make the scan another one, which `--resume` refuses."""


class _Level:
    """One value against its limit, with hysteresis. `deviation` is 0 where all is well and 1 at the limit."""

    def __init__(self) -> None:
        self.raised = False

    def stands(self, deviation: float, each: bool) -> bool:
        """`each`: whatever stood before is put off, and what comes now is another point."""
        self.raised = deviation > (CLEARS_AT if self.raised and not each else 1.0)
        return self.raised


@dataclass(frozen=True)
class Expected:
    """What is known of a bench before a scan. `direct` says what is wrong with a sample's direct light, in words; empty
    where nothing is known to be. `usual_dark_hz`: what first light counted with the shutter closed. `aim`: what is
    wrong with where the beam goes; empty where nothing is known to be."""

    direct: Callable[[Sample], str] | None = None
    usual_dark_hz: float | None = None
    aim: str = ""


NOTHING = Expected()


def free_bytes(folder: Path) -> int:
    """Of its disk."""
    return shutil.disk_usage(folder).free


class Alarms:
    """The alarms of one scan on one bench. `folder`: where the recording grows."""

    def __init__(
        self,
        settings: AlarmSettings,
        repetition_hz: float,
        folder: Path | None = None,
        free: Callable[[Path], int] = free_bytes,
        expected: Expected = NOTHING,
    ) -> None:
        """`free`: how many bytes of the folder's disk are, for this scan."""
        self._settings, self._repetition_hz, self._folder, self._free = settings, repetition_hz, folder, free
        self._aim, self._usual_dark_hz = expected.aim, expected.usual_dark_hz
        self._direct = expected.direct if settings.expect_direct else None
        self._levels: dict[str, _Level] = defaultdict(_Level)
        self._samples = 0
        self._mean_hz = 0.0
        self._blank_s = 0.0
        self._count, self._count_s = 0, 0.0

    def wait_for_rates(self, bench: Bench) -> None:
        """A counter that has just been set up measures its rates first: before a scan's clock starts."""
        bench.counter.rates()

    def before(self, bench: Bench) -> Trouble | None:
        """Looks at everything that can be known with the shutter still closed."""
        rates = bench.counter.rates()
        return self._sync(rates.sync_hz) or self._disk() or self._dark(bench, rates.detector_hz) or self._aimed()

    def _aimed(self) -> Trouble | None:
        """Said once: whoever continues after that has decided."""
        said, self._aim = self._aim, ""
        return self._look("aim", 2.0, said) if said else None

    def _dark(self, bench: Bench, detector_hz: float) -> Trouble | None:
        """With the shutter closed, where there is one: by the scan file's limit, else by what is usual here."""
        if bench.settings.shutter_on == "nothing":
            return None
        text, limit_hz = f"{two_digits(detector_hz)} dark counts/s", self._settings.max_dark_hz
        if limit_hz is None and self._usual_dark_hz is not None:
            limit_hz = USUAL_TIMES * self._usual_dark_hz + USUAL_SPARE_HZ
            text = (
                f"{two_digits(detector_hz)} counts/s with the shutter closed, where first light found "
                f"{two_digits(self._usual_dark_hz)}: a lamp, another room light, or a detector that got noisy (`nlos "
                "calibrate --first-light` measures both again; alarms.max_dark_hz allows more)"
            )
        return None if limit_hz is None else self._look("dark rate", detector_hz / limit_hz, text)

    def judge(self, sample: Sample) -> Trouble | None:
        """Looks at one sample, and every 64th time at the disk. None: the sample may be kept."""
        histogram = sample.histogram
        live_s = histogram.live_time_s
        if live_s <= 0:
            return None
        self._samples += 1
        trouble = (
            self._sync(histogram.sync_count / live_s, live_s)
            or self._count_rate(histogram.total_count, live_s)
            or self._full(sample)
            or self._blank(histogram.total_count, live_s)
            or self._direct_light(sample)
        )
        if trouble is None and self._samples % BLOCK == 1:
            trouble = self._disk()
        return trouble

    def judge_trial(self, sample: Sample) -> Trouble | None:
        """Looks at a sample of a trial, which no recording keeps: the beam need not be on its point, but laser and
        detector have to be as in the scan."""
        histogram = sample.histogram
        if histogram.live_time_s <= 0:
            return None
        self._samples += 1
        return (
            self._sync(histogram.sync_count / histogram.live_time_s, histogram.live_time_s)
            or self._count_rate(histogram.total_count, histogram.live_time_s)
            or self._blank(histogram.total_count, histogram.live_time_s)
        )

    def judge_rates(self, rates: CountRates) -> Trouble | None:
        """Looks at the counter's rate meter in the middle of a long dwell."""
        return self._sync(rates.sync_hz) or self._pile_up(rates.detector_hz)

    def _look(self, name: str, deviation: float, text: str) -> Trouble | None:
        action = {
            "sync": self._settings.on_sync,
            "count rate": self._settings.on_count_rate,
            "full bin": self._settings.on_count_rate,
            "dark rate": self._settings.on_dark_rate,
            "blank": self._settings.on_blank,
            "disk": self._settings.on_disk,
            "direct": self._settings.on_direct,
            "aim": self._settings.on_aim,
        }[name]
        stands = self._levels[name].stands(deviation, each=action is Action.SKIP)
        return Trouble(name, text, action) if stands else None

    def _sync(self, sync_hz: float, live_s: float = 1.0) -> Trouble | None:
        """One pulse more or less is how the gate fell, and `LIVE_S` how its time was rounded."""
        off = max(abs(sync_hz / self._repetition_hz - 1) - max(1 / self._repetition_hz, LIVE_S) / live_s, 0.0)
        text = f"the laser pulses at {sync_hz:.6g} Hz, the bench file says {self._repetition_hz:.6g} Hz"
        return self._look("sync", off / self._settings.sync_tolerance, text)

    def _count_rate(self, total_count: int, live_s: float) -> Trouble | None:
        """Over at least a millisecond: a few photons in a microsecond are no rate."""
        self._count, self._count_s = self._count + total_count, self._count_s + live_s
        if self._count_s < RATE_S:
            return None
        rate_hz, self._count, self._count_s = self._count / self._count_s, 0, 0.0
        return self._pile_up(rate_hz)

    def _pile_up(self, rate_hz: float) -> Trouble | None:
        limit_hz = self._settings.pile_up * self._repetition_hz
        text = f"{rate_hz:.4g} counts/s are more than {self._settings.pile_up:.0%} of the laser's pulses (pile-up)"
        return self._look("count rate", rate_hz / limit_hz, text)

    def _full(self, sample: Sample) -> Trouble | None:
        """A bin that holds no more is too low, and the total with it, however modest the rate: its peak is clipped."""
        full = bool(sample.histogram.flags & HistogramFlag.SATURATED)
        most, live_s = int(sample.histogram.counts.max(initial=0)), sample.histogram.live_time_s
        text = (
            f"a bin of point {sample.point.number} is full with {most} counts after {live_s:.4g} s: shorten the dwell"
        )
        return self._look("full bin", 2.0 if full else 0.0, text)

    def _blank(self, total_count: int, live_s: float) -> Trouble | None:
        if total_count:
            weight = 1 / min(self._samples, BLOCK)
            self._mean_hz += weight * (total_count / live_s - self._mean_hz)
            self._blank_s = 0.0
        else:
            self._blank_s += live_s
        expected = self._blank_s * self._mean_hz
        return self._look("blank", expected / BLANK_PHOTONS, f"no photon where {expected:.0f} were expected")

    def _direct_light(self, sample: Sample) -> Trouble | None:
        """Said once: whoever continues after that has decided."""
        said = "" if self._direct is None else self._direct(sample)
        if not said:
            return None
        self._direct = None
        return self._look("direct", 2.0, said)

    def _disk(self) -> Trouble | None:
        if self._folder is None or not self._settings.min_free_mb:
            return None
        try:
            free_mb = self._free(self._folder) / 1e6
        except OSError:  # whether the disk still takes a sample says the next one that is written
            return None
        deviation = self._settings.min_free_mb / max(free_mb, 1e-3)
        return self._look("disk", deviation, f"{free_mb:.0f} MB are left on the disk of {self._folder}")
