"""An instrument that is switched off and on while somebody is asked whether a scan goes on: it goes on as it was told,
or ends, and never takes a point by other settings."""

from collections.abc import Callable
from functools import cache

import pytest

from nlos.acquisition.scanning.control import ScanControl
from nlos.acquisition.scanning.engine import scan
from nlos.drivers.bench import Bench, open_bench
from nlos.drivers.errors import DeviceError, DeviceReset
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plugged
from tests.acquisition.fault_cases import BENCHES, plan, settings

AFTER, DWELL_MS = 6, 20.0


def mirror_restarts(bench: Bench) -> None:
    """Its banner waits to be read."""
    cable = plugged(bench.settings.mirror.model)
    cable.say(cable.firmware.reboot())


def mirror_restarts_unheard(bench: Bench) -> None:
    """As where an adapter between them lost what it said."""
    plugged(bench.settings.mirror.model).firmware.reboot()


def counter_restarts(bench: Bench) -> None:
    assert bench.simulated is not None
    bench.simulated.faults.add(Fault(name="U18", after_s=bench.clock.now()))


CASES = [
    (name, happens)
    for name, (file, _, faults) in BENCHES.items()
    for happens, applies in (
        (mirror_restarts, file != "helios"),
        (mirror_restarts_unheard, file != "helios"),
        (counter_restarts, ("U18", {}) in faults),
    )
    if applies
]


def scanned(name: str, happens: Callable[[Bench], None] | None) -> tuple[dict[int, bytes], list[str]]:
    """Counts by point, and warnings, of a scan that is paused after some points while that happens."""
    said: list[str] = []
    with open_bench(settings(name)) as bench:
        bench.on_event = lambda kind, text: said.append(text) if kind == "warning" else None
        assert bench.simulated is not None

        def asked(why: str) -> bool:
            assert not bench.simulated.shutter_open
            said.clear()
            if happens is not None:
                happens(bench)
            bench.clock.sleep(60.0)
            return True

        control, found = ScanControl(asked), {}
        for sample in scan(plan(name, dwell_ms=DWELL_MS), bench, control=control):
            found[sample.point.number] = sample.histogram.counts.tobytes()
            if len(found) == AFTER:
                control.interrupt()
        assert not bench.simulated.shutter_open
    return found, said


@cache
def undisturbed(name: str) -> dict[int, bytes]:
    return scanned(name, None)[0]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("name", "happens"), CASES, ids=lambda each: each if isinstance(each, str) else each.__name__)
def test_a_scan_goes_on_after_its_pause_as_if_nothing_had_been(name: str, happens: Callable[[Bench], None]) -> None:
    if (name, happens) == ("optotune", mirror_restarts):  # it has nothing to forget, and says that it restarted
        with pytest.raises(DeviceReset):
            scanned(name, happens)
        return
    found, said = scanned(name, happens)
    assert found == undisturbed(name)
    assert len(found) == 36
    if happens is not mirror_restarts_unheard:
        assert any("restarted" in warning for warning in said)


def test_another_instrument_that_answers_after_the_pause_is_refused() -> None:
    def exchanged(bench: Bench) -> None:
        assert bench.simulated is not None
        fault = Fault(name="U18", after_s=bench.clock.now(), parameters={"new_identity": True})
        bench.simulated.faults.add(fault)

    with pytest.raises(DeviceError, match="it now says it is a"):
        scanned("clocked", exchanged)
