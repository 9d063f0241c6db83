"""What of a bench its constants depend on: when one of these facts changes, constants measured before are stale."""

import json
from collections.abc import Mapping
from typing import Any

Facts = Mapping[str, object]
INSTRUMENTS = "instruments"
"""The fact that says of which kind a bench is: REAL or SIMULATED. Files of before it was kept lack it."""
REAL, SIMULATED = "real", "simulated"
_WIRES = {
    "port", "usb", "library", "serial", "vendor_id", "product_id", "timeout_s", "banner_timeout_s", "settle_timeout_s",
    "allow_unverified_dac", "shutter_pin", "max_mechanical_deg", "limits", "readback", "warn_error_deg",
    "max_error_deg",
    "controller", "settle", "over_count", "counts", "markers", "marker_level_mv", "marker_holdoff_ns",
    "marker_disorder_us", "mode", "levels_converted", "pixel_clock", "allowed", "allowed_deg",
}  # fmt: skip
"""Keys that move neither beam nor time: where a device is plugged in, how long it may take, how far it may go. A key
that a driver from elsewhere brings counts, as mounting does."""


def facts_of(bench_json: str) -> tuple[str, Facts]:
    """The bench's name, and its facts by dotted key; neither of a bench that is not stored. Raises `ValueError`."""
    bench = json.loads(bench_json)
    if not isinstance(bench, dict):
        raise ValueError("a bench is stored as a JSON object")
    facts: dict[str, object] = {}
    for part in ("geometry", "mirror", "counter"):
        _flatten(part, bench.get(part), facts)
    if facts:
        facts[INSTRUMENTS] = REAL if bench.get("simulation") is None else SIMULATED
    laser = bench.get("laser")
    if isinstance(laser, dict) and "repetition_hz" in laser:
        facts["laser.repetition_hz"] = laser["repetition_hz"]
    return str(bench.get("name", "")), facts


def _flatten(key: str, value: Any, into: dict[str, object]) -> None:
    if key.rpartition(".")[2] in _WIRES or value is None:
        return
    if isinstance(value, dict):
        for word, inner in value.items():
            _flatten(f"{key}.{word}", inner, into)
    else:
        into[key] = value


def changes(then: Facts, now: Facts) -> list[str]:
    """What differs, each with both values. A key that only one of them knows is of another version of the program."""
    return [
        f"{key} {_shown(then[key])} then, {_shown(now[key])} now"
        for key in then
        if key in now and not _same(then[key], now[key])
    ]


def _same(one: object, other: object) -> bool:
    if isinstance(one, int | float) and isinstance(other, int | float):
        return abs(one - other) <= 1e-9 * max(abs(one), abs(other))
    return one == other


def _shown(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
