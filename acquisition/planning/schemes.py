"""Which way of scanning is the fastest that bench and plan allow, and why."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial

import numpy as np

from nlos.acquisition.planning.aim import Aiming
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of
from nlos.acquisition.planning.timing import Forecast, Links, clocked_forecast, links_of, moves_s, stepped_forecast
from nlos.acquisition.scanning.lag import Lag
from nlos.acquisition.scanning.lag_trial import LEAST, MOST, USUAL, first_guess_s, trial
from nlos.acquisition.scanning.sweeping import LineRefused, Lines, sweep
from nlos.drivers.bench import Bench
from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles, own_clock

FORECAST_POINTS = 1 << 15
"""Points of the beginning of a film, and as many again, from which a forecast takes what a longer one costs."""


class Scheme(Enum):
    """How mirror and counter are kept in step."""

    STEPPED = "S1"
    """The host moves the mirror and starts each point."""
    CLOCKED = "S2"
    """The counter's pixel clock steps the mirror through an uploaded sequence."""
    LISTED = "S3"
    """The same, with histograms sorted out of a stream of photons by the mirror's markers."""
    PLAYED = "S3, the mirror's own clock"
    """The mirror plays an uploaded sequence on its own clock, and its marks begin the counter's points."""
    SWEPT = "S2, continuous lines"
    """The clock keeps the mirror moving along lines: for plans that allow it, with dwells below the settling time."""

    @property
    def words(self) -> str:
        """What the letter and number stand for, after them."""
        return f"{self.value} ({self._meaning})"

    @property
    def _meaning(self) -> str:
        return {
            Scheme.STEPPED: "the computer moves the mirror to each point",
            Scheme.CLOCKED: "the counter's clock steps the mirror",
            Scheme.LISTED: "the counter's clock steps the mirror; points sorted out of a stream of photons",
            Scheme.PLAYED: "it plays the points, and the counter follows",
            Scheme.SWEPT: "the mirror never rests on a line",
        }[self]


@dataclass(frozen=True)
class Choice:
    """A scheme, why this one, and how long it should take."""

    scheme: Scheme
    why: str
    forecast: Forecast
    otherwise: "Choice | None" = None
    """Of continuous lines: by points, should the lag that is measured first take the lines too far."""

    @property
    def said(self) -> str:
        """As the event log of a recording keeps it."""
        most = "" if self.forecast.certain == 1.0 else "at most "
        return f"{self.scheme.words}, {most}{self.forecast.total_s:.1f} s expected; {self.why}"


def choose(
    plan: ScanPlan,
    bench: Bench,
    angles: Sequence[MirrorAngles],
    links: Links | None = None,
    lag: Lag | None = None,
    aim: Aiming | None = None,
) -> Choice:
    """The fastest scheme, for `angles` that `aim` made: the bench file's geometry, unless told. Clocked ones need a
    sequence in the mirror, a clock in the counter, and the marker wires without which nobody would notice that the two
    are out of step; or a mirror with its own clock, whose marks begin the counter's points."""
    found = _fastest(plan, bench, angles, links or links_of(bench), lag, aim)
    if plan.budget is None or plan.budget.after_first:
        return found
    return replace(found, forecast=_by_any_dwell(found.forecast, plan))


def _by_any_dwell(forecast: Forecast, plan: ScanPlan) -> Forecast:
    """That of a budget's points as they come, or of those that take longest, of which whoever advises may choose all.

    The budget counts so much beside a dwell; a bench that takes less of it, or more, is done sooner or later by as many
    points fewer."""
    assert plan.budget is not None
    costs_us = plan.budget.costs_us(plan.dwell_s)
    longest = np.argsort(-costs_us)[: plan.budget.first(-np.sort(-costs_us), plan.budget.total_us)]
    beside_s = (forecast.total_s - forecast.dwell_s) / max(len(plan.expected()), 1)
    more_s = float(plan.dwell_s[longest].sum()) + len(longest) * beside_s - forecast.total_s
    return replace(
        forecast, sooner_s=forecast.sooner_s + max(-more_s, 0.0), later_s=forecast.later_s + max(more_s, 0.0)
    )


def _fastest(
    plan: ScanPlan,
    bench: Bench,
    angles: Sequence[MirrorAngles],
    links: Links,
    lag: Lag | None,
    aim: Aiming | None,
) -> Choice:
    plan, angles = _expected(plan, angles)
    stepped = _of_frames(stepped_forecast, plan, bench, angles, links)
    if obstacle := _obstacle(bench):
        return Choice(Scheme.STEPPED, obstacle, stepped)
    scheme = Scheme.LISTED if bench.counter.list_mode else Scheme.CLOCKED
    if own_clock(bench.mirror) is not None:
        scheme = Scheme.PLAYED
        if plan.stop is not None:
            return Choice(Scheme.STEPPED, "points that end early need a mirror that waits for them", stepped)
    try:
        clocked = _of_frames(clocked_forecast, plan, bench, angles, links)
    except LimitError as error:
        if scheme is not Scheme.PLAYED:
            raise
        return Choice(Scheme.STEPPED, f"not by its own clock: {error.what}", stepped)
    points = Choice(Scheme.STEPPED, f"clocked it would take {clocked.total_s:.1f} s", stepped)
    if clocked.total_s < stepped.total_s:
        points = Choice(scheme, f"stepped by the host it would take {stepped.total_s:.1f} s", clocked)
    if (
        scheme is not Scheme.PLAYED
        and plan.within_px is not None
        and np.median(plan.dwell_s) < np.median(moves_s(bench, angles[:FORECAST_POINTS]))
    ):
        try:
            if lag is not None and lag.refused:
                raise LineRefused("mirror", lag.refused)
            swept = _of_frames(partial(_swept_forecast, lag=lag, aim=aim), plan, bench, angles, links)
        except LineRefused as error:
            return replace(points, why=f"not in continuous lines: {error.what}")
        if swept.total_s < points.forecast.total_s:
            why = f"settling at every point it would take {points.forecast.total_s:.1f} s"
            return Choice(Scheme.SWEPT, why, swept, points)
    return points


def forecast(
    scheme: Scheme,
    plan: ScanPlan,
    bench: Bench,
    angles: Sequence[MirrorAngles],
    lag: Lag | None = None,
    aim: Aiming | None = None,
) -> Forecast:
    """How long the plan takes in `scheme`; continuous lines with the usual measurement of the lag before them where it
    is not known. Raises `LineRefused` for lines that cannot be swept."""
    links = links_of(bench)
    plan, angles = _expected(plan, angles)
    if scheme is Scheme.STEPPED:
        return _of_frames(stepped_forecast, plan, bench, angles, links)
    if scheme is not Scheme.SWEPT:
        return _of_frames(clocked_forecast, plan, bench, angles, links)
    return _of_frames(partial(_swept_forecast, lag=lag, aim=aim), plan, bench, angles, links)


def _swept_forecast(
    plan: ScanPlan,
    bench: Bench,
    angles: Sequence[MirrorAngles],
    links: Links,
    lag: Lag | None,
    aim: Aiming | None,
) -> Forecast:
    lines = continuous_lines(plan, bench, angles, aim)
    if lag is not None:
        lines.lag_s = lag.lag_s
        return clocked_forecast(plan, bench, angles, links, partial(sweep, lines=lines))
    lines.lag_s = first_guess_s(lines, bench.mirror.settle_s)
    most = min(bench.mirror.max_sequence, bench.counter.max_points)
    before = trial(plan, lines, bench.mirror.settle_s, most, bench.counter.list_mode, 0).made
    usual = clocked_forecast(plan, bench, angles, links, partial(sweep, lines=lines), [before] * USUAL)
    each_s = before.duration_s + links.sequence_s
    return replace(usual, sooner_s=(USUAL - LEAST) * each_s, later_s=(MOST - USUAL) * each_s)


def continuous_lines(plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles], aim: Aiming | None = None) -> Lines:
    """The plan's lines, for a mirror without lag. Raises `ValueError` where it does not allow any."""
    if plan.within_px is None:
        raise ValueError("the plan does not allow continuous lines")
    return Lines(plan, bench, angles, aim or aim_of(bench))


def _expected(plan: ScanPlan, angles: Sequence[MirrorAngles]) -> tuple[ScanPlan, Sequence[MirrorAngles]]:
    """Of candidates those that are taken if nobody says otherwise: what can be forecast."""
    if plan.budget is None or len(plan) == plan.most_samples:
        return plan, angles
    numbers = plan.expected()
    return plan.only(numbers), [angles[number] for number in numbers.tolist()]


def _of_frames(
    of: Callable[[ScanPlan, Bench, Sequence[MirrorAngles], Links], Forecast],
    plan: ScanPlan,
    bench: Bench,
    angles: Sequence[MirrorAngles],
    links: Links,
) -> Forecast:
    """The forecast of a plan; of a film whose frames are many from those of its beginning, as later ones are alike."""
    cycle = int(np.count_nonzero(plan.pass_ < plan.cycle)) if plan.frames > 1 else len(plan)
    short = -(-FORECAST_POINTS // cycle) * cycle
    if 2 * short >= len(plan):
        return of(plan, bench, angles, links)
    once, twice = (of(plan.only(np.arange(count)), bench, angles[:count], links) for count in (short, 2 * short))
    return once.extended(twice, len(plan) / short)


def _obstacle(bench: Bench) -> str:
    own = own_clock(bench.mirror) is not None
    if bench.mirror.max_sequence < 2 and not own:
        return f"mirror {bench.mirror.identity.model} cannot step by itself"
    if own and not bench.counter.follows_mirror:
        return f"counter {bench.counter.identity.model} is not wired to follow the mirror's own clock"
    if not bench.counter.has_pixel_clock and not own:
        return f"counter {bench.counter.identity.model} has no pixel clock"
    if not bench.counter.counts_markers:
        return "the mirror's marker outputs are not wired to the counter, so its steps could not be counted"
    return ""
