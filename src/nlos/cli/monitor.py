"""`nlos monitor`: rates, sync, direct peak and histogram as they change, while somebody turns a screw."""

import csv
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from nlos.by_hand import lines
from nlos.by_hand.opening import in_hand
from nlos.by_hand.row import COLUMNS, row
from nlos.by_hand.screen import screen_of_terminal
from nlos.by_hand.summary import Summary
from nlos.by_hand.viewer import Viewer, viewer
from nlos.cli.benches import load_bench
from nlos.cli.exit_codes import UsageError
from nlos.cli.named_files import BenchWord
from nlos.cli.point import ELSEWHERE, LIGHT, LIVE, PORT
from nlos.cli.seconds import check_seconds
from nlos.cli.targets import log_target
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.by_hand.hand import Hand

_LINE_S = 1.0


def monitor(
    bench: BenchWord = None,
    light: Annotated[float | None, LIGHT] = None,
    at: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X_M Y_M", help="Send the beam there first; the mirror is left alone otherwise."),
    ] = None,
    gate: Annotated[
        str | None, typer.Option(metavar="START:END", help="Show this part of the period, ns; all of it by default.")
    ] = None,
    seconds: Annotated[float | None, typer.Option("--for", metavar="SECONDS", help="Stop after this long.")] = None,
    log: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="Write every update there.")] = None,
    live: Annotated[bool, LIVE] = False,
    port: Annotated[int, PORT] = 0,
    no_shutter: Annotated[bool, ELSEWHERE] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Shows what the counter sees, more than ten times a second on a terminal and as a line a second elsewhere. Light
    only for --light seconds, or while SPACE is held. `q` ends."""
    window = _window(gate)
    check_seconds("--for", seconds, may_be_none_at_all=False)
    if log is not None:
        log_target(log, overwrite)
    table = load_bench(bench)
    period_s = 1 / table.settings.laser.repetition_hz
    if window is not None and window[0] >= period_s:
        raise UsageError(f"--gate {gate}: must begin within the laser's period of {period_s * 1e9:g} ns")
    wanted = {"counter"} | (set() if at is None else {"mirror"})
    with (
        viewer(live, port) as page,
        _summed_up(log) as summary,
        in_hand(table, wanted, light, no_shutter) as hand,
        _logged(log) as write,
    ):
        summary.light = hand.light if hand.light_is_known else None
        if hand.watch is None:
            raise hand.bench.absent["counter"]
        if window is not None:
            hand.look_at(*window)
        if at is not None:
            if hand.reach is None:
                raise hand.bench.absent["mirror"]
            hand.move_to(hand.reach.angles_of(*at))
        if light is not None:
            hand.ask_for_light(light)
        until_s = time.monotonic() + (math.inf if seconds is None else seconds)
        if hand.keys.there and not terminal.as_json:
            with screen_of_terminal(hand.stops) as screen:
                for _ in _updates(hand, until_s, write, page):
                    summary.add(hand)
                    screen.draw(_lines(hand, screen.size.columns, screen.size.lines, page))
        else:
            _print_lines(hand, until_s, summary, write, page)
        terminal.document.update(row(hand))


@contextmanager
def _summed_up(log: Path | None) -> Iterator[Summary]:
    """However the watching ends, one line of it stays on the terminal, and where the log is."""
    summary = Summary()
    try:
        yield summary
    finally:
        if summary.updates:
            terminal.result(summary.line(), **summary.values())
            if log is not None:
                terminal.result(f"{log}: every update", log=str(log))


def _updates(hand: "Hand", until_s: float, write: "Writer", page: "Viewer | None") -> Iterator[None]:
    while time.monotonic() < until_s:
        hand.update()
        write(row(hand))
        if page is not None:
            page.show(hand)
        yield
        if "q" in hand.pressed():
            return


def _print_lines(hand: "Hand", until_s: float, summary: Summary, write: "Writer", page: "Viewer | None") -> None:
    said_s = -math.inf
    for _ in _updates(hand, until_s, write, page):
        summary.add(hand)
        if time.monotonic() - said_s >= _LINE_S:
            said_s = time.monotonic()
            values = [" ".join(each.split()) for each in (*lines.counts(hand), lines.light(hand))]
            terminal.result("; ".join(values))


def _lines(hand: "Hand", columns: int, rows: int, page: "Viewer | None") -> list[str]:
    shown = [
        *lines.heading(hand),
        *lines.address("" if page is None else page.url),
        "",
        *lines.beam(hand),
        lines.light(hand),
        *lines.counts(hand),
        "",
    ]
    return [
        *shown,
        *lines.histogram(hand, columns - 1, rows - len(shown) - 5, True),
        *lines.notes(hand, columns),
        "q ends",
    ]


class Writer:
    """Rows of the log, each on its way to the disk as it is written; nowhere without a file."""

    def __init__(self, file: Any = None) -> None:
        self._file = file

        self._table = None if file is None else csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if self._table is not None:
            self._table.writeheader()

    def __call__(self, row: dict[str, Any]) -> None:
        if self._table is not None and row:
            self._table.writerow(row)
            self._file.flush()


@contextmanager
def _logged(path: Path | None) -> Iterator[Writer]:
    if path is None:
        yield Writer()
        return
    path.parent.mkdir(exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        yield Writer(file)


def _window(gate: str | None) -> tuple[float, float] | None:
    """Seconds. Raises `UsageError` for what is no window."""
    if gate is None:
        return None
    try:
        start, end = (float(each) * 1e-9 for each in gate.split(":"))
    except ValueError:
        raise UsageError(f"--gate {gate}: two times in ns with a colon between them, such as 10:30") from None
    if not 0 <= start < end < math.inf:
        raise UsageError(f"--gate {gate}: must begin at 0 or later, and end after its beginning")
    return start, end
