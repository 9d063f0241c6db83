"""A command that is done ends, also where threads that somebody's method or driver began do not."""

import os
import threading
import time

from nlos.cli.terminal import terminal
from nlos.drivers.exit_paths import close_benches

WAITS_S = 10.0


def end_within(code: int, wait_s: float = WAITS_S) -> None:
    """Python waits for every thread, and may do so for ever: where there are any left, the process ends with `code`
    after `wait_s`. To be called when all is done, written and said."""

    def end() -> None:
        time.sleep(wait_s)
        terminal.log(f"nlos: done; threads that go on are not waited for: {', '.join(_left())}", -9)
        try:
            close_benches()  # what Python would do once all threads have ended
        finally:
            os._exit(code)

    if _left():
        threading.Thread(target=end, daemon=True, name="end").start()


def _left() -> list[str]:
    """Names of those that Python waits for."""
    return [each.name for each in threading.enumerate() if not each.daemon and each is not threading.main_thread()]
