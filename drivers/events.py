"""What happens to the light and the devices, told to whoever writes it down."""

from collections import deque
from collections.abc import Callable

OnEvent = Callable[[str, str], None]
"""(kind, text); kinds: `shutter`, `trip`, `override`, `watchdog`, `warning`, `device`, `signal`"""


class EventLog:
    """Events wait here until somebody listens, and while a signal handler runs: files are not safe to write in one."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[str, str]] = deque()
        self._listener: OnEvent | None = None
        self.deferred = False

    @property
    def listener(self) -> OnEvent | None:
        """Who is told of what happens; None: it waits for the next one."""
        return self._listener

    @listener.setter
    def listener(self, listener: OnEvent | None) -> None:
        self._listener = listener
        self.deliver()

    def report(self, kind: str, text: str) -> None:
        """Something happened: told at once, or when events are delivered again."""
        self._waiting.append((kind, text))
        if not self.deferred:
            self.deliver()

    def deliver(self) -> None:
        """Hands over what waits, in order, if somebody listens."""
        while self._waiting and self._listener is not None:
            self._listener(*self._waiting.popleft())
