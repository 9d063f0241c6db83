"""Trials with the shutter closed: corners reached and read back, steps counted, dark histogram, timing linearity."""

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from scipy.special import pdtrc

from nlos.acquisition.digits import plus_minus
from nlos.doctor.area import angles_of, area_of
from nlos.doctor.findings import Chart, Finding, failed, passed, skipped, warned
from nlos.doctor.gates import axis_of, gates
from nlos.doctor.hands import hands_for
from nlos.drivers.bench import Bench
from nlos.drivers.galvo.mirror import MeasuresPosition, own_clock
from nlos.drivers.tcspc.counter import HistogramAxis, HistogramFlag, PointGates, Trigger

NEVER_DARK = "this bench has no shutter: nothing here makes it dark"
_READ_BACK_DEG = 0.3
"""Mechanical; beyond what any controller's own sensor is accurate to."""
_STEPS = 64
_STEP_S = 5e-3
_LATE_S = 1.5
"""Of all steps: a clock that runs by itself makes up at the end for those that were missed at the beginning."""
_DARK_S = 0.5
_DARK_GATES = 8
_LEAK_P = 1e-6
_LAMP_S = 1.0
_LAMP_GATES = 20
_ENOUGH_PER_BIN = 1000.0
_TOO_FEW_PER_BIN = 30.0
_DNL = (0.03, 0.2)
"""RMS of the bins' widths, in widths, from which it is worth a look, and from which it is wrong."""
_INL_BINS = 1.0
_KOLMOGOROV = 1.95
"""Photon noise alone goes beyond this with a probability of 1e-3."""


def corners(bench: Bench) -> Iterator[Finding]:
    """Every corner of the area, and the middle of its sides, commanded; read back where the controller measures."""
    area = area_of(bench)
    x_m, y_m = area.centre
    sides = [(area.left_m, y_m), (area.right_m, y_m), (x_m, area.top_m), (x_m, area.bottom_m)]
    off_deg = []
    for place in (*area.corners, *sides, area.centre):
        angles = angles_of(bench, place)
        bench.mirror.move_to(angles)
        if isinstance(bench.mirror, MeasuresPosition):
            seen = bench.mirror.measured()
            off_deg.append(math.degrees(math.hypot(seen.x_rad - angles.x_rad, seen.y_rad - angles.y_rad)) / 2)
    bench.mirror.park()
    yield passed("corners", f"all commands confirmed within {area}")
    if not off_deg:
        yield skipped("read-back", f"{bench.mirror.identity.product} does not measure where it points; light does")
    elif max(off_deg) > _READ_BACK_DEG:
        yield failed(
            "read-back", f"up to {max(off_deg):.2f} deg mechanical from where it was sent", "Check head and controller."
        )
    else:
        yield passed("read-back", f"within {max(off_deg):.3f} deg mechanical of where it was sent")


def markers(bench: Bench) -> Iterator[Finding]:
    """Steps by the counter's clock, or the mirror's own, as the counter sees them come back from the mirror."""
    mirror, counter = bench.mirror, bench.counter
    own = own_clock(mirror)
    lacks = (
        (mirror.max_sequence < 2 and own is None, f"{mirror.identity.product} cannot step by itself"),
        (
            own is not None and not counter.follows_mirror,
            f"{counter.identity.product} is not wired to follow the mirror",
        ),
        (own is None and not counter.has_pixel_clock, f"{counter.identity.product} has no pixel clock"),
        (not counter.counts_markers, "the mirror's marker outputs are not wired to the counter"),
    )
    if why := next((text for lacking, text in lacks if lacking), ""):
        yield skipped("markers", why)
        return
    area = area_of(bench)
    path = [angles_of(bench, place) for place in area.corners] * (_STEPS // 4)
    counter.configure(axis_of(bench))
    steps = own.own_steps(_STEP_S, 0.0) if own is not None else None
    if own is not None and steps is not None:
        own.load_steps(path, steps)
    else:
        mirror.load(path)
    mirror.start()
    began_s = bench.clock.now()
    try:
        if own is not None and steps is not None:
            counter.arm(
                PointGates([_STEP_S] * len(path), range(len(path)), Trigger.MIRROR, steps.blanking_s, steps.step_s)
            )
            own.play()
        else:
            counter.arm(PointGates([_STEP_S] * len(path), range(len(path)), Trigger.CLOCK, 0.0))
        status = counter.wait_points(len(path), timeout_s=len(path) * _STEP_S + 2.0)
        took_s = bench.clock.now() - began_s
        taken = counter.read(0, len(path))
    finally:
        counter.abort()
        mirror.stop()
    flags = HistogramFlag.NONE
    for histogram in taken:
        flags |= histogram.flags
    said = f"{status.markers} mirror steps for {status.points_done} of {len(path)} points"
    if status.markers not in (status.steps_due, len(path)) or status.points_done != len(path):
        yield failed("markers", said, "Check trigger and marker wires, and how long the trigger pulse is.")
    elif took_s > len(path) * _STEP_S + _LATE_S:
        said = f"{said}, in {took_s:.1f} s where {len(path) * _STEP_S:.1f} s were due"
        yield failed("markers", said, "Steps before the first were missed: check the trigger wire.")
    elif flags or status.lost:
        yield warned("markers", f"{said}; {flags.name or 'no flags'}, {status.lost} lost", "Check the trigger wire.")
    else:
        yield passed("markers", said)
    mirror.park()


def dark_histogram(bench: Bench) -> Iterator[Finding]:
    """Whether what arrives in the dark keeps the laser's time: then it is the laser, past the shutter."""
    if bench.settings.shutter_on == "nothing":
        yield skipped("dark histogram", NEVER_DARK)
        return
    axis = axis_of(bench)
    bench.counter.configure(axis)
    taken = gates(bench, [_DARK_S] * _DARK_GATES)
    counts = np.stack([each.counts for each in taken]).sum(axis=0, dtype=np.int64)
    live_s = sum(each.live_time_s for each in taken)
    total = sum(each.total_count for each in taken)
    stated_hz, seen_hz = bench.settings.laser.repetition_hz, sum(each.sync_count for each in taken) / live_s
    rate = plus_minus(total / live_s, math.sqrt(max(total, 1)) / live_s)
    pulses = f"{rate} counts/s over {live_s:.1f} s, {seen_hz / 1e6:.4g} million laser pulses/s"
    width = max(1, round(0.2e-9 / axis.bin_width_s))
    groups: npt.NDArray[np.int64] = counts[: len(counts) // width * width].reshape(-1, width).sum(axis=1)
    mean = float(np.median(groups)) if np.median(groups) > 3 else float(groups.mean())
    chance = float(pdtrc(groups.max() - 1, max(mean, 1e-9))) * len(groups)
    chart = Chart("In the dark", "time after the laser pulse (ns)", "counts per 0.2 ns",
                  _round((axis.offset_s + (np.arange(len(groups)) + 0.5) * width * axis.bin_width_s) * 1e9),
                  _round(groups), [mean])  # fmt: skip
    if chance < _LEAK_P:
        at_ns = chart.x[int(np.argmax(groups))]
        yield failed("dark histogram", f"a peak at {at_ns:.1f} ns: laser light, with the shutter closed; {pulses}",
                     "The shutter leaks, or something else scatters the laser: find it before anybody looks.",
                     chart)  # fmt: skip
    elif abs(seen_hz / stated_hz - 1) > 0.01:
        yield warned("dark histogram", pulses, f"The bench file says {stated_hz / 1e6:.4g} MHz.", chart)
    else:
        yield passed("dark histogram", f"flat: {pulses}", chart)


def linearity(bench: Bench) -> Iterator[Finding]:
    """Code density of light that knows nothing of the laser: every bin as wide as the others, and time as a whole."""
    if bench.settings.shutter_on == "nothing":
        yield skipped("linearity", NEVER_DARK)
        return
    hands = hands_for(bench)
    if not hands.lamp(True):
        yield skipped("linearity", "it needs a lamp, and no one is there to hold it")
        return
    try:
        yield _linearity(bench)
    finally:
        hands.lamp(False)


def _linearity(bench: Bench) -> Finding:
    safety = bench.settings.safety
    rate_hz = bench.counter.rates().detector_hz
    if rate_hz > safety.trip_cps / 2:
        return warned("linearity", f"{rate_hz:.3g} counts/s from the lamp are too many", "Move it away, run again.")
    axis = axis_of(bench)
    bench.counter.configure(axis)
    counts = np.zeros(axis.bins, np.int64)
    for number, dwell_s in enumerate([_LAMP_S] * _LAMP_GATES):
        counts += gates(bench, [dwell_s], number)[0].counts
        if counts.mean() >= _ENOUGH_PER_BIN:
            break
    if counts.mean() < _TOO_FEW_PER_BIN:
        return warned("linearity", f"{counts.mean():.1f} counts per bin from the lamp are too few", "Move it closer.")
    return judged(counts, axis)


def judged(counts: npt.NDArray[np.int64], axis: HistogramAxis) -> Finding:
    """DNL and INL (IEEE 1241, code density) of counts (T,) under uniform light, photon noise taken off."""
    mean = float(counts.mean())
    dnl = counts / mean - 1
    rms = math.sqrt(max(float(dnl.var()) - 1 / mean, 0.0))
    integral = np.cumsum(dnl)
    inl = float(np.abs(integral).max())
    noise = _KOLMOGOROV * math.sqrt(len(counts) / mean)
    width_ps = axis.bin_width_s * 1e12
    said = (
        f"DNL {rms:.2%} RMS, INL {inl * width_ps:.1f} ps (photon noise up to {noise * width_ps:.1f} ps) "
        f"over {len(counts)} bins of {width_ps:g} ps, {mean:.0f} counts each"
    )
    time_ns = (axis.offset_s + (np.arange(len(counts)) + 0.5) * axis.bin_width_s) * 1e9
    step = max(1, len(counts) // 512)
    chart = Chart("Integral nonlinearity", "time after the laser pulse (ns)", "INL (ps)", _round(time_ns[::step]),
                  _round(integral[::step] * width_ps), [-noise * width_ps, noise * width_ps])  # fmt: skip
    empty = int((counts == 0).sum())
    if empty or rms > _DNL[1]:
        return failed("linearity", f"{said}; {empty} bins hold nothing", "Have the counter calibrated.", chart)
    if rms > _DNL[0] or inl > max(noise, _INL_BINS):
        return warned("linearity", said, "Choose wider bins; a lamp that flickers with the laser does this too.", chart)
    return passed("linearity", said, chart)


def _round(values: npt.NDArray[np.generic]) -> list[float]:
    return [round(float(each), 4) for each in values]
