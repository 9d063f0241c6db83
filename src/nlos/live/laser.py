"""What a recording says of the laser's light: on, off, or why nobody can tell."""

import json
from collections.abc import Iterable
from enum import StrEnum
from functools import lru_cache
from typing import Any

from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Event

NO_SHUTTER = "none"
"""The model of a bench whose laser no program switches."""
_NOT_CONFIRMED = "NOT CONFIRMED CLOSED"


class Light(StrEnum):
    """What is known of the light of a scan."""

    ON = "on"
    OFF = "off"
    MAYBE = "maybe"
    """A shutter that nobody has seen close since it was told to, or that nobody commands any more."""
    NO_SHUTTER = "no shutter"
    REPLAYED = "replayed"
    """The samples come from another recording: no laser has a part in it."""
    UNTOLD = "untold"
    """No bench stands behind the file: another program's scan, say."""


def light_said(header: Header, events: Iterable[Event], under_way: bool) -> Light:
    """The newest word about the light; a shutter that was opened and never closed by whoever is gone may be open."""
    for event in reversed(tuple(events)):
        if event.kind == "replayed":
            return Light.REPLAYED
        if event.kind == "log_full":  # what came after is not in the file
            return Light.MAYBE
        if event.kind != "shutter":
            continue
        if event.text.startswith("opened"):
            return Light.ON if under_way else Light.MAYBE
        if event.text.startswith(_NOT_CONFIRMED):
            return Light.MAYBE
        if event.text.startswith("closed"):
            return Light.OFF
    model = shutter_model(header)
    if model == NO_SHUTTER:
        return Light.NO_SHUTTER
    return Light.OFF if model else Light.UNTOLD  # closed until a scan opens it


def shutter_model(header: Header) -> str:
    """As the bench file of the recording says; empty where there was none."""
    shutter = _bench(header.bench_json).get("shutter")
    return str(shutter.get("model", "")) if isinstance(shutter, dict) else ""


def is_simulated(header: Header) -> bool:
    """Whether the bench was a simulated one."""
    return bool(_bench(header.bench_json).get("simulation"))


@lru_cache(maxsize=8)
def _bench(bench_json: str) -> dict[str, Any]:
    return dict(json.loads(bench_json))
