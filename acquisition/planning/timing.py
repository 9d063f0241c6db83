"""How long a scan will take, in its parts and as a band, from the mirror's settle model and the cables' times; and how
long it will still take, from the pace of the points taken so far."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.sample import Sample, ScanPoint, is_pause
from nlos.acquisition.scanning.clocked import Sequencer, Stepping, next_sequence, stepping
from nlos.drivers.bench import Bench
from nlos.drivers.device_settings import Cable
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.mirror import LooksAgain, ManyAtOnce, MirrorAngles, axes_rad

SCAN_QUESTIONS = 6
"""Exchanges with the counter that set up a scan, alarms included, and end it."""
ARM_QUESTIONS = 9.5
"""Exchanges that arm it for points, settings read back."""
SEQUENCE_QUESTIONS = 13.5
"""The same for a sequence, which is stopped before and watched to its end."""
POINT_QUESTIONS = 1.5
"""A trigger, one way, and one question there and back per point taken by the host."""
MARGIN = 0.02
LEAST_TO_LEARN = 16
BOUNDARY_S = 5e-3


@dataclass(frozen=True)
class Links:
    """What cables and controllers cost in time: one move commanded, one point asked for and known to be complete, one
    line of table entries uploaded, one sequence begun and ended, points armed without one, one scan set up and ended.
    `margin`: the fraction by which a whole scan may differ from the forecast."""

    move_s: float
    point_s: float
    line_s: float
    sequence_s: float
    arm_s: float
    scan_s: float
    margin: float

    @classmethod
    def of_cables(cls, mirror: MirrorBlock, serial_s: float, usb_s: float, margin: float) -> "Links":
        """From the times of one exchange, there and back, on the mirror's and on the counter's cable."""
        return cls(
            move_s=mirror.commands_per_move * serial_s,
            point_s=POINT_QUESTIONS * usb_s,
            line_s=3 * serial_s,
            sequence_s=mirror.commands_per_sequence * serial_s + SEQUENCE_QUESTIONS * usb_s,
            arm_s=ARM_QUESTIONS * usb_s,
            scan_s=SCAN_QUESTIONS * usb_s,
            margin=margin,
        )


def links_of(bench: Bench) -> Links:
    """What the cables of a bench cost until recordings of it say better, and the warning time before its light."""
    settings = bench.settings
    links = Links.of_cables(settings.mirror, *exchanges_s(bench), MARGIN if settings.simulation else 0.15)
    if bench.counter.list_mode:
        links = replace(links, point_s=links.point_s + settings.counter.listed_point_s)
    return links if settings.arming is None else replace(links, scan_s=links.scan_s + settings.arming.delay_s)


def exchanges_s(bench: Bench) -> tuple[float, float]:
    """Time of one exchange, there and back, on the mirror's and on the counter's cable. A simulated bench states it (a
    vendor's library is simulated without any); of a real one, USB serial at 1 ms and two microframes are assumed."""
    simulation = bench.settings.simulation
    cost_s: dict[Cable, float] = {"serial": 1e-3, "usb": 0.25e-3, "library": 0.25e-3}
    if simulation is not None:
        cost_s = {
            "serial": simulation.serial_latency_ms * 1e-3,
            "usb": simulation.usb_latency_ms * 1e-3,
            "library": 0.0,
        }
    return cost_s[bench.settings.mirror.cable], cost_s[bench.settings.counter.cable]


@dataclass(frozen=True)
class Forecast:
    """Predicted duration by parts, and how far off it may be. Where points stop at N counts or a second pass takes only
    what fell short, the light decides, and of a film until it is stopped a person: then the parts are the most it can
    be, and `certain` the share that is sure. Where something is measured first until it is known well enough, the parts
    hold it as it usually is, and it may end `sooner_s` or `later_s`."""

    dwell_s: float
    settle_s: float
    links_s: float
    upload_s: float
    margin: float
    certain: float = 1.0
    sooner_s: float = 0.0
    later_s: float = 0.0

    @property
    def total_s(self) -> float:
        return self.dwell_s + self.settle_s + self.links_s + self.upload_s

    @property
    def band_s(self) -> tuple[float, float]:
        """Shortest and longest: beyond the certain dwell, the parts may be off by `margin` of the whole."""
        slack_s = self.margin * self.total_s
        least_s = self.certain * (self.total_s - slack_s) - self.sooner_s
        return max(self.certain * self.dwell_s, least_s), self.total_s + slack_s + self.later_s

    def extended(self, twice: "Forecast", times: float) -> "Forecast":
        """Of a plan `times` as long, whose second part, to which `twice` goes, is as all of its later ones are."""
        parts = ("dwell_s", "settle_s", "links_s", "upload_s")
        first, second = ({name: getattr(each, name) for name in parts} for each in (self, twice))
        return replace(self, **{name: first[name] + (times - 1) * (second[name] - first[name]) for name in parts})


def certain_share(plan: ScanPlan) -> float:
    """The share of a plan's time that passes whatever the light does, or who stops it."""
    if plan.stop is not None or plan.until_stopped:
        return 0.0
    if plan.revisit_below is not None:
        return float(plan.dwell_s[plan.pass_ == 0].sum()) / plan.dwell_total_s
    return 1.0


def moves_s(bench: Bench, angles: Sequence[MirrorAngles]) -> npt.NDArray[np.float64]:
    """Settling time of every move, the first one from the centre, shape (N,): until the host knows of it, and has
    compared places where it does."""
    stops = [MirrorAngles(0.0, 0.0), *angles]
    if isinstance(bench.mirror, ManyAtOnce):
        settled_s = bench.mirror.settles_s(*axes_rad(stops))
    else:
        settled_s = np.array([bench.mirror.settle_s(start, end) for start, end in pairwise(stops)])
    if isinstance(bench.mirror, LooksAgain):
        looks_s = bench.mirror.looks_s(*axes_rad(angles))
    else:
        looks_s = np.zeros(len(angles))
    pause_s = bench.settings.mirror.polled_every_s
    if pause_s is None:
        return settled_s + looks_s
    look_s, _ = exchanges_s(bench)
    stable_s = bench.settings.mirror.stable_s
    in_vain = np.maximum(np.ceil((settled_s - stable_s - look_s - pause_s / 2) / (look_s + pause_s)), 0.0)
    return np.asarray((in_vain + 2) * look_s + in_vain * pause_s + max(pause_s, stable_s) + looks_s)


def stepped_forecast(plan: ScanPlan, bench: Bench, angles: Sequence[MirrorAngles], links: Links) -> Forecast:
    """Scheme S1: every point pays for its move, its settling and its questions."""
    arms = -(-len(plan) // min(bench.counter.max_points, plan.most_together))
    begins_s = bench.settings.counter.listing_begins_s if bench.counter.list_mode else 0.0
    return Forecast(
        dwell_s=plan.dwell_total_s,
        settle_s=float(moves_s(bench, angles).sum()),
        links_s=len(plan) * (links.move_s + links.point_s) + arms * links.arm_s + links.scan_s + begins_s,
        upload_s=0.0,
        margin=links.margin,
        certain=certain_share(plan),
    )


def clocked_forecast(
    plan: ScanPlan,
    bench: Bench,
    angles: Sequence[MirrorAngles],
    links: Links,
    sequencer: Sequencer = stepping,
    before: Sequence[Stepping] = (),
) -> Forecast:
    """Schemes S2 and S3: points pay for blanking, sequences for upload and start; so do those that come `before`. The
    scan pays for a move in the dark before its light."""
    whole = Forecast(0.0, 0.0, links.scan_s + links.move_s, 0.0, links.margin, certain_share(plan))
    ends_s = bench.settings.counter.listing_ends_s if bench.counter.list_mode else 0.0
    first, where = 0, MirrorAngles(0.0, 0.0)
    together, left = min(bench.counter.max_points, plan.most_together), list(before)
    points: list[ScanPoint] = []
    while first < len(plan):
        # Of many points a sequence takes few.
        points += plan.points(first + len(points), first + together)
        part = next_sequence(bench, points, angles[first : first + len(points)], sequencer)
        if left:
            part = replace(left.pop(), count=0)
        dwell_s = sum(point.dwell_s for point in points[: part.count])
        whole = replace(
            whole,
            dwell_s=whole.dwell_s + dwell_s,
            settle_s=whole.settle_s + part.duration_s - dwell_s + bench.mirror.settle_s(where, part.angles[0]),
            links_s=whole.links_s + links.sequence_s + ends_s,
            upload_s=whole.upload_s + -(-len(part.index) // bench.settings.mirror.steps_per_upload) * links.line_s,
        )
        first, where, points = first + part.count, part.angles[-1], points[part.count :]
    return whole


class Pace:
    """Learns from the samples of a running scan what each point really costs beyond its dwell."""

    def __init__(self, plan: ScanPlan, settle_s: npt.NDArray[np.float64]) -> None:
        self._plan, self._settle_s = plan, settle_s
        self._last: Sample | None = None
        self._number: list[int] = []
        self._beyond_s: list[float] = []
        self._taken = np.zeros(len(plan), dtype=np.bool_)

    def step(self, sample: Sample) -> None:
        """Takes note of the next sample, in the order taken."""
        last, self._last = self._last, sample
        self._taken[sample.point.number] = True
        if last is not None and sample.point.number == last.point.number + 1:
            beyond_s = sample.taken_s - last.taken_s - last.histogram.live_time_s
            if not is_pause(beyond_s, sample.histogram.live_time_s):
                self._number.append(sample.point.number)
                self._beyond_s.append(beyond_s)

    @property
    def is_known(self) -> bool:
        """Whether there were enough points, one after the other, to learn from."""
        return len(self._number) >= LEAST_TO_LEARN

    def host_s(self) -> tuple[float, float]:
        """(seconds per point, seconds per predicted second of settling) by least squares; the model's own settling and
        no host time while there is too little to learn from. Sequences' starts count in the mean, not in the fit."""
        if not self.is_known:
            return 0.0, 1.0
        beyond_s, settle_s = np.array(self._beyond_s), self._settle_s[self._number]
        usual = beyond_s <= np.quantile(beyond_s, 0.99) + BOUNDARY_S
        spread = float(np.ptp(settle_s[usual]))
        if spread < 0.1 * float(settle_s.mean() + 1e-9):
            return float(beyond_s.mean() - settle_s.mean()), 1.0
        design = np.stack([np.ones(int(usual.sum())), settle_s[usual]], axis=1)
        (_, scale), *_ = np.linalg.lstsq(design, beyond_s[usual], rcond=None)
        scale = max(float(scale), 0.0)
        return float(beyond_s.mean() - scale * settle_s.mean()), scale

    def remaining_s(self) -> float:
        """Time until the last point is taken, at this pace."""
        left = ~self._taken
        host_s, scale = self.host_s()
        settle_s = scale * float(self._settle_s[left].sum())
        return float(self._plan.dwell_s[left].sum()) + settle_s + int(left.sum()) * host_s


def learned_links(links: Links, samples: Sequence[Sample], pace: Pace) -> Links:
    """`links` as a finished scan in scheme S1 on the same bench proved them to be; as they are where it has too few
    points, one after the other, to prove anything."""
    for sample in samples:
        pace.step(sample)
    if not pace.is_known:
        return links
    host_s, _ = pace.host_s()
    return replace(links, move_s=max(host_s - links.point_s, 0.0), margin=MARGIN)
