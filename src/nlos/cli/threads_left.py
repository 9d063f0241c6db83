"""A command that is done ends, also where threads that somebody's method or driver began do not."""

import os
import threading
import time

from nlos.cli.terminal import terminal
from nlos.drivers.exit_paths import close_benches

WAITS_S = 10.0


def end_within(code: int, wait_s: float = WAITS_S) -> None:
    """From now on Python waits for every thread, and may do so for ever: after `wait_s` the process ends with `code`.
    To be called when all is done, written and said."""

    def end() -> None:
        time.sleep(wait_s)
        main = threading.main_thread()
        left = [each.name for each in threading.enumerate() if not each.daemon and each is not main]
        terminal.log(f"nlos: done; threads that go on are not waited for: {', '.join(left)}", -9)
        try:
            close_benches()  # what Python would do once all threads have ended
        finally:
            os._exit(code)

    threading.Thread(target=end, daemon=True, name="end").start()
