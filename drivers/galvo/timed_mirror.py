"""A mirror that does not say where it is: it has settled when its settle model says so."""

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from nlos.drivers.clock import Clock
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.mirror import MirrorAngles, reaches_corners


class TimedMirror(ABC):
    """The part of a `GalvoMirror` that waits by the clock. Whatever moves the mirror says so by `_arrive`."""

    _settings: MirrorBlock
    _clock: Clock
    _settled_at_s: float
    _region: tuple[MirrorAngles, ...]
    """The move under way began at one of these, or between them."""
    _target: MirrorAngles | None
    """Where it goes; None where `_region` alone says where the mirror is."""

    def check(self, angles: MirrorAngles) -> None:
        """Raises `LimitError` when `angles` is beyond the head or the DAC."""
        self._codes(angles)

    def settle_s(self, start: MirrorAngles, end: MirrorAngles) -> float:
        return self._settings.settle.settle_s(start, end)

    def reaches_all(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> bool:
        """Both axes have limits of their own."""
        return reaches_corners(self.check, x_rad, y_rad)

    def settles_s(self, x_rad: npt.NDArray[np.float64], y_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """By the settle table."""
        return self._settings.settle.settles_s(x_rad, y_rad)

    def wait_settled(self) -> None:
        self._clock.sleep(self._settled_at_s - self._clock.now())

    def move_to(self, angles: MirrorAngles) -> None:
        self.begin_move(angles)
        self.wait_settled()

    def _arrive(self, angles: MirrorAngles, begins_s: float = 0.0) -> None:
        """A move begins within `begins_s`. It may do so before the one before has settled: then from anywhere on its
        way."""
        now_s = self._clock.now()
        if self._target is not None:
            self._region = (self._target,) if now_s >= self._settled_at_s else (*self._region, self._target)
        self._settled_at_s = now_s + begins_s + max(self.settle_s(corner, angles) for corner in self._region)
        self._target = angles

    @abstractmethod
    def begin_move(self, angles: MirrorAngles) -> None:
        """Sends the mirror on its way and returns at once."""

    @abstractmethod
    def _codes(self, angles: MirrorAngles) -> tuple[int, int]:
        """The codes of both axes. Raises `LimitError`."""
