"""Trials with light: how much comes back, whether the beam follows to the corners, and how long the mirror settles."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from nlos.acquisition.digits import plus_minus
from nlos.acquisition.planning.preflight import PILE_UP
from nlos.doctor.area import angles_of, area_of, range_m
from nlos.doctor.findings import Chart, Finding, failed, passed, warned
from nlos.doctor.gates import arrival, axis_of, delay_unknown, expected_s, gates
from nlos.drivers.bench import Bench
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates, Trigger

_RATE_S = 0.2
_RATE_GATES = 5
_PLACE_S = 0.1
_REACH_S = 4e-9
"""How far direct light may be from where geometry says: cables have delays."""
_SPREAD_NS = 0.5
_SLICE_S = {True: 0.5e-3, False: 1e-3}
"""By the counter's clock, and by the host's, whose gates every counter can set."""
_MOST_GATES = 1200
_SIGMAS = 4.0
_TOLD = 0.05
"""Of the step: a place in it that is known less well says too little of when the mirror has settled."""


@contextmanager
def lit(bench: Bench) -> Iterator[None]:
    """Light for as long as the block lasts."""
    bench.shutter.release()
    bench.shutter.open()
    try:
        yield
    finally:
        bench.shutter.close()


def count_rates(bench: Bench) -> Iterator[Finding]:
    """The wall's light at the middle of the area against the dark, the trip's limit and pile-up."""
    axis = axis_of(bench)
    bench.counter.configure(axis)
    bench.mirror.move_to(angles_of(bench, area_of(bench).centre))
    dark = gates(bench, [_RATE_S] * _RATE_GATES)
    with lit(bench):
        bright = gates(bench, [_RATE_S] * _RATE_GATES, _RATE_GATES)
        for each in bright:
            bench.shutter.watch(each)
    dark_hz, lit_hz = (sum(h.total_count for h in taken) / sum(h.live_time_s for h in taken)
                       for taken in (dark, bright))  # fmt: skip
    counts = np.sum([each.counts for each in bright], axis=0)
    time_ns = (axis.offset_s + (np.arange(axis.bins) + 0.5) * axis.bin_width_s) * 1e9
    step = max(1, axis.bins // 512)
    rows = counts[: axis.bins // step * step].reshape(-1, step).sum(axis=1)
    chart = Chart("With light, middle of the area", "time after the laser pulse (ns)", "counts",
                  [round(float(each), 3) for each in time_ns[: len(rows) * step : step]],
                  [float(each) for each in rows])  # fmt: skip
    with_light, without = (
        plus_minus(hz, math.sqrt(max(hz, 1.0) / (_RATE_S * _RATE_GATES))) for hz in (lit_hz, dark_hz)
    )
    shuttered = bench.settings.shutter_on != "nothing"
    said = f"{with_light} counts/s with light" + (f", {without} without" if shuttered else "")
    noise_hz = math.sqrt((lit_hz + dark_hz) / (_RATE_S * _RATE_GATES))
    if bench.settings.safety.dry_run:
        yield warned("count rates", f"{said}: a dry run", "Set safety.dry_run: false for light.", chart)
    elif shuttered and lit_hz - dark_hz < 5 * noise_hz + 10:
        yield failed("count rates", f"{said}: no light comes back", "Check laser, shutter, aim and detector.", chart)
    elif lit_hz > PILE_UP * bench.settings.laser.repetition_hz:
        yield warned("count rates", f"{said}: pile-up, above {PILE_UP:.0%} of the laser pulses",
                     "Attenuate the laser or the detector's light.", chart)  # fmt: skip
    else:
        yield passed("count rates", said, chart)


def beam_corners(bench: Bench) -> Iterator[Finding]:
    """Direct light from the corners comes later than from the middle, by as much as they are farther away."""
    area, axis = area_of(bench), axis_of(bench)
    bench.counter.configure(axis)
    places = [area.nearest, *area.corners]
    arrivals = []
    with lit(bench):
        for number, place in enumerate(places):
            bench.mirror.move_to(angles_of(bench, place))
            counts = gates(bench, [_PLACE_S], number)[0].counts
            arrivals.append(arrival(counts, axis, expected_s(bench, range_m(bench, place)), _REACH_S))
    bench.mirror.park()
    if dim := [place for place, found in zip(places, arrivals, strict=True) if found is None]:
        listed = ", ".join(f"({x:+.2f}, {y:+.2f}) m" for x, y in dim)
        yield failed("beam", f"no direct light from {listed}", delay_unknown(bench))
        return
    found_s = np.array([each.time_s for each in arrivals if each is not None])
    wanted_s = np.array([expected_s(bench, range_m(bench, place)) for place in places])
    late_ns = (found_s - wanted_s) * 1e9
    spread = float(late_ns.max() - late_ns.min())
    said = f"direct light {np.median(late_ns):+.2f} ns from where the wall is, the same within {spread:.2f} ns"
    moved, should = float(found_s[1:].max() - found_s[0]), float(wanted_s[1:].max() - wanted_s[0])
    if should > 0.2e-9 and moved < 0.4 * should:
        yield failed("beam", f"{said}: it does not follow the mirror's commands",
                     "Check head, its supply, and the cable from controller to head.")  # fmt: skip
    elif spread > _SPREAD_NS:
        yield warned("beam", said, "Check aim and wall_distance_m; run `nlos calibrate`.")
    else:
        yield passed("beam", f"{said} at the corners")


def settle_curve(bench: Bench) -> Iterator[Finding]:
    """Where the beam is after a step, by when direct light arrives: slices of time, many steps on top of each other."""
    area, axis = area_of(bench), axis_of(bench)
    near, far = area.nearest, area.farthest
    start, end = angles_of(bench, near), angles_of(bench, far)
    table_s = bench.mirror.settle_s(start, end)
    bench.counter.configure(axis)
    slices = max(12, math.ceil(2.5 * table_s / _SLICE_S[_steps_itself(bench)]))
    begun_s = bench.clock.now()
    counts, time_s = _clocked(bench, slices) if _steps_itself(bench) else _by_hand(bench, slices)
    took_s = bench.clock.now() - begun_s
    bench.mirror.park()
    yield _judged(bench, counts, time_s, axis, took_s)


def _steps_itself(bench: Bench) -> bool:
    return bench.mirror.max_sequence > 1 and bench.counter.has_pixel_clock


def _clocked(bench: Bench, slices: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """The counter's clock applies each position `slices` times: only the first of them is a step."""
    area, mirror, counter = area_of(bench), bench.mirror, bench.counter
    start, end = angles_of(bench, area.nearest), angles_of(bench, area.farthest)
    steps = max(1, min(mirror.max_sequence, counter.max_points, _MOST_GATES) // (2 * slices))
    path = ([start] * slices + [end] * slices) * steps
    counts = np.zeros((slices, axis_of(bench).bins), np.int64)
    mirror.load(path)  # in the dark: it may take longer than the watchdog waits
    try:
        with lit(bench):
            mirror.start()
            counter.arm(PointGates([_SLICE_S[True]] * len(path), range(len(path)), Trigger.CLOCK, 0.0))
            for index in range(steps):
                first = (2 * index + 1) * slices
                counter.wait_points(first + slices, timeout_s=2 * slices * _SLICE_S[True] + 2.0)
                counts += np.stack([each.counts for each in counter.read(first, slices)])
    finally:
        counter.abort()
        mirror.stop()
    return counts, np.asarray((np.arange(slices) + 0.5) * _SLICE_S[True], np.float64)


def _by_hand(bench: Bench, slices: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
    """The host moves the mirror and opens one gate after the other, by its own clock."""
    area, mirror, counter, clock = area_of(bench), bench.mirror, bench.counter, bench.clock
    start, end = angles_of(bench, area.nearest), angles_of(bench, area.farthest)
    steps = max(1, _MOST_GATES // (4 * slices))
    counts = np.zeros((slices, axis_of(bench).bins), np.int64)
    time_s = np.zeros(slices)
    with lit(bench):
        for index in range(steps):
            mirror.move_to(start)
            first = index * slices
            counter.arm(PointGates([_SLICE_S[False]] * slices, range(first, first + slices)))
            mirror.begin_move(end)
            begun_s = clock.now()
            for number in range(slices):
                time_s[number] += (clock.now() - begun_s + _SLICE_S[False] / 2) / steps
                counter.trigger()
                counter.wait_points(number + 1, timeout_s=2.0)
                counts[number] += counter.read(number, 1)[0].counts
            mirror.wait_settled()
    return counts, time_s


def _judged(
    bench: Bench,
    counts: npt.NDArray[np.int64],
    time_s: npt.NDArray[np.float64],
    axis: HistogramAxis,
    took_s: float,
) -> Finding:
    """Settled is the slice from which on direct light comes as late as at the end, within what can be told. `took_s`:
    how long the slices took to measure."""
    area = area_of(bench)
    table_s = bench.mirror.settle_s(angles_of(bench, area.nearest), angles_of(bench, area.farthest))
    near_s, far_s = (expected_s(bench, range_m(bench, place)) for place in (area.nearest, area.farthest))
    at_rest = counts[len(counts) * 2 // 3 :]
    rest = arrival(at_rest.sum(axis=0), axis, (near_s + far_s) / 2, _REACH_S)
    if rest is None:
        return failed("settling", "no direct light to tell it by", "Check aim and laser.")
    found = [arrival(each, axis, rest.time_s, (far_s - near_s) + 0.7e-9) for each in counts]
    way_s = far_s - near_s
    place = [float("nan") if each is None else 1 + (each.time_s - rest.time_s) / way_s for each in found]
    doubt = [float("inf") if each is None else math.hypot(each.error_s, rest.error_s) / way_s for each in found]
    usual = math.hypot(rest.error_s * math.sqrt(len(at_rest)), rest.error_s) / way_s
    seen = rest.longer(math.inf, len(at_rest)) == 1
    moving = [index for index, (p, d) in enumerate(zip(place, doubt, strict=True))
              if not abs(p - 1) <= max(_SIGMAS * d, _SIGMAS * usual)]  # fmt: skip
    step_s = max(float(b - a) for a, b in pairwise(time_s))
    settled_s = float(time_s[moving[-1]] + step_s / 2) if moving else float(time_s[0])
    chart = Chart("The beam after a step to the farthest corner", "time (ms)", "part of the way",
                  [round(float(each) * 1e3, 3) for each in time_s], [round(each, 3) for each in place],
                  [0.0, 1.0], [table_s * 1e3])  # fmt: skip
    last = moving[-1] + 1 if moving else 0
    told = last >= len(time_s) or settled_s > table_s + step_s or usual * _SIGMAS <= _TOLD
    if not (seen and told):  # a slice without a peak is no beam elsewhere, and a vague place none where it should be
        times = rest.longer(way_s * _TOLD / _SIGMAS, len(at_rest))
        return warned(
            "settling",
            f"too little direct light to see the mirror settle: {rest.photons / len(at_rest):.2g} photons a slice of "
            f"{step_s * 1e3:.2g} ms after {took_s:.1f} s; it would take some {math.ceil(took_s * times)} s",
            "More light on the wall, less beside it, or a larger area.", chart,
        )  # fmt: skip
    said = (
        f"still within {_SIGMAS * usual:.1%} of the step after {settled_s * 1e3:.1f} ms; "
        f"its table says {table_s * 1e3:.1f} ms"
    )
    if last >= len(time_s):
        return failed(
            "settling", f"the beam has not settled after {time_s[-1] * 1e3:.0f} ms", "Check head and servo.", chart
        )
    if settled_s > table_s + step_s:
        return failed("settling", said, "Measure `settle` again for the bench file: points would be blurred.", chart)
    return passed("settling", said, chart)
