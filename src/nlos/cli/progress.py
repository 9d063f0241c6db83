"""What a person sees while something takes its time: a bar with rate and time left on a terminal, lines elsewhere."""

import logging
import os
import sys
import time
from collections.abc import Callable
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Self

from nlos.cli.escaped import escaped
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress
    from rich.progress import ProgressColumn
    from rich.table import Column

_BAR_S = 0.1
_LINE_S = 10.0
NARROW = 72
"""On fewer columns the bar and the pace make room for how many there are and how long it takes."""
DUMB = ("dumb", "unknown")
"""Terminals by these names, an editor's shell among them, show text and nothing else."""


class _OnScreen:
    """Shows its bar, where it has one, as long as the block lasts; gone when it is over."""

    _bar: "RichProgress | None" = None

    def __enter__(self) -> Self:
        if self._bar is not None:
            self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar is not None:
            self._bar.stop()


def _bar_of(columns: "Callable[[ModuleType, int], tuple[ProgressColumn, ...]]") -> "RichProgress | None":
    """A bar of these columns of `rich.progress`, for a terminal of such a width. Loaded for a terminal alone; None
    elsewhere, and on one that moves no cursor back, where a bar would stay unseen until the end."""
    if terminal.verbosity < 0 or not sys.stderr.isatty() or os.environ.get("TERM", "").lower() in DUMB:
        return None
    from rich import progress
    from rich.console import Console

    console = Console(file=getattr(sys.stderr, "sent", sys.stderr))
    return progress.Progress(*columns(progress, console.width), console=console, transient=True)


def _text(rich: ModuleType, field: str, widest: int | None = None) -> "ProgressColumn":
    """A column of a task's text as it is, cut off where it is wider: brackets in a file's name are no styles. `escaped`
    before it comes here, for the bar writes below what escapes the rest."""
    column = _firm(widest)
    return rich.TextColumn(f"{{task.{field}}}", markup=False, table_column=column)  # type: ignore[no-any-return]


def _firm(widest: int | None = None) -> "Column":
    """A column that keeps its width where others give way."""
    from rich.table import Column

    return Column(no_wrap=True, max_width=widest, overflow="ellipsis" if _unicode() else "crop")


def _unicode() -> bool:
    """Whether the terminal has more than letters: elsewhere what it lacks is written out, and fills its lines."""
    return (getattr(sys.stderr, "encoding", None) or "").lower().startswith("utf")


def _counting(rich: ModuleType, width: int) -> "tuple[ProgressColumn, ...]":
    """What is being done, how much of it, how fast and how long still; a long name makes room for figures."""
    of, left = rich.MofNCompleteColumn(table_column=_firm()), _text(rich, "fields[left]")
    if width < NARROW:
        return _text(rich, "description", max(width - 24, 4)), of, left
    pace = _text(rich, "fields[rate]", 3 * width // 10)
    return _text(rich, "description", width - 52), rich.BarColumn(), of, pace, left


def _on_the_clock(left_s: float | None) -> str:
    """As a clock shows it: hours, minutes, seconds."""
    if left_s is None:
        return "-:--:--"
    minutes, seconds = divmod(round(left_s), 60)
    return f"{minutes // 60}:{minutes % 60:02}:{seconds:02}"


class Stages(_OnScreen, logging.Handler):
    """Where nobody knows how many steps there are: the newest message of `logger`, and the time since the beginning
    ticking beside it, on a terminal; a line every ten seconds elsewhere."""

    def __init__(self, what: str, logger: str, line_s: float = _LINE_S) -> None:
        super().__init__(logging.DEBUG)
        self._logger = logging.getLogger(logger)
        self._level = self._logger.level
        self._what, self._line_s, self._shown_s = what, line_s, time.monotonic()
        self._begun_s = self._shown_s
        self._bar = _bar_of(lambda rich, width: (
            rich.SpinnerColumn("dots" if _unicode() else "line"), _text(rich, "description", max(width - 10, 4)),
            rich.TimeElapsedColumn(table_column=_firm()),
        ))  # fmt: skip
        if self._bar is not None:
            self._task = self._bar.add_task(escaped(what), total=None)

    def __enter__(self) -> Self:
        self._level = self._logger.level
        self._logger.setLevel(logging.DEBUG)
        self._logger.addHandler(self)
        return super().__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._logger.removeHandler(self)
        self._logger.setLevel(self._level)
        super().__exit__(kind, error, trace)

    def emit(self, record: logging.LogRecord) -> None:
        """What is being done now."""
        stage, now = record.getMessage(), time.monotonic()
        if self._bar is not None:
            self._bar.update(self._task, description=escaped(f"{self._what}: {stage}"), refresh=True)
        elif now - self._shown_s >= self._line_s:
            self._shown_s = now
            terminal.log(f"{self._what}: {stage}, {now - self._begun_s:.0f} s so far")


class Progress(_OnScreen):
    """Counts steps; shows them on stderr at most ten times a second, or a line every ten seconds off a terminal."""

    def __init__(
        self, total: int | None, done: int = 0, what: str = "scan", unit: str = "points", line_s: float = _LINE_S
    ) -> None:
        """`total`: None where nobody knows how many there will be."""
        self._what, self._unit, self._line_s = what, unit, line_s
        self._total, self._done, self._begun_with = total, done, done
        self._begun_s = self._shown_s = self._hidden_s = time.monotonic()
        self._bar = _bar_of(_counting)
        if self._bar is not None:
            self._task = self._bar.add_task(
                escaped(what), total=total, completed=done, rate="", left=_on_the_clock(None)
            )

    def step(self, by: int = 1, note: str = "", times_as_long: float | None = None) -> None:
        """So many more are done; `note` is shown beside the pace. `times_as_long`: how many times as long
        as those of this block took the rest takes, where somebody knows; else all are alike."""
        self._done += by
        now = time.monotonic()
        if now - self._shown_s < (_BAR_S if self._bar is not None else self._line_s):
            return
        self._shown_s = now
        begun_for_s = max(now - self._begun_s, 1e-9)
        rate = (self._done - self._begun_with) / begun_for_s
        left_s = None
        if self._total is not None and rate > 0:
            left_s = (self._total - self._done) / rate if times_as_long is None else times_as_long * begun_for_s
        pace = f"{rate:.0f} {self._unit}/s" if rate >= 10 else f"{60 * rate:.1f} {self._unit}/min"
        pace += note
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, rate=pace, left=_on_the_clock(left_s))
        else:
            of = "" if self._total is None else f" of {self._total}"
            left = "" if left_s is None else f", {left_s:.0f} s left"
            terminal.log(f"{self._done}{of} {self._unit}, {pace}{left}")

    def at(self, stage: str) -> None:
        """What is being done now, named in the bar; off a terminal the lines' own business."""
        if self._bar is not None:
            # At once: a stage that is over before the next tick of the bar is seen, too.
            self._bar.update(
                self._task, description=escaped(f"{self._what}: {stage}"), completed=self._done, refresh=True
            )

    def going_to(self, total: int) -> None:
        """How many there will be, once that is known."""
        self._total = total
        if self._bar is not None:
            self._bar.update(self._task, total=total)

    def hide(self) -> None:
        """Makes room for a question. Until `show` no step is waited for, so that time is none of the pace."""
        self._hidden_s = time.monotonic()
        if self._bar is not None:
            self._bar.stop()

    def show(self) -> None:
        """Shows the bar, again or for the first time."""
        self._begun_s += time.monotonic() - self._hidden_s
        if self._bar is not None:
            self._bar.start()
