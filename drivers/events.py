"""What happens to the light and the devices, told to whoever writes it down."""

import threading
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
        self.cannot_wait: Callable[[], bool] = lambda: False
        """Whether who reports has no time for a listener that hangs: then another thread tells it."""

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
        if self.deferred:
            return
        if self.cannot_wait():
            threading.Thread(target=self.deliver, name="what happened to the light", daemon=True).start()
        else:
            self.deliver()

    def deliver(self) -> None:
        """Hands over what waits, in order, if somebody listens."""
        while self._waiting and self._listener is not None:
            try:
                kind, text = self._waiting.popleft()
            except IndexError:  # another thread has it
                return
            self._listener(kind, text)
