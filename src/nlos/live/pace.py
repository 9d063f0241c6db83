"""How fast samples come, and how long pictures take: when a picture is worth making, and when it will be there."""

import math
from collections import deque


class Pace:
    """How fast samples come, over the last seconds, and how long a picture of each method takes."""

    OVER_S = 2.0
    TOGETHER_S = 0.02
    """Samples within so long are one entry: of thousands a second, a few entries are looked at for every one."""

    def __init__(self) -> None:
        self._came: deque[tuple[float, int]] = deque()  # when the first of an entry came, and how many
        self._took_s: dict[str, float] = {}

    def saw(self, now_s: float) -> None:
        """One more sample."""
        if self._came and now_s - self._came[-1][0] < self.TOGETHER_S:
            self._came[-1] = (self._came[-1][0], self._came[-1][1] + 1)
        else:
            self._came.append((now_s, 1))
        while now_s - self._came[0][0] > self.OVER_S:
            self._came.popleft()

    def took(self, method: str, seconds: float) -> None:
        """A picture was made in so many seconds."""
        self._took_s[method] = seconds

    def picture_s(self, method: str) -> float:
        """How long the next picture will take, judged by the one before; 0 where there was none."""
        return self._took_s.get(method, 0.0)

    def left_s(self, samples: int, now_s: float) -> float:
        """How long so many more take, at least; infinite while none come."""
        came = [entry for entry in tuple(self._came) if now_s - entry[0] <= self.OVER_S]
        return samples * (now_s - came[0][0]) / sum(count for _, count in came) if came else math.inf
