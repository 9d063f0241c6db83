"""Trials of what shuts the light off: the watchdog, a trip, the interlock and a pulled cable, each with light on."""

from collections.abc import Iterator
from contextlib import closing, suppress

from nlos.acquisition.planning.schemes import Scheme
from nlos.acquisition.scanning.control import ScanControl
from nlos.acquisition.scanning.engine import scan
from nlos.doctor.area import angles_of, area_of
from nlos.doctor.findings import Finding, failed, passed, skipped, warned
from nlos.doctor.gates import axis_of, gates
from nlos.doctor.hands import hands_for
from nlos.doctor.light_trials import lit
from nlos.doctor.small_scan import small_plan
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceError, DeviceLost, SafetyTrip
from nlos.drivers.events import EventLog
from nlos.drivers.safety import GuardedShutter

_DWELL_S = 0.05
_MOVES_S = 0.3
_BY_HAND_S = 60.0
_LOOK_S = 0.01
_OFF = "Switch the laser off by hand, and do not use this bench until this is fixed."


def light_is_on(bench: Bench) -> str:
    """What says that light is on; empty where nothing does."""
    state = bench.shutter.state()
    if state.feedback_open or (state.feedback_open is None and state.commanded_open):
        return "the shutter's contact says open" if state.feedback_open else "the shutter is commanded open"
    return ""


def watchdog(bench: Bench) -> Iterator[Finding]:
    """Falls silent with the light on: the instrument itself closes the shutter."""
    if not bench.shutter.has_watchdog:
        yield skipped("watchdog", "this bench has none that closes its shutter")
        return
    silent_s = bench.settings.safety.watchdog_s
    bench.mirror.move_to(angles_of(bench, area_of(bench).centre))
    with lit(bench):
        opened = bool(bench.shutter.state().feedback_open)
        bench.counter.kick()
        bench.clock.sleep(silent_s / 2)
        early = bench.shutter.state().feedback_open is False
        bench.counter.kick()
        bench.clock.sleep(silent_s + _MOVES_S)
        still_open = light_is_on(bench)
    bench.counter.clear_trip()  # provoked here, by somebody who asked for it
    if bench.settings.safety.dry_run:
        yield skipped("watchdog", "a dry run: the light never comes on")
    elif not opened:
        yield failed("watchdog", "the shutter did not open", "Check its supply and its contact.")
    elif early:
        yield failed("watchdog", f"closed the shutter within {silent_s / 2:g} s", "Check safety.watchdog_s.")
    elif still_open:
        yield failed("watchdog", f"{still_open} after {silent_s + _MOVES_S:.1f} s of silence", _OFF)
    else:
        yield passed("watchdog", f"closed the shutter within {silent_s + _MOVES_S:.1f} s of silence")


def trip(bench: Bench) -> Iterator[Finding]:
    """The guard of every scan, with its limit set below the light that is there: it closes, and keeps closed."""
    if bench.settings.shutter_on == "nothing":
        yield skipped("trip", "this bench has no shutter to close")
        return
    bench.counter.configure(axis_of(bench))
    bench.mirror.move_to(angles_of(bench, area_of(bench).centre))
    with lit(bench):
        light = gates(bench, [_DWELL_S] * 2)[-1]
        rate_hz = light.total_count / light.live_time_s
        safety = bench.settings.safety.model_copy(
            update={"trip_cps": max(rate_hz / 2, 1e-3), "trip_ms": 1.0, "watchdog_s": 0.0}
        )
        guard = GuardedShutter(bench.shutter, bench.counter, safety, EventLog())  # its trip ends with it
        tripped = False
        try:
            guard.watch(light)
        except SafetyTrip:
            tripped = True
        still_open = light_is_on(bench)
    try:
        guard.open()
        guard.close()
        kept = False
    except SafetyTrip:
        kept = True
    if not light.total_count:
        yield skipped("trip", "no light, nothing to trip at")
    elif not tripped or still_open:
        yield failed("trip", f"at twice the rate allowed {still_open or 'nothing tripped'}", _OFF)
    elif not kept:
        yield failed("trip", "the shutter could be opened again without anybody clearing the trip", _OFF)
    else:
        yield passed("trip", f"at twice the rate allowed ({rate_hz:.3g} counts/s) the shutter closed and stayed closed")


def interlock(bench: Bench) -> Iterator[Finding]:
    """The loop opened by hand with the light on."""
    if bench.shutter.state().interlock_closed is None:
        yield skipped("interlock", "nothing here reads the loop")
        return
    hands = hands_for(bench)
    if not hands.ready_to_open_interlock():
        yield skipped("interlock", "it needs someone at the bench, and no one is there")
        return
    with lit(bench):
        hands.open_interlock()
        until_s = bench.clock.now() + _BY_HAND_S
        while (opened := bench.shutter.state().interlock_closed is False) is False and bench.clock.now() < until_s:
            with suppress(SafetyTrip):  # opened just now: the next look says so
                bench.counter.kick()
            bench.clock.sleep(_LOOK_S)
        bench.clock.sleep(_MOVES_S)
        still_open = light_is_on(bench)
    hands.close_interlock()
    bench.counter.clear_trip()  # provoked here, by somebody who was asked to
    if not opened:
        yield failed("interlock", f"nothing was opened within {_BY_HAND_S:.0f} s, or it is not wired", "Check it.")
    elif still_open:
        yield failed("interlock", f"{still_open} with the loop open", _OFF)
    else:
        yield passed("interlock", "the open loop closed the shutter")


def cable(bench: Bench) -> Iterator[Finding]:
    """The mirror's cable pulled in the middle of a point; in the dark where the shutter hangs on that very cable.
    Last: the bench has to be opened again afterwards."""
    if not bench.shutter.on_counter:
        yield from dark_cable(bench)
        return
    hands = hands_for(bench)
    if not hands.pull_mirror_cable():
        yield skipped("cable", "it needs someone at the bench, and no one is there")
        return
    plan = small_plan(bench, _BY_HAND_S / 16)
    try:
        with closing(scan(plan, bench, scheme=Scheme.STEPPED, control=ScanControl())) as samples:
            for _ in samples:
                pass
    except DeviceError as error:
        yield from _said(bench, error, light_is_on(bench))
        return
    yield warned("cable", f"nothing was pulled within {_BY_HAND_S:.0f} s, or nobody noticed", "Try again.")


def dark_cable(bench: Bench) -> Iterator[Finding]:
    """The same in the dark: somebody notices, and says so."""
    if not hands_for(bench).pull_mirror_cable():
        yield skipped("cable", "it needs someone at the bench, and no one is there")
        return
    until_s = bench.clock.now() + _BY_HAND_S
    while bench.clock.now() < until_s:
        try:
            bench.mirror.look()
        except DeviceError as error:
            yield from _said(bench, error, "")
            return
        bench.clock.sleep(_LOOK_S)
    yield warned("cable", f"nothing was pulled within {_BY_HAND_S:.0f} s, or nobody noticed", "Try again.")


def _said(bench: Bench, error: DeviceError, still_open: str) -> Iterator[Finding]:
    if still_open or bench.shutter.may_be_open:
        yield failed("cable", f"{still_open or 'the shutter is not confirmed closed'} after: {error.what}", _OFF)
    elif not isinstance(error, DeviceLost):
        yield warned("cable", f"noticed as another fault: {error.said}", "Pull the cable only.")
    else:
        light = "" if bench.settings.shutter_on == "nothing" else ", and no light"
        yield passed("cable", f"noticed{light}: {error.what}")
