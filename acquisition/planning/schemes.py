"""Which way of scanning is the fastest that bench and plan allow, and why."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from functools import partial

import numpy as np

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.timing import Forecast, Links, clocked_forecast, links_of, moves_s, stepped_forecast
from nlos.acquisition.scanning.clocked import Sequencer, stepping
from nlos.acquisition.scanning.sweeping import Lines, sweep
from nlos.drivers.bench import Bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles


class Scheme(Enum):
    """How mirror and counter are kept in step."""

    STEPPED = "S1"
    """The host moves the mirror and starts each point."""
    CLOCKED = "S2"
    """The counter's pixel clock steps the mirror through an uploaded sequence."""
    LISTED = "S3"
    """The same, with histograms sorted out of a stream of photons by the mirror's markers."""
    SWEPT = "S2, continuous lines"
    """The clock keeps the mirror moving along lines: for plans that allow it, with dwells below the settling time."""


@dataclass(frozen=True)
class Choice:
    """A scheme, why this one, and how long it should take."""

    scheme: Scheme
    why: str
    forecast: Forecast


def choose(plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles], links: Links | None = None) -> Choice:
    """The fastest scheme. Clocked ones need a sequence in the mirror, a clock in the counter, and the marker wires
    without which nobody would notice that the two are out of step."""
    links = links or links_of(bench)
    stepped = stepped_forecast(plan, bench, angles, links)
    if obstacle := _obstacle(bench):
        return Choice(Scheme.STEPPED, obstacle, stepped)
    scheme = Scheme.LISTED if bench.counter.list_mode else Scheme.CLOCKED
    clocked = clocked_forecast(plan, bench, angles, links)
    if plan.lag_s is not None and np.median(plan.dwell_s) < np.median(moves_s(bench, angles)):
        try:
            swept = clocked_forecast(plan, bench, angles, links, sequencer(Scheme.SWEPT, plan, angles))
        except LimitError as error:
            return Choice(scheme, f"not in continuous lines: {error.what}", clocked)
        if swept.total_s < min(clocked.total_s, stepped.total_s):
            return Choice(Scheme.SWEPT, f"settling at every point it would take {clocked.total_s:.1f} s", swept)
    if clocked.total_s < stepped.total_s:
        return Choice(scheme, f"stepped by the host it would take {stepped.total_s:.1f} s", clocked)
    return Choice(Scheme.STEPPED, f"clocked it would take {clocked.total_s:.1f} s", stepped)


def forecast(
    scheme: Scheme, plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles], links: Links | None = None
) -> Forecast:
    """How long the plan takes in `scheme`."""
    links = links or links_of(bench)
    if scheme is Scheme.STEPPED:
        return stepped_forecast(plan, bench, angles, links)
    return clocked_forecast(plan, bench, angles, links, sequencer(scheme, plan, angles))


def sequencer(scheme: Scheme, plan: ScanPlan, angles: Sequence[MirrorAngles]) -> Sequencer:
    """How a clocked scheme makes sequences of points. Raises `ValueError` for continuous lines that the plan does not
    allow."""
    if scheme is not Scheme.SWEPT:
        return stepping
    if plan.lag_s is None:
        raise ValueError("the plan does not allow continuous lines: it states no lag")
    return partial(sweep, lines=Lines(plan, angles, plan.lag_s))


def _obstacle(bench: Bench) -> str:
    if bench.mirror.max_sequence < 2:
        return f"mirror {bench.mirror.identity.model} cannot step by itself"
    if not bench.counter.has_pixel_clock:
        return f"counter {bench.counter.identity.model} has no pixel clock"
    if not bench.counter.counts_markers:
        return "the mirror's marker outputs are not wired to the counter, so its steps could not be counted"
    return ""
