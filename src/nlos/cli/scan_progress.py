"""What a person sees while a scan runs: a bar with rate and time left on a terminal, plain lines elsewhere."""

import sys
import time
from types import TracebackType
from typing import Self

from nlos.cli.terminal import terminal

_BAR_S = 0.1
_LINE_S = 10.0


class ScanProgress:
    """Counts points; shows them on stderr at most ten times a second, or a line every ten seconds off a terminal."""

    def __init__(self, total: int, done: int) -> None:
        self._total, self._done, self._begun_with = total, done, done
        self._begun_s = self._shown_s = time.monotonic()
        self._bar = None
        if terminal.verbosity >= 0 and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("scan"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
                TimeRemainingColumn(), console=Console(file=getattr(sys.stderr, "sent", sys.stderr)), transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task("scan", total=total, completed=done, rate="")

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()

    def step(self) -> None:
        """One more point is taken."""
        self._done += 1
        now = time.monotonic()
        if now - self._shown_s < (_BAR_S if self._bar is not None else _LINE_S):
            return
        self._shown_s = now
        rate = (self._done - self._begun_with) / max(now - self._begun_s, 1e-9)
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, rate=f"{rate:.0f} points/s")
        else:
            left_s = (self._total - self._done) / rate
            terminal.log(f"{self._done} of {self._total} points, {rate:.0f} points/s, {left_s:.0f} s left")

    def hide(self) -> None:
        """Makes room for a question."""
        if self._bar is not None:
            self._bar.stop()

    def show(self) -> None:
        if self._bar is not None:
            self._bar.start()
