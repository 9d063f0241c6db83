"""Scans that are written again after their end was seen, by `scan --resume` in another window, say: followed anew.

What a page would go on saying of such a scan is of before: that it has ended, and that its laser is off.
"""

from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.writer_lock import is_locked
from nlos.live.page import LivePage
from nlos.live.scan import LiveScan


class TakenUp:
    """Puts those of `scans` that are taken up again anew into that list and onto the page that shows them. What is
    still being made of one before gets `wait_s`."""

    def __init__(self, scans: list[LiveScan], page: LivePage, wait_s: float) -> None:
        self._scans, self._page, self._wait_s = scans, page, wait_s
        self._let_go: set[int] = set()
        """Of which scans the writer is gone."""

    def look(self) -> None:
        """May be called again and again, in one thread."""
        for number, scan in enumerate(self._scans):
            if not scan.read:
                if scan.seen is not None and scan.seen.status is Status.RUNNING:
                    self._let_go.discard(number)
            elif not is_locked(scan.run):
                self._let_go.add(number)
            elif number in self._let_go:  # and again where it still says that it has ended: whoever resumes reads first
                self._follow_anew(number, scan)

    def _follow_anew(self, number: int, scan: LiveScan) -> None:
        lives = [live.anew() for live in scan.lives]
        again = LiveScan(scan.run, lives, scan.constants, scan.response, scan.adds_up, scan.first_fraction)
        self._page.begin_anew(number, again, self._wait_s)
        scan.stop(self._wait_s)
        self._scans[number] = again
        again.start()
