"""How fast samples come, and how long pictures take: when a picture is worth making, and when it will be there."""

import math
from collections import deque


class Pace:
    """How fast samples come, over the last seconds, and how long a picture of each method takes."""

    OVER_S = 2.0

    def __init__(self) -> None:
        self._came_s: deque[float] = deque()
        self._took_s: dict[str, float] = {}

    def saw(self, now_s: float) -> None:
        """One more sample."""
        self._came_s.append(now_s)
        while now_s - self._came_s[0] > self.OVER_S:
            self._came_s.popleft()

    def took(self, method: str, seconds: float) -> None:
        """A picture was made in so many seconds."""
        self._took_s[method] = seconds

    def picture_s(self, method: str) -> float:
        """How long the next picture will take, judged by the one before; 0 where there was none."""
        return self._took_s.get(method, 0.0)

    def left_s(self, samples: int, now_s: float) -> float:
        """How long so many more take, at least; infinite while none come."""
        came_s = [at_s for at_s in tuple(self._came_s) if now_s - at_s <= self.OVER_S]
        return samples * (now_s - came_s[0]) / len(came_s) if came_s else math.inf
