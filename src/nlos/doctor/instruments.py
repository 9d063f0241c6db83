"""Mirror, counter and shutter one by one, in the dark: who answers, within what limits, and what arrives."""

import math
from collections.abc import Iterator

from nlos.acquisition.digits import two_digits
from nlos.doctor.area import angles_of, area_of
from nlos.doctor.findings import Finding, failed, passed, warned
from nlos.doctor.gates import axis_of, first_light_of, gates
from nlos.drivers.bench import Bench
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import Clock
from nlos.drivers.errors import LimitError
from nlos.drivers.first_light_settings import FirstLightSettings
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles
from nlos.drivers.tcspc.counter import CountRates, HistogramCounter

_DARK_CPS = (2e3, 50e3)
"""Counts per second in the dark from which something is worth a look, and from which something is wrong."""
_QUIET_S, _QUIET_GATES = 2.0, 4
_ANSWERS = 5
_SLOW_S = 0.05
"""A USB instrument that takes longer for a short answer holds up every point of a scan."""


def shutter(bench: Bench) -> Iterator[Finding]:
    """That it is closed, and who else would close it."""
    state = bench.shutter.state()
    if bench.settings.shutter_on == "nothing":
        yield warned("shutter", "none: nothing here can shut off the light", "Wire one.")
    elif state.commanded_open or state.feedback_open:
        yield failed("shutter", "open, and it was told to close", "Switch the laser off by hand.")
    elif state.interlock_closed is False:
        yield failed("shutter", "closed; the interlock loop is open", "Close the loop.")
    elif state.feedback_open is None:
        remedy = "Wire its contact." if bench.settings.shutter_on == "counter" else (
            "This output has no input for a contact: watch the shutter close, or put it on a counter's output that "
            "reads back.")  # fmt: skip
        yield warned("shutter", "commanded closed; nothing reads back whether it is", remedy)
    else:
        yield passed("shutter", "closed and read back, interlock closed")
    if bench.settings.shutter_on != "nothing" and not bench.shutter.has_watchdog:
        said = "no watchdog: if the computer freezes or kills this program, the shutter stays open"
        watchdog_s = bench.settings.safety.watchdog_s
        if watchdog_s > 0 and bench.settings.shutter_on == "mirror":
            said += f"; where the program only hangs, a thread of it closes the shutter after {watchdog_s:g} s"
        yield warned("shutter", said, "Set safety.watchdog_s with a shutter on a counter that has a watchdog.")


def links(bench: Bench) -> Iterator[Finding]:
    """Round trips, in the bench's own time."""
    start_s = bench.clock.now()
    for _ in range(_ANSWERS):
        bench.counter.kick()
    counter_s = (bench.clock.now() - start_s) / _ANSWERS
    start_s = bench.clock.now()
    bench.mirror.park()
    said = f"counter answers in {counter_s * 1e3:.2f} ms, mirror parks in {(bench.clock.now() - start_s) * 1e3:.1f} ms"
    if counter_s > _SLOW_S:
        yield warned("links", said, "Plug the counter into a port of its own, without hubs.")
    else:
        yield passed("links", said)


def counter(bench: Bench) -> Iterator[Finding]:
    return counter_lines(bench.counter, bench.settings)


def counter_lines(counter: HistogramCounter, settings: BenchSettings) -> Iterator[Finding]:
    """Who it is, and whether the laser's sync arrives at the rate that the bench file states."""
    who, rates = counter.identity, counter.rates()
    yield passed("counter", f"{who.product} {who.serial}, firmware {who.firmware}")
    if foreign := settings.foreign_first_light(who.name):
        what, _, remedy = foreign.partition(". ")
        yield warned("first light", what, f"{remedy}.")
    stated_hz = settings.laser.repetition_hz
    if rates.sync_hz <= 0:
        yield failed("sync", "no sync signal", "Check laser, sync cable and the sync input's level.")
    elif abs(rates.sync_hz / stated_hz - 1) > 0.01:
        yield warned("sync", f"at {rates.sync_hz / 1e6:.4g} MHz, the bench file says {stated_hz / 1e6:.4g} MHz",
                     "Correct laser.repetition_hz, or the sync level.")  # fmt: skip
    else:
        yield passed("sync", f"at {rates.sync_hz / 1e6:.4g} MHz")


def dark_counts(bench: Bench) -> Iterator[Finding]:
    rates = bench.counter.rates()
    if rates.detector_hz == 0:  # its rate meter looks for a moment only
        bench.counter.configure(axis_of(bench))
        taken = gates(bench, [_QUIET_S / _QUIET_GATES] * _QUIET_GATES)
        counted = sum(each.total_count for each in taken)
        rates = CountRates(rates.sync_hz, counted / sum(each.live_time_s for each in taken))
    if bench.settings.shutter_on == "nothing":
        rate = two_digits(rates.detector_hz)
        said = f"not known: nothing here can make it dark; {rate} counts/s with the light as it is"
        yield warned("dark counts", said, "Block the laser by hand and look (`nlos monitor`).")
        return
    yield dark_line(rates, first_light_of(bench))


def dark_line(rates: CountRates, known: FirstLightSettings | None) -> Finding:
    """The detector with the shutter closed. `known`: dark counts and room light as first light told them apart."""
    dark_cps = rates.detector_hz
    said = f"{two_digits(dark_cps)} counts/s with the shutter closed, dark counts and room light together"
    if dark_cps == 0:
        return warned(
            "dark counts",
            "not one count with the shutter closed: a dead channel, or a very quiet detector in a very dark room",
            "Let some room light in and look (`nlos monitor`): it must count.",
        )
    if dark_cps > _DARK_CPS[1]:
        return failed("dark counts", said, "Light comes in or the detector is hot: find out before scanning.")
    if dark_cps > _DARK_CPS[0]:
        return warned("dark counts", said, _brighter_of(known))
    return passed("dark counts", said)


def _brighter_of(known: FirstLightSettings | None) -> str:
    if known is None or known.dark_cps is None or known.room_cps is None:
        return "Dim the room, or cool the detector; `nlos calibrate --first-light` tells the two apart."
    room = known.room_cps > known.dark_cps
    return (
        f"{'Dim the room' if room else 'Cool the detector'}: at first light dark counts were "
        f"{two_digits(known.dark_cps)}/s, room light {two_digits(known.room_cps)}/s."
    )


def mirror(bench: Bench) -> Iterator[Finding]:
    """Who it is, how far it reaches, and small moves within the area that the bench allows."""
    yield from mirror_lines(bench.mirror, bench.settings)
    area = area_of(bench)
    part = area.within(0.01 * bench.settings.geometry.wall_distance_m)
    yield _small_moves(bench.mirror, bench.clock, [angles_of(bench, corner) for corner in part.corners])


def mirror_lines(mirror: GalvoMirror, settings: BenchSettings) -> Iterator[Finding]:
    """Who it is and how far it reaches. Moves nothing."""
    who = mirror.identity
    yield passed("mirror", f"{who.product} {who.firmware} {who.serial}".rstrip())
    reach_deg = 0
    for degrees in range(1, 90):
        angle = math.radians(degrees)
        try:
            for x, y in ((angle, 0.0), (-angle, 0.0), (0.0, angle), (0.0, -angle)):
                mirror.check(MirrorAngles(x, y))
        except LimitError:
            break
        reach_deg = degrees
    wall_m = 2 * settings.geometry.wall_distance_m * math.tan(math.radians(min(reach_deg, 80)))
    yield passed("mirror", f"reaches +-{reach_deg} deg optical ({wall_m:.1f} m of wall)")


def _small_moves(mirror: GalvoMirror, clock: Clock, path: list[MirrorAngles]) -> Finding:
    start_s = clock.now()
    for angles in path:
        mirror.move_to(angles)
    mirror.park()
    each_ms = (clock.now() - start_s) / (len(path) + 1) * 1e3
    return passed("mirror", f"a small move takes {each_ms:.1f} ms")
