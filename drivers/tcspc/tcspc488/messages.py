"""What is said to a `tcspc488` and what its answers mean: pure functions, no device."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nlos.drivers.errors import LimitError, ProtocolError, SafetyTrip, SyncLost, WrongDevice
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.link.scpi import ScpiError
from nlos.drivers.tcspc.counter import CountRates, HistogramAxis, StopAtCounts, Trigger

WIDTHS = 16
"""Bin widths are the base width times 1, 2, 4, ..., so many of them."""
_STATES = ("IDLE", "ARMED", "RUN", "DONE", "TRIP", "FAULT")
_TRIPS = {
    101: "the detector's rate was too high for too long (over-count trip)",
    102: "the interlock loop is open",
    103: "the laser's sync signal is missing",
    105: "the watchdog was not kicked in time",
}
_CAUSES = {"OVER": 101, "INTL": 102, "SYNC": 103, "WDOG": 105}
_PICO = 1e12
_LARGEST_OFFSET_PS = 10**8


@dataclass(frozen=True)
class Capacity:
    """`SYST:CAPS?`."""

    base_ps: int
    max_bins: int
    slots: int
    max_points: int


@dataclass(frozen=True)
class Status:
    """`ACQ:STAT?`, with the steps that the markers counted where `ACQ:MARK?` was asked too."""

    state: str
    done: int
    free: int
    lost: int
    flags: int
    markers: int | None

    @property
    def running(self) -> bool:
        """Whether points are still to come."""
        return self.state in ("ARMED", "RUN")

    @property
    def tripped(self) -> bool:
        """Whether the light was shut off by the instrument."""
        return self.state in ("TRIP", "FAULT")


def decode_identity(device: str, answer: str) -> DeviceIdentity:
    """`*IDN?`. Raises `WrongDevice` for anything but this profile."""
    fields = answer.strip().split(",")
    if len(fields) != 4 or fields[1] != "TCSPC-488":
        raise WrongDevice(device, f"it identifies itself as {answer.strip()!r}.", "Check usb: in the bench file.")
    return DeviceIdentity("tcspc488", *fields)


def decode_capacity(device: str, answer: str) -> Capacity:
    """`SYST:CAPS?`."""
    try:
        base_ps, max_bins, slots, max_points = (int(each) for each in answer.split(",")[:4])
    except ValueError as problem:
        raise ProtocolError(device, f"SYST:CAPS? answered {answer!r}.") from problem
    return Capacity(base_ps, max_bins, slots, max_points)


def decode_status(device: str, answer: str) -> Status:
    """`ACQ:STAT?`, or `ACQ:STAT?;:ACQ:MARK?`."""
    status, _, marks = answer.partition(";")
    try:
        state, *numbers = status.split(",")
        done, free, lost, flags = (int(each) for each in numbers)
        markers = _steps(*(int(each) for each in marks.split(","))) if marks else None
    except (TypeError, ValueError) as problem:
        raise ProtocolError(device, f"ACQ:STAT? answered {answer!r}.") from problem
    if state not in _STATES:
        raise ProtocolError(device, f"ACQ:STAT? answered {answer!r}.")
    return Status(state, done, free, lost, flags, markers)


def decode_rates(device: str, answer: str) -> CountRates:
    """`INP:RATE?`: what the inputs count per second."""
    fields = answer.split(",")
    try:
        sync_hz, detector_hz = (float(each) for each in fields[:2])
    except ValueError as problem:
        raise ProtocolError(device, f"INP:RATE? answered {answer!r}.") from problem
    if len(fields) != 3 or not (0 <= sync_hz < math.inf and 0 <= detector_hz < math.inf):
        raise ProtocolError(device, f"INP:RATE? answered {answer!r}.")
    return CountRates(sync_hz, detector_hz)


def _steps(first: int, second: int, start: int) -> int:
    """Steps seen by the marker inputs: 1 and 2 take turns, 4 rises with the first step of a sequence. A sequence of odd
    length that wraps round raises no edge on 1, which is high already, but a second one on 4."""
    return first + second + max(0, start - 1)


def is_trip(errors: Sequence[ScpiError]) -> bool:
    """Whether one of these errors says that the light was shut off."""
    return any(error.code in _TRIPS for error in errors)


def safety_error(device: str, errors: Sequence[ScpiError], cause: str) -> SafetyTrip:
    """The trip among `errors`, or the one that `PROT:TRIP?` named."""
    codes = [error.code for error in errors if error.code in _TRIPS] or [_CAUSES.get(cause, 0)]
    words = _TRIPS.get(codes[0], f"it reports a trip ({cause or 'no cause given'})")
    kind = SyncLost if codes[0] == 103 else SafetyTrip
    return kind(
        device,
        f"{words}; the shutter is closed.",
        "Find out why, then run `nlos doctor --bench BENCH --clear-trip YOUR-NAME`.",
    )


def microseconds(device: str, seconds: float) -> int:
    """A dwell in the instrument's unit. Raises `LimitError` where it is not a whole number of us, or out of range."""
    value = round(seconds * 1e6)
    if not 1 <= value <= 10**7 or abs(seconds * 1e6 - value) > 1e-3:
        raise LimitError(
            device, f"{seconds * 1e3:g} ms cannot be timed exactly.", "Times are whole us from 1 us to 10 s."
        )
    return value


def axis_commands(device: str, axis: HistogramAxis, capacity: Capacity) -> dict[str, str]:
    """Header and value of each axis setting. Raises `LimitError` where the instrument cannot represent it exactly."""
    if not 64 <= axis.bins <= capacity.max_bins:
        raise LimitError(device, f"{axis.bins} bins are outside 64 to {capacity.max_bins}.")
    width_ps, offset_ps = axis.bin_width_s * _PICO, axis.offset_s * _PICO
    units = round(width_ps / capacity.base_ps)
    if units < 1 or units.bit_count() != 1 or units >= 1 << WIDTHS or abs(units * capacity.base_ps - width_ps) > 1e-6:
        raise LimitError(
            device,
            f"bin width {width_ps:g} ps is not {capacity.base_ps} ps times a power of two.",
            f"Take {capacity.base_ps}, {2 * capacity.base_ps}, {4 * capacity.base_ps}, ... ps.",
        )
    if not 0 <= round(offset_ps) <= _LARGEST_OFFSET_PS or abs(round(offset_ps) - offset_ps) > 1e-3:
        raise LimitError(device, f"offset {offset_ps:g} ps is not a whole number of ps from 0 to 100 us.")
    return {
        "HIST:BWID": str(units * capacity.base_ps),
        "HIST:BINS": str(axis.bins),
        "HIST:OFFS": str(round(offset_ps)),
    }


def stop_commands(device: str, axis: HistogramAxis, stop: StopAtCounts | None) -> dict[str, str]:
    """Header and value of what ends a point early. Raises `LimitError` for a window outside the axis."""
    if stop is None:
        return {"ACQ:STOP:COUN": "0"}
    if not (stop.counts >= 1 and 0 <= stop.first_bin < stop.end_bin <= axis.bins):
        raise LimitError(
            device, f"cannot stop at {stop.counts} counts in bins {stop.first_bin} to {stop.end_bin} of {axis.bins}."
        )
    return {"ACQ:STOP:WIND": f"{stop.first_bin},{stop.end_bin}", "ACQ:STOP:COUN": str(stop.counts)}


def arm_commands(
    dwells_us: Sequence[int], trigger: Trigger, blanking_us: int, stops: bool, mode: str
) -> tuple[dict[str, str], dict[str, list[int]]]:
    """Header and value of each setting of an acquisition, and the lists that go as blocks."""
    uniform = min(dwells_us) == max(dwells_us)
    clocked = trigger is Trigger.CLOCK
    # The period is the least time between edges: blanking and dwell, or, where gates differ in length, no more than
    # makes each edge follow the gate before it.
    period_us = blanking_us + (dwells_us[0] if uniform and not stops else 1)
    source = {Trigger.HOST: "BUS", Trigger.CLOCK: "IMM", Trigger.MIRROR: "EXT"}[trigger]
    commands = {
        "ACQ:MODE": mode,
        "ACQ:POIN": str(len(dwells_us)),
        "ACQ:BLAN": str(0 if trigger is Trigger.HOST else blanking_us),
        "ACQ:TRIG:SOUR": source,
        "OUTP:PCLK": str(10 * period_us if clocked else 0),
        "ACQ:DWEL": str(dwells_us[0]),
    }
    return commands, {} if uniform else {"ACQ:DWEL:LIST": list(dwells_us)}
