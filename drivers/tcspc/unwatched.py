"""What a counter says of a watchdog and of trips when its instrument has neither."""

from nlos.drivers.errors import LimitError


class UnwatchedCounter:
    """The part of a `HistogramCounter` that asks for nothing: no watchdog is armed or kicked, no trip is latched."""

    has_watchdog = False
    _device: str

    def arm_watchdog(self, timeout_s: float) -> None:
        """There is none; only turning it off is possible. Raises `LimitError` otherwise."""
        if timeout_s:
            raise LimitError(self._device, "it has no watchdog.", "Set watchdog_s: 0.0 in the bench file.")

    def kick(self) -> None:
        """There is no watchdog to kick."""

    def clear_trip(self) -> None:
        """The instrument latches none."""
