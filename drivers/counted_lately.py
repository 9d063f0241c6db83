"""The rate of the newest counts, over as little time as a trip is judged by."""

from collections import deque


class CountedLately:
    """Counts and live times of as many of the newest histograms as last `window_s` together; one that lasts as long is
    judged alone. Short dwells say nothing by themselves: a single photon in a microsecond is a million a second."""

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s * (1 - 1e-6)  # sums of dwells miss it by a rounding
        self._kept: deque[tuple[float, float]] = deque()
        self._live_s = self._counts = 0.0

    def rate_cps(self, live_s: float, counts: float) -> float | None:
        """Of the window that ends with this histogram; None until one is full."""
        self._kept.append((live_s, counts))
        self._live_s, self._counts = self._live_s + live_s, self._counts + counts
        while len(self._kept) > 1 and self._live_s - self._kept[0][0] >= self._window_s:
            oldest_s, fewer = self._kept.popleft()
            self._live_s, self._counts = self._live_s - oldest_s, self._counts - fewer
        full = self._live_s > 0 and self._live_s >= self._window_s
        return self._counts / self._live_s if full else None

    def forget(self) -> None:
        """What was counted before says nothing of the light from now on."""
        self._kept.clear()
        self._live_s = self._counts = 0.0
