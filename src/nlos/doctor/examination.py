"""The order of the examination: what is closed and who answers before anything moves, light last, each on its own."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from nlos.cli.benches import opened
from nlos.doctor.apart import apart, failure, role_of
from nlos.doctor.findings import Finding, failed, passed, skipped, warned
from nlos.doctor.instruments import counter, dark_counts, links, mirror, shutter
from nlos.doctor.small_scan import small_scan
from nlos.doctor.surroundings import absent, disk, levels, software
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceError, LimitError, SafetyTrip

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
SMALL_SCAN = Check("scan", small_scan, lit=True)


@dataclass
class Condition:
    """What is known to be out of order by now: role -> why."""

    lost: dict[str, str] = field(default_factory=dict)

    def obstacle(self, check: Check) -> str:
        """Why a check cannot be made; empty where it can."""
        needs = check.needs | ({"shutter", "light"} if check.lit else set())
        return next((why for role, why in self.lost.items() if role in needs), "")


def surroundings(table: "Loaded[BenchSettings]") -> Iterator[Finding]:
    """What can be said before anything is opened."""
    yield from software()
    yield from disk(Path())
    yield from levels(table.settings)


def examine(
    table: "Loaded[BenchSettings]", light: bool, clear_trip: str | None, then: Callable[[Bench], Iterator[Finding]]
) -> Iterator[Finding]:
    """Everything that a scan needs; `then` goes on with the open bench where all of it is there."""
    settings = table.settings
    yield from surroundings(table)
    missing: set[str] = set()
    for item in absent(settings):
        missing.add(item.role)
        yield failed(item.model, f"{item.role} at {item.address}: {item.what}", item.remedy)
    if not missing:
        was_open = False
        try:
            with opened(table) as bench:
                was_open = True
                yield from _on_the_bench(bench, light, clear_trip)
                yield from then(bench)
        except DeviceError as error:
            yield failure(settings, error)
            if was_open:
                return  # what closing met: all else has been said
            missing.add(role_of(settings, error))
    if missing:
        yield from apart(settings, missing)
        yield from (skipped(check.name, f"{_listed(missing)} missing or failed") for check in (*CHECKS, SMALL_SCAN)
                    if check.needs >= BOTH)  # fmt: skip


def _on_the_bench(bench: Bench, light: bool, clear_trip: str | None) -> Iterator[Finding]:
    if clear_trip is not None:
        bench.shutter.clear_trip(clear_trip)
        yield passed("shutter", f"trip cleared in the name of {clear_trip}")
    condition = Condition()
    yield from run(bench, CHECKS, condition)
    if not light:
        yield warned("scan", "not done: it opens the shutter", "Say --light when it is safe to.")
        return
    yield from run(bench, (SMALL_SCAN,), condition)


def run(bench: Bench, checks: tuple[Check, ...], condition: Condition) -> Iterator[Finding]:
    """The checks in their order. One that fails says so in its own line; those that need what failed are skipped."""
    for check in checks:
        if why := condition.obstacle(check):
            yield skipped(check.name, why)
            continue
        try:
            yield from check.look(bench)
        except LimitError as error:
            yield failed(check.name, f"{error.device}: {error.what}", error.remedy)
        except DeviceError as error:
            role = "light" if isinstance(error, SafetyTrip) else role_of(bench.settings, error)
            condition.lost[role] = f"the {role} failed before: {error.what}"
            yield failed(check.name, f"{error.device}: {error.what}", error.remedy)
        finally:
            if bench.shutter.may_be_open:
                bench.shutter.close(f"after {check.name}")


def _listed(roles: set[str]) -> str:
    return " and ".join(sorted(roles))
