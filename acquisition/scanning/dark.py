"""How a scan shuts its light: the shutter first, whatever comes next."""

from functools import partial

from nlos.acquisition.scanning.alarms import AlarmRaised
from nlos.acquisition.scanning.control import undeterred
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceError, SafetyTrip


def dark(bench: Bench, why: str) -> None:
    """Shutter first, then the gate, then the mirror's stepping. Raises `DeviceError`."""
    for step in (partial(bench.shutter.close, why), bench.counter.abort, bench.mirror.stop):
        undeterred(step)


def shut(bench: Bench, trip: SafetyTrip) -> None:
    """Light off before anything is written down; a trip, but not an alarm, keeps it off until a person clears it.
    What fails here is tried again on the way out."""
    try:
        if isinstance(trip, AlarmRaised):
            bench.shutter.close("an alarm")
            bench.report("trip", str(trip))
        else:
            bench.shutter.latch(trip.said)
    except DeviceError as error:
        bench.report("device", str(error))


def dark_whatever_happens(bench: Bench) -> None:
    """On the way out after an error: what fails here is reported, and tried again as the bench is closed."""
    for step in (bench.shutter.close, bench.counter.abort, bench.mirror.stop):
        try:
            step()
        except DeviceError as error:
            bench.report("device", str(error))
