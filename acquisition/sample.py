"""One point of a scan: where, for how long, and what arrived."""

from dataclasses import dataclass

from nlos.drivers.tcspc.counter import Histogram

PAUSE_S = 10.0


def is_pause(between_s: float, dwell_s: float) -> bool:
    """Whether so long a time between the ends of two samples is a pause, or a scan that was resumed later: it tells
    nothing of the pace at which points are taken."""
    return between_s > PAUSE_S + 10 * dwell_s


@dataclass(frozen=True)
class ScanPoint:
    """A planned point. `number` is unique within its plan, all passes included; `row`, `col` are None off the grid."""

    number: int
    row: int | None
    col: int | None
    x_m: float
    y_m: float
    dwell_s: float
    pass_: int = 0


@dataclass(frozen=True)
class Sample:
    """A measured point: what live scans, replays and followed files all consist of."""

    point: ScanPoint
    histogram: Histogram
    taken_s: float
    """Bench time at which the dwell began, seconds since the scan's start."""
