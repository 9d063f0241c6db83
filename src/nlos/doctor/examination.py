"""The order of the examination: what is closed and who answers before anything moves, light last, each on its own."""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.benches import opened
from nlos.doctor.aim_trial import beam_seen
from nlos.doctor.apart import apart, failure, role_of
from nlos.doctor.dark_trials import corners, dark_histogram, linearity, markers
from nlos.doctor.findings import Finding, failed, passed, skipped, warned
from nlos.doctor.hands import hands_for
from nlos.doctor.instruments import counter, dark_counts, links, mirror, shutter
from nlos.doctor.light_trials import beam_corners, count_rates, settle_curve
from nlos.doctor.repeats import listening
from nlos.doctor.shutter_trials import cable, dark_cable, interlock, trip, watchdog
from nlos.doctor.small_scan import small_scan
from nlos.doctor.surroundings import absent, disk, levels, software
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceError, DeviceLost, LimitError, SafetyTrip
from nlos.drivers.identity import DeviceIdentity

if TYPE_CHECKING:
    from nlos.configs.load import Loaded
    from nlos.drivers.bench_settings import BenchSettings

BOTH = frozenset({"mirror", "counter"})
COUNTER = frozenset({"counter"})


@dataclass(frozen=True)
class Check:
    """One thing that is looked at on an open bench, and which instruments that takes. `lit`: it opens the shutter."""

    name: str
    look: Callable[[Bench], Iterator[Finding]]
    needs: frozenset[str] = BOTH
    lit: bool = False


CHECKS = (
    Check("shutter", shutter, frozenset({"shutter"})),
    Check("links", links),
    Check("counter", counter, COUNTER),
    Check("dark counts", dark_counts, COUNTER),
    Check("mirror", mirror, frozenset({"mirror"})),
)
DARK = (
    Check("corners", corners, frozenset({"mirror"})),
    Check("markers", markers),
    Check("dark histogram", dark_histogram, COUNTER),
    Check("linearity", linearity, COUNTER),
)
SMALL_SCAN = Check("scan", small_scan, lit=True)
AIM = Check("aim", beam_seen, lit=True)
LIT = (
    Check("count rates", count_rates, lit=True),
    Check("beam", beam_corners, lit=True),
    Check("settling", settle_curve, lit=True),
    Check("trip", trip, lit=True),
    Check("watchdog", watchdog, lit=True),
    Check("interlock", interlock, lit=True),
)
NAMED = frozenset({"mirror", "counter", "shutter"})
APART = ("shutter", "counter", "dark counts", "mirror")
"""What is examined on its own where the bench does not open as a whole."""
_REOPENINGS = 15
_REOPEN_EVERY_S = 2.0


@dataclass
class Condition:
    """What is known to be out of order by now: role -> why."""

    lost: dict[str, str] = field(default_factory=dict)

    def obstacle(self, check: Check) -> str:
        """Why a check cannot be made; empty where it can."""
        needs = check.needs | ({"shutter", "light"} if check.lit else set())
        return next((why for role, why in self.lost.items() if role in needs), "")


def surroundings() -> Iterator[Finding]:
    """What can be said before anything is opened."""
    yield from software()
    yield from disk(Path())


@dataclass
class Visit:
    """One examination: how far it may go, and whom it met."""

    agreed: Callable[[Bench], bool]
    """Whether the shutter may open; asked once, when everything else is done."""
    clear_trip: str | None = None
    thorough: bool = False
    met: dict[str, DeviceIdentity] = field(default_factory=dict)
    """Role -> who answered."""
    may_move: Callable[[str], bool] = lambda why: not why
    """Whether the mirror may move, in the dark; told why nobody knows that it is, empty where it is."""


def examine(table: "Loaded[BenchSettings]", visit: Visit) -> Iterator[Finding]:
    """Everything that a scan needs, and thoroughly what a lab asks of it before its first one."""
    settings = table.settings
    yield from surroundings()
    yield from levels(settings)
    missing: dict[str, str] = {}
    for item in absent(settings):
        missing[item.role] = f"the {item.role} is missing"
        yield failed(item.model, f"{item.role} at {item.address}: {item.what}", item.remedy)
    unmoved = not missing and not visit.may_move("")
    if not missing and not unmoved:
        condition, was_open, lit = Condition(), False, False
        try:
            with listening() as repeats, opened(table) as bench:
                was_open = True
                visit.met.update(zip(("mirror", "counter"), bench.identities, strict=True))
                lit = yield from _on_the_bench(bench, visit, condition)
                yield repeats.finding()
        except DeviceError as error:
            yield failure(settings, error, silent=not was_open)
            if not was_open:
                missing[role_of(settings, error)] = f"the {role_of(settings, error)} failed before: {error.what}"
        if was_open:
            if visit.thorough and condition.lost:
                yield skipped("cable", next(iter(condition.lost.values())))
            elif visit.thorough:
                yield from pulled_and_replugged(table, lit)
            return
    if unmoved:
        missing["mirror"] = "it moves as it is opened, and nobody agreed to that: use --move when it is safe to"
    yield from apart(settings, missing, visit.may_move)
    everything = (*CHECKS, *(DARK if visit.thorough else ()), SMALL_SCAN, AIM, *(LIT if visit.thorough else ()))
    why = "the mirror was not to move" if unmoved else f"{' and '.join(sorted(missing))} missing or failed"
    yield from (skipped(check.name, why) for check in everything if check.name not in APART)


def _on_the_bench(bench: Bench, visit: Visit, condition: Condition) -> Generator[Finding, None, bool]:
    """Returns whether light was agreed to."""
    if visit.clear_trip is not None:
        bench.shutter.clear_trip(visit.clear_trip)
        yield passed("shutter", f"trip of {bench.settings.name} cleared in the name of {visit.clear_trip}")
    yield from run(bench, (*CHECKS, *(DARK if visit.thorough else ())), condition)
    light = not (condition.lost and visit.thorough) and visit.agreed(bench)
    if light:
        yield from run(bench, (SMALL_SCAN, AIM, *(LIT if visit.thorough else ())), condition)
        return True
    if condition.lost:
        yield skipped("scan", next(iter(condition.lost.values())))
    else:
        why = "it opens the shutter" if bench.settings.shutter_on != "nothing" else "there may be light"
        yield warned("scan", f"skipped: {why}", "Use --light when it is safe.")
    if visit.thorough:
        yield from (skipped(check.name, "it needs light") for check in LIT)
    return False


def pulled_and_replugged(table: "Loaded[BenchSettings]", light: bool) -> Iterator[Finding]:
    """A fault made by hand: the mirror's cable is pulled, and the bench opened again afterwards."""
    before: tuple[DeviceIdentity, ...] = ()
    try:
        with opened(table, quiet=True) as bench:
            before, hands = bench.identities, hands_for(bench)
            pulled = False
            for finding in run(bench, (Check("cable", cable if light else dark_cable),), Condition()):
                pulled = finding.verdict != "SKIP"
                yield finding
            if not (pulled and hands.replug()):
                return
    except DeviceLost:
        pass  # as it should be: the cable is out
    except DeviceError as error:
        yield failure(table.settings, error)
        return
    yield from _opened_again(table, before)


def _opened_again(table: "Loaded[BenchSettings]", before: tuple[DeviceIdentity, ...]) -> Iterator[Finding]:
    error: DeviceError | None = None
    for _ in range(_REOPENINGS):
        try:
            with opened(table, quiet=True) as bench:
                if bench.identities == before:
                    yield passed("replugged", "everything answers again, and as before")
                else:
                    yield failed("replugged", f"others answer: {bench.identities}", "Plug in what the bench names.")
                return
        except DeviceError as met:
            error = met
            if not table.settings.simulated:
                time.sleep(_REOPEN_EVERY_S)
    assert error is not None
    yield failed("replugged", error.said, error.remedy)


def run(bench: Bench, checks: tuple[Check, ...], condition: Condition) -> Iterator[Finding]:
    """The checks in their order. One that fails says so in its own line; those that need what failed are skipped."""
    for check in checks:
        before = -1
        while before < len(condition.lost):  # made again where what failed meanwhile is another instrument
            if why := condition.obstacle(check):
                yield skipped(check.name, why)
                break
            before = len(condition.lost)
            try:
                yield from check.look(bench)
                break
            except DeviceError as error:
                yield _failed(bench, check, error, condition)
                if not isinstance(error, LimitError):
                    _put_down(bench, condition)
                if isinstance(error, SafetyTrip) or role_of(bench.settings, error) in check.needs:
                    break
            finally:
                if bench.shutter.may_be_open:
                    bench.shutter.close(f"after {check.name}")


def _failed(bench: Bench, check: Check, error: DeviceError, condition: Condition) -> Finding:
    """The check's line, or that of another instrument that failed while it was made."""
    role = role_of(bench.settings, error)
    if isinstance(error, SafetyTrip):
        bench.shutter.latch(error.said)  # as in a scan: until a person clears it
        condition.lost |= dict.fromkeys(("light", "counter"), f"a trip is latched: {error.what}")
    elif not isinstance(error, LimitError):
        condition.lost[role] = f"the {role} failed before: {error.what}"
    ours = isinstance(error, SafetyTrip) or role not in NAMED or role in check.needs
    return failed(check.name if ours else role, error.said, error.remedy)


def _put_down(bench: Bench, condition: Condition) -> None:
    """What the check had begun; a mirror that is lost is not looked at any more while others work."""
    if "mirror" in condition.lost:
        bench.counter.meanwhile(lambda: None)
    for step in (bench.counter.abort, bench.mirror.stop):
        with suppress(DeviceError):
            step()
