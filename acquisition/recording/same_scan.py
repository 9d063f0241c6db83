"""Whether a recording is one of the scan that is to be resumed: its plan, constants, devices and bench."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.tcspc.known_counters import COUNTERS

_SHOWN = 60


class ResumeRefused(InvalidData):
    """The recording was made with another plan, other constants or other devices, or it is another run's."""


def check_same_scan(recording: Recording, plan: ScanPlan, header: Header, same_run: bool) -> None:
    """Raises `ResumeRefused` where plan, constants, devices or bench are not those of the recording, or with `same_run`
    its identity."""
    place = f"{recording.path}: cannot be resumed: "
    remedy = ". Go back to what it was made with, or start a new recording."
    if not _continues(recording, plan):
        raise ResumeRefused(f"{place}its plan is not the one given ({_other_plan(recording.plan, plan)}){remedy}")
    if other := _other_constants(json.loads(recording.header.constants_json), json.loads(header.constants_json)):
        raise ResumeRefused(f"{place}it was taken with other calibration constants ({other}){remedy}")
    then, now = (json.loads(each.bench_json) for each in (recording.header, header))
    if other := _other_geometry(then, now, json.loads(header.constants_json)):
        raise ResumeRefused(f"{place}the bench file's geometry, by which it was aimed, is another ({other}){remedy}")
    if same_run and recording.header.identity != header.identity:
        raise ResumeRefused(f"{place}it is a recording of another run. Choose another folder or name.")
    if difference := _other_device(recording.header.devices, header.devices):
        raise ResumeRefused(f"{place}{difference}{remedy}")
    if other := _other_bench(then, now):
        raise ResumeRefused(f"{place}the bench file says otherwise by now ({other}){remedy}")


def _continues(recording: Recording, plan: ScanPlan) -> bool:
    """Whether the plans are the same, or one is of a film until it is stopped and the other lists its beginning, which
    has to hold what was taken."""
    before = recording.plan
    if before.until_stopped == plan.until_stopped:
        return before == plan
    film, beginning = (before, plan) if before.until_stopped else (plan, before)
    taken = int(recording.intact_records()["number"].max(initial=0)) + 1
    return taken <= len(beginning) <= len(film) and beginning == film.ended_after(len(beginning))


def _other_plan(before: ScanPlan, now: ScanPlan) -> str:
    both = min(len(before), len(now))
    if before.until_stopped or now.until_stopped:  # one may only have got farther
        before, now = before.ended_after(both), now.ended_after(both)
    if len(before) != len(now):
        return f"{len(before)} points then, {len(now)} now"
    if other := _changed(before.scalars(), now.scalars()):
        return other
    pairs = ((name, column, now.columns()[name]) for name, column in before.columns().items())
    for name, then, here in pairs:
        for point in np.flatnonzero(then != here)[:1]:
            return f"{name} of point {point}: {then[point]} then, {here[point]} now"
    return "it has a budget or lines of its own"


def _other_constants(before: Any, now: Any) -> str:
    """Where constants are not those recorded; that none took part is itself recorded."""
    if bool(before) == bool(now):
        return _changed(before, now)
    return f"constants: {_short(before)} then, {_short(now)} now"


def _other_geometry(before: Mapping[str, Any], now: Mapping[str, Any], constants: Any) -> str:
    """Of a scan that is aimed by it and not by constants; what is `allowed` aims nothing."""
    then, here = (each.get("geometry") or {} for each in (before, now))
    return "" if constants else _changed({key: then[key] for key in then if key in here and key != "allowed"}, here)


def _other_bench(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """What of mirror, counter and laser matters to the photons of a point: everything that a model does not name as
    incidental. Of the laser, what was known then."""
    for role, models in (("mirror", MIRRORS), ("counter", COUNTERS), ("laser", {})):
        then, here = (each.get(role) or {} for each in (before, now))
        model = models.get(str(here.get("model")))
        aside = model.settings.incidental if model is not None else frozenset()
        known = {key: then[key] for key in then if key in here and key not in aside and then[key] not in ("", None)}
        if other := _changed(known, here):
            return f"{role}: {other}"
    return _other_simulation(before.get("simulation") or {}, now.get("simulation") or {})


def _other_simulation(then: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Of a simulated bench, whose serial numbers tell nothing: what is on its table, faults and witnesses aside."""
    known = {key: then[key] for key in then if key in here and key not in ("faults", "witness")}
    other = _changed(known, here)
    return other and f"simulation: {other}"


def _changed(before: Any, now: Any, name: str = "") -> str:
    """The first difference, of what was recorded: an earlier version wrote fewer keys. Empty where there is none."""
    if isinstance(before, dict) and isinstance(now, dict):
        inner = f"{name}." if name else ""
        return next((found for key in before if (found := _changed(before[key], now.get(key), inner + key))), "")
    return "" if before == now else f"{name}: {_short(before)} then, {_short(now)} now"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _other_device(before: Mapping[str, DeviceIdentity], now: Mapping[str, DeviceIdentity]) -> str:
    for role in sorted({*before, *now}):
        if before.get(role) != now.get(role):
            return f"its {role} was {before.get(role)}, now it is {now.get(role)}"
    return ""
