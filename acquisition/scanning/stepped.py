"""Scheme S1: the host steps the mirror; while it moves on, the point just taken is read."""

from collections.abc import Iterator, Sequence

from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.control import ScanControl
from nlos.acquisition.scanning.light_watch import LightOff, LightWatch
from nlos.acquisition.scanning.under_way import UnderWay
from nlos.drivers.bench import Bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.counter import PointGates

LOOK_S = 0.25
"""Within a longer dwell, how often a request to pause is looked for."""
GRACE_S = 2.0
"""How much later than its dwell a point may be complete."""


def take(
    bench: Bench,
    points: Sequence[ScanPoint],
    angles: Sequence[MirrorAngles],
    under_way: UnderWay,
    watch: LightWatch,
) -> Iterator[Sample]:
    """Takes `points` in order; the counter must be configured and hold that many. Ends early, without the point under
    way, once a pause is wanted or `watch` has shut off the light. The shutter is opened for the first point and
    left to the caller to close."""
    mirror, counter, clock, control = bench.mirror, bench.counter, bench.clock, under_way.control
    numbers = [point.number for point in points]
    bench.announce(numbers)
    counter.arm(PointGates([point.dwell_s for point in points], numbers))
    mirror.move_to(angles[0])
    bench.shutter.open()
    for index, point in enumerate(points):
        mirror.wait_settled()
        taken_s = clock.now() - under_way.start_s
        watch.awaits(point.number)
        counter.trigger()
        try:
            if not _dwelt(bench, point.dwell_s, control):
                return
            counter.wait_points(index + 1, timeout_s=GRACE_S)
            if control.wanted:
                return
            if index + 1 < len(points):
                mirror.begin_move(angles[index + 1])
            sample = Sample(point, counter.read(index, 1)[0], taken_s)
            watch.inspect((sample,))
        except LightOff:
            return
        yield sample


def _dwelt(bench: Bench, dwell_s: float, control: ScanControl) -> bool:
    """Sits through all but the last part of a long dwell; False where a pause is wanted."""
    left_s = dwell_s
    while left_s > LOOK_S and not control.wanted and bench.counter.rest(LOOK_S):
        left_s -= LOOK_S
    return not control.wanted
