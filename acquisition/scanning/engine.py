"""Runs a plan on a bench: every limit checked before anything moves, light only while acquiring, samples as they come.

However the scan ends - complete, paused, by an error, or because the consumer walked away - the shutter is closed
before anything else happens.
"""

import contextlib
import logging
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol

from nlos.acquisition.planning.aim import Aiming
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Choice, Scheme, choose, continuous_lines, forecast
from nlos.acquisition.recording.ended_as_asked import KIND, NOTHING_LEFT
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning import clocked, lag_trial, stepped
from nlos.acquisition.scanning.advice import Adviser
from nlos.acquisition.scanning.alarms import DONE, Action, AlarmRaised, Alarms, Trouble, sentence
from nlos.acquisition.scanning.control import ScanControl, ScanState, undeterred, until_interrupted
from nlos.acquisition.scanning.dark import dark, dark_whatever_happens, shut
from nlos.acquisition.scanning.lag import Lag
from nlos.acquisition.scanning.left_to_take import LeftToTake
from nlos.acquisition.scanning.light_watch import LightOff, LightWatch
from nlos.acquisition.scanning.sweeping import LineRefused, Lines, sweep
from nlos.acquisition.scanning.under_way import UnderWay
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceError, MirrorDisturbed, SafetyTrip
from nlos.drivers.galvo.mirror import KeepsSettings, MirrorAngles

_log = logging.getLogger(__name__)


class Sink(Protocol):
    """Whatever takes samples: a recording, a stream to another machine."""

    def write(self, sample: Sample) -> None: ...


def scan(
    plan: ScanPlan,
    bench: Bench,
    *,
    aim: Aiming | None = None,
    taken: Mapping[int, int] | None = None,
    scheme: Scheme | None = None,
    control: ScanControl | None = None,
    alarms: Alarms | None = None,
    decide: Callable[[], bool] | None = None,
    decided: Sequence[int] = (),
    elapsed_s: float = 0.0,
    lag: Lag | None = None,
    adviser: Adviser | None = None,
) -> Generator[Sample, None, None]:
    """Checks the plan at once (`LimitError`), then yields its samples as they are taken.

    `taken`: point number -> photons of what an earlier recording already holds, `elapsed_s` how long that took.
    `scheme`: the fastest that bench and plan allow, unless told. `alarms` may pause, postpone or end. `decide` is asked
    after every sample, and once before the light of a scan that is resumed, whether the scan may end early; where a
    first pass is followed by a second, the first yes ends the first. `decided`: after how many of the samples in
    `taken` it had said yes. `adviser` says which candidates of a plan with a budget come next. Continuous lines are
    swept by `lag`, or by what is measured before them; where they do not fit by that, or it cannot be measured, points
    are taken one by one, unless `scheme` asks for lines. Raises `DeviceError` with the shutter closed.
    """
    aim = aim or aim_of(bench)
    angles = checked_angles(plan, bench, aim)
    if scheme is not None and lag is not None and lag.refused:
        lag = None  # whoever asks for lines by name has them measured again
    choice = choose(plan, bench, angles, lag=lag, aim=aim)
    if scheme is not None:
        expected = choice.forecast if scheme is choice.scheme else forecast(scheme, plan, bench, angles, lag, aim)
        choice = Choice(scheme, "as asked for", expected)
    start_s = bench.clock.now() - elapsed_s
    under_way = UnderWay(control or ScanControl(), start_s, alarms, decide, adviser, decided, lag)
    lines = continuous_lines(plan, bench, angles, aim) if choice.scheme is Scheme.SWEPT else None
    return _Run(plan, bench, angles, dict(taken or {}), under_way, lines).samples(choice)


def record(
    samples: Generator[Sample, None, None], writer: Sink, on_sample: Callable[[Sample], None] | None = None
) -> None:
    """Hands every sample to `writer`, then to `on_sample`. However it ends, the source is closed first, dark."""
    with contextlib.closing(samples):
        for sample in samples:
            writer.write(sample)
            if on_sample is not None:
                on_sample(sample)


class _Run:
    """One scan under way."""

    def __init__(
        self,
        plan: ScanPlan,
        bench: Bench,
        angles: Sequence[MirrorAngles],
        photons: dict[int, int],
        under_way: UnderWay,
        lines: Lines | None,
    ) -> None:
        self._plan, self._bench, self._angles = plan, bench, angles
        self._under_way, self._control, self._alarms = under_way, under_way.control, under_way.alarms
        self._lag, self._lines = under_way.lag, lines
        self._before = tuple(photons)
        self._left = LeftToTake(plan, bench, photons, under_way.adviser)
        self._take: Callable[..., Iterator[Sample]] = stepped.take
        self._alarm: Trouble | None = None
        self._warned = set(bench.warnings)

    def samples(self, choice: Choice) -> Generator[Sample, None, None]:
        control, bench = self._control, self._bench
        bench.check_open()
        if not control.wanted:
            bench.shutter.release()
        self._takes_by(choice)
        control.enter(ScanState.RUNNING)
        try:
            if self._decided_before_light():
                return
            undeterred(self._look_around)
            undeterred(partial(bench.counter.configure, self._plan.axis, self._plan.stop))
            if self._lines is not None:
                self._sweep_or(choice.otherwise, self._lines)
                if control.state is not ScanState.RUNNING:
                    return
            while todo := self._left.numbers(bench.counter.max_points):
                if not control.wanted:
                    self._left.check_progress(todo[0])
                    yield from self._segment(todo)
                if control.wanted:
                    self._left.forget_first()  # a pause is no lack of progress
                    if control.state is ScanState.RUNNING:
                        self._pause()
                if control.state is not ScanState.RUNNING:
                    return
            dark(self._bench, "the scan is over" if self._left.first_pass_cut else "the scan is complete")
            if self._left.first_pass_cut:
                self._bench.report(KIND, NOTHING_LEFT)
            control.enter(ScanState.ENDED if self._left.first_pass_cut else ScanState.COMPLETE)
        except SafetyTrip as error:
            shut(bench, error)
            if control.state is not ScanState.STOPPED:
                control.enter(ScanState.STOPPED)
            raise
        except DeviceError:
            control.enter(ScanState.FAILED)
            raise
        finally:
            bench.announce(())
            if control.state is ScanState.RUNNING:
                control.enter(ScanState.ENDED)
            if control.state is not ScanState.COMPLETE and not bench.closed:
                dark_whatever_happens(bench)

    def _takes_by(self, choice: Choice) -> None:
        self._take = stepped.take if choice.scheme is Scheme.STEPPED else clocked.take
        self._control.scheme, self._control.expected_s = choice.scheme.value, choice.forecast.total_s
        self._bench.report("scheme", choice.said)

    def _sweep_or(self, points: Choice | None, lines: Lines) -> None:
        """Sweeps lines once their lag is known; takes `points`, where there are any, if lines cannot lead by it, or it
        cannot be measured."""
        mirror, counter, began_s = self._bench.mirror, self._bench.counter, self._bench.clock.now()
        try:
            if (lag := self._known_lag(lines)) is not None:
                lines.lag_s = lag.lag_s
                lines.check(mirror.settle_s, min(mirror.max_sequence, counter.max_points))
            self._take = partial(clocked.take, sequencer=partial(sweep, lines=lines))
        except LineRefused as error:
            if points is None:
                raise
            dark(self._bench, "lines that are not swept")
            if error.lag is not None:
                self._bench.report("lag", error.lag.text())
            self._takes_by(replace(points, why=f"not in continuous lines: {error.what}"))
            self._control.expected_s = self._bench.clock.now() - began_s + points.forecast.total_s

    def _known_lag(self, lines: Lines) -> Lag | None:
        """By how much the mirror trails them: as known, or measured now; paused and ended as ever."""
        while self._lag is None and self._control.state is ScanState.RUNNING:
            try:
                if not self._control.wanted:
                    self._lag = lag_trial.measure(self._plan, self._bench, lines, self._under_way)
            except lag_trial.TrialEnded as ended:
                self._meet(ended.trouble, None)
            if self._lag is None:
                self._pause()
        if self._lag is not None:
            self._bench.report("lag", self._lag.text())
        return self._lag

    def _segment(self, numbers: Sequence[int]) -> Iterator[Sample]:
        """The samples of one armed batch, until it ends, a pause is wanted or a point has to be taken again."""
        points = [self._plan[number] for number in numbers]
        angles = [self._angles[number] for number in numbers]
        watch = LightWatch(self._bench, self._alarms, self._left.is_taken_again)
        self._bench.while_waiting = watch.look
        try:
            source = self._take(self._bench, points, angles, self._under_way, watch)
            yield from self._kept(source)
        except LightOff:
            pass  # while the batch was being armed: `watch` says why
        except MirrorDisturbed as error:
            self._warned.discard(said := error.said)
            self._warn([said])
            dark(self._bench, error.what)
            self._bench.mirror.park()
        finally:
            self._bench.while_waiting = lambda: None
        if watch.trip is not None:
            raise watch.trip
        if watch.trouble is not None:
            self._meet(watch.trouble, watch.number)

    def _kept(self, source: Iterator[Sample]) -> Iterator[Sample]:
        """Samples as they are confirmed, until one has to be taken again or there is nothing left to gain."""
        for sample in until_interrupted(source, self._control):
            if self._left.is_spoilt(sample):
                return
            self._left.took(sample)
            yield sample
            self._bench.check_open()
            self._warn(self._bench.warnings)
            if self._under_way.decide is not None and self._under_way.decide():
                self._end_early(sample.point)
                return

    def _decided_before_light(self) -> bool:
        """Whether the scan is over. What was decided after samples of an earlier recording stands; what was still to be
        decided then is now."""
        under_way, before = self._under_way, self._before
        for count in under_way.decided:
            if self._control.state is ScanState.RUNNING:
                self._end_early(self._plan[before[count - 1]])
        undecided = before and len(before) not in under_way.decided and self._control.state is ScanState.RUNNING
        if undecided and under_way.decide is not None and under_way.decide():
            self._end_early(self._plan[before[-1]])
        return self._control.state is not ScanState.RUNNING

    def _end_early(self, point: ScanPoint) -> None:
        """Ends the first pass where another follows, else the scan."""
        if self._plan.revisit_below is not None and point.pass_ == 0 and not self._left.first_pass_cut:
            self._bench.report("scan", "the first pass is ended early: the second begins")
            self._left.first_pass_cut = True
            return
        self._bench.report(KIND, NOTHING_LEFT)
        self._control.enter(ScanState.ENDED)

    def _look_around(self) -> None:
        """What the alarms say while the shutter is closed."""
        if self._alarms is not None and (trouble := self._alarms.before(self._bench)) is not None:
            self._meet(trouble, None)

    def _meet(self, trouble: Trouble, number: int | None) -> None:
        """Does what the alarm says. Raises `AlarmRaised` where that ends the scan."""
        done = trouble.action
        if done is Action.SKIP and (number is None or not self._left.postpone(number)):
            done = Action.ABORT
        self._bench.report("alarm", f"{trouble.name}: {sentence(trouble.text)} {DONE[done]}")
        if done is Action.PAUSE:
            self._alarm = trouble
            self._control.interrupt(f"alarm: {trouble.text}")
        elif done is Action.ABORT:
            raise AlarmRaised("alarm", sentence(trouble.text), trouble.cure)

    def _pause(self) -> None:
        """Light off, gate closed, then somebody decides. Raises `AlarmRaised` where an alarm's pause ends the scan."""
        why, alarm, self._alarm = self._control.wanted, self._alarm, None
        dark(self._bench, why)
        paused = f"paused by {why}" if alarm is None else f"paused: {why}"
        self._bench.report("scan", paused)
        going = self._control.pause(ScanState.STOPPED if alarm is not None else ScanState.ENDED)
        self._bench.report("scan", "resumed" if going else f"ended while {paused}")
        if going:
            undeterred(self._set_up_again)
            self._bench.shutter.release()
            undeterred(self._look_around)
        elif alarm is not None:
            raise AlarmRaised("alarm", sentence(alarm.text), alarm.cure)

    def _set_up_again(self) -> None:
        """In the dark: nobody spoke to the instruments while somebody was asked, and what was switched off and on again
        has forgotten what it was told."""
        bench = self._bench
        if isinstance(bench.mirror, KeepsSettings):
            bench.mirror.restore()
        bench.counter.configure(self._plan.axis, self._plan.stop)
        self._warn(bench.warnings)

    def _warn(self, warnings: Sequence[str]) -> None:
        """Whoever watches, and the recording, of those that are new."""
        for said in (each for each in warnings if each not in self._warned):
            self._warned.add(said)
            _log.warning(said)
            self._bench.report("warning", said)
