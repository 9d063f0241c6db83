"""A Time Tagger behind the vendor's Python package: found, opened, set up, and every call's failure named."""

import contextlib
import importlib
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.drivers.clock import Clock
from nlos.drivers.device_model import WireLog
from nlos.drivers.errors import (
    DeviceFault,
    DeviceLost,
    DeviceNotFound,
    DeviceTimeout,
    LimitError,
    SyncLost,
    WrongDevice,
)
from nlos.drivers.tcspc.counter import CountRates
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings

PACKAGE = "Swabian.TimeTagger"
PS = 1e-12
_RATE_S, _QUICK_S = 0.1, 0.01
_SLOW_HZ = 3e6
"""Up to here all laser pulses of a tenth of a second cross the USB cable; above, a meter is right to a picosecond."""
_LEVEL_STEP_MV = 20
"""No model's levels are further apart."""
_MORE_S = 0.5
"""A rate that is not there so long after its time does not come: light may be on meanwhile."""


def load_package(device: str) -> Any:
    """The vendor's package. Raises `DeviceNotFound` that says what to install."""
    try:
        return importlib.import_module(PACKAGE)
    except (ImportError, OSError) as error:
        raise DeviceNotFound(
            device,
            f"the vendor's Python package could not be loaded ({error}).",
            "pip install Swabian-TimeTagger (on Windows, install the vendor's Time Tagger software first).",
        ) from error


class Tagger:
    """One open instrument. The vendor's package raises `RuntimeError` and `ValueError` for whatever goes wrong."""

    def __init__(
        self, settings: TimeTaggerSettings, clock: Clock, package: Any, wire_log: WireLog | None = None
    ) -> None:
        self.device, self._settings, self._clock, self._log = settings.model, settings, clock, wire_log
        self._package, self._lock = package, threading.RLock()
        self.closed = False
        serials = list(self.call("scanTimeTagger", package.scanTimeTagger))
        wanted = settings.serial
        if not serials or wanted not in ("auto", *serials):
            seen = f" (there is {', '.join(serials)})" if serials else ""
            which = "" if wanted == "auto" else f" with serial number {wanted}"
            raise DeviceNotFound(
                self.device,
                f"no Time Tagger{which} answers{seen}.",
                "Check cable and power, close other programs that use it, correct `serial` in the bench file.",
            )
        if wanted == "auto" and len(serials) > 1:  # which of them is the first may change with the next plug
            what = f"{len(serials)} Time Taggers answer: {', '.join(serials)}."
            raise DeviceNotFound(self.device, what, "Name one as `serial` in the bench file.")
        chosen = serials[0] if wanted == "auto" else wanted
        self.instrument = self.call("createTimeTagger", package.createTimeTagger, chosen)

    def call(self, name: str, function: Callable[..., Any], *arguments: Any) -> Any:
        """What the function returns. Raises `DeviceLost` or `DeviceFault` with the vendor's words, and `WrongDevice`
        where it takes other arguments: AUX OUT once took a divider where it takes a frequency."""
        with self._lock:
            if self._log:
                shown = tuple(each for each in arguments if isinstance(each, int | float | str | list))
                self._log(self.device, ">", f"{name}{shown}".encode())
            try:
                return function(*arguments)
            except TypeError as error:
                raise self._other_version(f"takes other arguments for {name} ({error})") from error
            except (RuntimeError, ValueError, OSError) as error:
                kind = DeviceLost if "connect" in str(error).lower() else DeviceFault
                raise kind(
                    self.device, f"{name} failed: {error}.", "Check cable and settings, then open the bench again."
                ) from error

    def set(self, name: str, *arguments: Any) -> Any:
        """A method of the instrument itself."""
        return self.call(name, self._named(self.instrument, name), *arguments)

    def measurement(self, name: str, *arguments: Any) -> Any:
        """A new measurement or virtual channel of the vendor's; measurements begin at once."""
        return self.call(name, self._named(self._package, name), self.instrument, *arguments)

    def read(self, source: Any, name: str = "getData") -> npt.NDArray[Any]:
        """The array that a measurement holds."""
        return np.asarray(self.call(name, self._named(source, name)))

    def constant(self, name: str) -> Any:
        """A number of the vendor's package."""
        return self._named(self._package, name)

    def _named(self, source: Any, name: str) -> Any:
        found = getattr(source, name, None)
        if found is None:
            raise self._other_version(f"has no {name}")
        return found

    def _other_version(self, how: str) -> WrongDevice:
        return WrongDevice(
            self.device,
            f"the vendor's package {how}: it is of a version that this adapter was not written for.",
            "pip install --upgrade Swabian-TimeTagger.",
        )

    def set_level(self, channel: int, level_mv: int) -> None:
        """Raises `LimitError` where it took another: the vendor's package moves a level beyond the model's range to its
        end, and says so nowhere but in its log."""
        self.set("setTriggerLevel", channel, level_mv * 1e-3)
        taken_mv = float(self.set("getTriggerLevel", channel)) * 1e3
        if abs(taken_mv - level_mv) > _LEVEL_STEP_MV:
            raise LimitError(
                self.device,
                f"input {channel} takes no level of {level_mv} mV: it made {taken_mv:.0f} mV of it.",
                "Correct it in the bench file.",
            )

    def delay_inputs(self) -> None:
        """As the bench file says, before the filter: behind it the pulse that goes with a photon would be another one.
        Raises `LimitError` for a model that cannot."""
        for each in (self._settings.sync, self._settings.detector):
            self.set("setDelaySoftware", each.channel, 0)
            self.set("setInputDelay", each.channel, each.delay_ps)
            if int(self.set("getDelaySoftware", each.channel)):
                raise LimitError(
                    self.device,
                    f"this model delays input {each.channel} only behind its filter, which would lose photons.",
                    "Set delay_ps: 0 in the bench file, and choose histogram.offset_ns instead.",
                )

    def check_sync(self, sync_hz: float, width_ps: int) -> None:
        """After points: whether laser pulses still come at the rate by which they were dated back, to within a bin per
        period. Behind the filter it shows in nothing else. Raises `SyncLost`."""
        sync = self._settings.sync
        self.set("clearConditionalFilter")
        self.set("sync")
        now_hz = self._count([sync.channel], _QUICK_S)[0]
        told_hz = 1 / _QUICK_S + 1 / _RATE_S  # one pulse more or less in either
        if abs(now_hz - sync_hz) <= sync_hz**2 * width_ps * PS + told_hz:
            return
        off = f", photons are up to {abs(1 / now_hz - 1 / sync_hz) / PS:.0f} ps off" if now_hz > 0 else ""
        raise SyncLost(
            self.device,
            f"input {sync.channel} (sync) had {sync_hz:.0f} Hz when points began and {now_hz:.0f} Hz at their end: "
            f"laser pulses are dated by the first{off}.",
            "Let the laser settle (and check its sync cable), then take these points again.",
        )

    def rates(self) -> CountRates:
        """Over a tenth of a second; every laser pulse counts, for which the filter is off meanwhile."""
        self.set("clearConditionalFilter")
        self.set("sync")
        sync_hz, detector_hz = self._count([self._settings.sync.channel, self._settings.detector.channel], _RATE_S)
        return CountRates(sync_hz, detector_hz)

    def laser_hz(self) -> float:
        """The laser's rate, by which its pulses are dated back. A meter counts whole pulses: of a slow laser, one more
        or less is 10 ps of the period at 1 MHz, and 1 ns at 0.1 MHz; there the pulses' own times tell. Raises
        `SyncLost` where they do not agree."""
        counted_hz = self.rates().sync_hz
        if not 0 < counted_hz <= _SLOW_HZ:
            return counted_hz
        stream = self.measurement("TimeTagStream", round(2 * counted_hz * _RATE_S) + 100, [self._settings.sync.channel])
        self._run(stream, _RATE_S)
        times_ps = self.read(self.call("getData", stream.getData), "getTimestamps").astype(np.int64)
        if len(times_ps) < 2:
            return counted_hz
        timed_hz = (len(times_ps) - 1) / (int(times_ps[-1] - times_ps[0]) * PS)
        if abs(timed_hz - counted_hz) > 2 / _RATE_S:
            raise SyncLost(
                self.device,
                f"input {self._settings.sync.channel} (sync) has {counted_hz:.0f} Hz by count and {timed_hz:.0f} Hz by "
                "the times of its pulses.",
                "Let the laser settle; check sync cable and sync.level_mv: pulses may be missed, or come twice.",
            )
        return timed_hz

    def detector_hz(self) -> float:
        """The detector's alone, whatever is being measured: the filter stays."""
        return self._count([self._settings.detector.channel], _QUICK_S)[0]

    def _count(self, channels: list[int], seconds: float) -> list[float]:
        meter = self.measurement("Countrate", channels)
        self._run(meter, seconds)
        return [float(each) for each in self.read(meter)]

    def _run(self, meter: Any, seconds: float) -> None:
        self.call("startFor", meter.startFor, round(seconds / PS))
        deadline_s = self._clock.now() + seconds + _MORE_S
        self._clock.sleep(seconds)
        while self.call("isRunning", meter.isRunning):
            if self._clock.now() >= deadline_s:
                raise DeviceTimeout(
                    self.device, f"it still counts {_MORE_S:g} s after the {seconds:g} s it was asked for."
                )
            self._clock.sleep(0.002)

    def filter_sync(self, sync_hz: float) -> None:
        """Only the laser pulse that follows a photon is sent on, dated back by one period to the one that made it: the
        USB link then carries photons, not 10 million pulses a second. Raises `SyncLost`."""
        if sync_hz <= 0:
            raise SyncLost(self.device, "sees no sync signal.", "Check laser, sync cable and sync.level_mv.")
        sync, detector = self._settings.sync, self._settings.detector
        self.set("setConditionalFilter", [detector.channel], [sync.channel])
        self.set("setDelaySoftware", sync.channel, -round(1 / (sync_hz * PS)))  # one before the filter opened it late
        self.set("sync")
        self.overflowed()  # what was lost while every laser pulse was counted is of no point

    def overflowed(self) -> bool:
        """Whether tags were lost since this was last asked."""
        return bool(self.set("getOverflowsAndClear"))

    def close(self) -> None:
        """May be called twice; what the package says of an instrument that is gone is no error of closing it."""
        with self._lock:
            if not self.closed:
                self.closed = True
                with contextlib.suppress(RuntimeError, ValueError, OSError):
                    self._package.freeTimeTagger(self.instrument)
