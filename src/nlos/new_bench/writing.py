"""Answers as a bench file: every line of it commented by what its key means."""

import json
from collections.abc import Mapping
from typing import Any

import yaml
from pydantic import BaseModel

from nlos.configs.describe import describe
from nlos.configs.settings import Settings
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.tcspc.block import CounterBlock, Pulse
from nlos.drivers.tcspc.known_counters import COUNTERS
from nlos.new_bench.attenuators import attenuator
from nlos.new_bench.questions import has_channels, keys_of_axis, shutter_key

_COMMENT_AT, _WIDTH = 38, 120
_HEAD = """\
# Written by `nlos new bench`; correct it by hand as you like. `nlos doctor --bench FILE` checks it, and
# `nlos schema bench` makes an editor complete its keys. Degrees of mirrors are mechanical, of the beam optical: twice.
"""


def blocks_of(name: str, said: Mapping[str, str], simulated: bool) -> dict[str, Any]:
    """The file's content. Raises `KeyError` where a question was not answered."""
    mirror: dict[str, Any] = {"model": said["mirror"], **_address("mirror", said, simulated)}
    if "volts_per_degree" in said:
        volts, has_dac = float(said["volts_per_degree"]), "dac" in keys_of_axis(MIRRORS[said["mirror"]].settings)
        for number, axis in enumerate("xy", start=1):
            mirror[axis] = {**({"dac": number} if has_dac else {}), "volts_per_degree": volts}
    if "max_mechanical_deg" in said:
        mirror["max_mechanical_deg"] = float(said["max_mechanical_deg"])
    if key := shutter_key(said):
        mirror[key] = int(said[key]) if said[key].isdecimal() else said[key]
    half_m, half_height_m = float(said["half_m"]), float(said["half_height_m"])
    found = {
        "name": name,
        "mirror": mirror,
        "counter": _counter(said, simulated),
        "shutter": {"model": said["shutter"]},
        "geometry": {
            "wall_distance_m": float(said["wall_distance_m"]),
            "mirror_separation_m": float(said["mirror_separation_m"]),
            "scanner_x_m": float(said["scanner_x_m"]),
            "scanner_y_m": float(said["scanner_y_m"]),
            "wall_pitch_deg": float(said["wall_pitch_deg"]),
            "wall_yaw_deg": float(said["wall_yaw_deg"]),
            "allowed": {"left_m": -half_m, "right_m": half_m, "bottom_m": -half_height_m, "top_m": half_height_m},
        },
        "laser": {"repetition_hz": float(said["repetition_hz"])},
    }
    if simulated:
        found["simulation"] = {"seed": 1, "scene": {"objects": [{"letter": "N", "centre_m": [0.0, 0.0, 0.8],
                                                                 "height_m": 0.5}]}}  # fmt: skip
    return found


def _counter(said: Mapping[str, str], simulated: bool) -> dict[str, Any]:
    settings = COUNTERS[said["counter"]].settings
    assert issubclass(settings, CounterBlock)
    counter: dict[str, Any] = {"model": said["counter"], **_address("counter", said, simulated)}
    if "device" in said:
        counter["device"] = said["device"]
    if settings.usual_mode is not None:
        counter["mode"] = settings.usual_mode
    counter |= settings.laser_keys(float(said["repetition_hz"]), said.get("device", ""))
    if "input" in settings.model_fields:
        counter["input"] = int(said["detector_input"])
    for role in (each for each in ("sync", "detector") if f"{each}_pulse" in said):
        pulse: Pulse = "nim" if said[f"{role}_pulse"] == "nim" else "ttl"
        keys = dict(settings.pulse_keys(pulse, said.get("device", "")) or {})
        if has_channels(settings):
            sign = -1 if keys.pop("edge", "rising") == "falling" else 1
            keys = {"channel": sign * int(said[f"{role}_input"]), **keys}
        counter[role] = keys
    if said.get("markers") == "yes":
        counter["markers"] = True
    if (output := int(said.get("pixel_clock", 0))) > 0:
        counter["pixel_clock"] = output
    return counter


def _address(role: str, said: Mapping[str, str], simulated: bool) -> dict[str, str]:
    """Where the device is plugged in."""
    settings = (MIRRORS if role == "mirror" else COUNTERS)[said[role]].settings
    match settings.cable:
        case "serial":
            return {"port": f"sim://{said[role]}" if simulated else said["port"]}
        case "usb":
            return {"usb": "simulated" if simulated else "auto"}
        case _:
            return {"library": "simulated" if simulated else "vendor"}


def bench_text(content: Mapping[str, Any]) -> str:
    """The file. Raises `pydantic.ValidationError` where these answers make no bench."""
    return _HEAD + "\n".join(_lines(content, BenchSettings.model_validate_json(json.dumps(content)), 0)) + "\n"


def attenuators(content: Mapping[str, Any]) -> list[str]:
    """What belongs into the cables of the counter's inputs before they are plugged in."""
    counter = BenchSettings.model_validate_json(json.dumps(content)).counter
    said = ((role, attenuator(getattr(counter, role))) for role in ("sync", "detector") if hasattr(counter, role))
    return [f"{role}: {what}" for role, what in said if what]


def _lines(content: Mapping[str, Any], block: BaseModel, depth: int) -> list[str]:
    assert isinstance(block, Settings)
    meanings, lines, indent = describe(type(block)), [], "  " * depth
    for key, value in content.items():
        inner, what = getattr(block, key), " ".join(meanings[key].what.split())
        if key == "level_mv" and (first := attenuator(block)):
            what = f"{first} {what}"
        if isinstance(value, dict) and isinstance(inner, Settings):
            lines += _commented(f"{indent}{key}:", what)
            lines += _lines(value, inner, depth + 1)
        else:
            text = yaml.safe_dump(value, default_flow_style=True, width=10_000).removesuffix("\n...\n").strip()
            lines += _commented(f"{indent}{key}: {text}", what)
    return lines


def _commented(line: str, what: str) -> list[str]:
    """The comment behind the line where it fits, else above it."""
    padded = f"{line:<{_COMMENT_AT}}  # {what}"
    if not what:
        return [line]
    if len(padded) <= _WIDTH:
        return [padded]
    indent = line[: len(line) - len(line.lstrip())]
    words, above = what.split(), f"{indent}#"
    wrapped = []
    for word in words:
        if len(above) + 1 + len(word) > _WIDTH:
            wrapped.append(above)
            above = f"{indent}#"
        above += f" {word}"
    return [*wrapped, above, line]
