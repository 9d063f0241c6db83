"""Benches, the faults that each of them can meet, and a plan that all of them scan."""

import json
import random
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.errors import DeviceError
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS

PATIENCE_S = 240
"""Of this machine, not of the bench: what takes longer hangs."""

SERIAL: list[tuple[str, dict[str, Any]]] = [
    ("G1", {}), ("G2", {"delay_s": 2.0}), ("G3", {"delay_s": 0.1}), ("G4", {"kind": "noise"}), ("G4", {"kind": "nul"}),
    ("G4", {"kind": "overlong"}), ("G5", {}), ("G6", {}), ("G7", {"chunk": 2}), ("G8", {"place": "read"}),
    ("G8", {"place": "write"}), ("G9", {}),
]  # fmt: skip
TRIGGERSCOPE: list[tuple[str, dict[str, Any]]] = [
    ("A2", {}), ("A4", {}), ("A6", {"kind": "missed"}), ("A6", {"kind": "extra"}), ("A7", {}),
    *(("A8", {"state": state}) for state in LEFT_OVERS), *(("A9", {"line": line}) for line in HALF_LINES),
]  # fmt: skip
OPTOTUNE: list[tuple[str, dict[str, Any]]] = [
    ("B1", {"reply": "NO"}), ("B1", {"reply": "OL"}), ("B2", {}), ("B3", {}), ("B4", {"bit": 1}),
    ("B5", {"place": "stuck"}), ("B6", {"off_by": 0.02}),
]  # fmt: skip
USB: list[tuple[str, dict[str, Any]]] = [
    ("U1", {}), ("U2", {}), ("U3", {"place": "in"}), ("U3", {"place": "out"}), ("U3", {"place": "control"}),
    ("U3", {"place": "interrupt"}), ("U4", {}), ("U5", {"field": "tag"}), ("U5", {"field": "kind"}),
    ("U6", {"what": "cut"}), ("U6", {"what": "early_end"}), ("U7", {}), ("U8", {"bytes": 2}), ("U10", {}),
    ("U11", {"place": "read"}), ("U11", {"place": "write"}), ("U12", {"what": "crc"}),
    ("U12", {"what": "number"}), ("U12", {"what": "header"}),
    ("U13", {"errors": 20}), ("U14", {"cause": "over_count"}), ("U14", {"cause": "watchdog"}),
    ("U14", {"cause": "sync"}), ("U15", {"what": "missed"}), ("U15", {"what": "overrun"}), ("U15", {"place": "clock"}),
    ("U16", {}), ("U18", {}), ("U19", {"delay_s": 0.05}),
]  # fmt: skip
LIST_MODE: list[tuple[str, dict[str, Any]]] = [
    ("U20", {"place": "records", "what": "marker_order"}), ("U20", {"place": "records", "what": "fifo_full"}),
    ("U20", {"place": "block"}),
]  # fmt: skip
VENDOR: list[tuple[str, dict[str, Any]]] = [
    ("V1", {"place": "GetFlags"}), ("V1", {"place": "ReadFiFo"}), ("V2", {}), ("V3", {}), ("V4", {}),
    ("U20", {"place": "marker", "late_pulses": 200}),
]  # fmt: skip
TAGGER: list[tuple[str, dict[str, Any]]] = [
    ("T1", {}), ("T2", {"place": "getData"}), ("T2", {"place": "getOverflowsAndClear", "lost": True}),
    ("T2", {"place": "sync"}), ("T4", {}),
]  # fmt: skip
HELIOS: list[tuple[str, dict[str, Any]]] = [
    ("H1", {"place": "sequence"}), ("H3", {"place": "frame"}), ("H3", {"place": "command"}),
    ("H3", {"place": "answer"}), ("H4", {}), ("H4", {"delay_s": 0.5}), *(("H2", {"place": line}) for line in
    ("marker_1", "marker_2", "marker_4", "trigger")),
]  # fmt: skip
BENCHES = {
    "stepped": ("simulated", {"counter": {"markers": False}}, SERIAL + TRIGGERSCOPE + USB),
    "clocked": ("simulated", {}, SERIAL + TRIGGERSCOPE + USB),
    "listed": ("simulated", {"counter": {"mode": "t3"}}, SERIAL + TRIGGERSCOPE + USB + LIST_MODE),
    "optotune": ("optotune", {}, SERIAL + OPTOTUNE + USB),
    "multiharp": ("multiharp", {}, SERIAL + TRIGGERSCOPE + VENDOR),
    "played": ("helios", {}, HELIOS + USB),
    "played, listed": ("helios", {"counter": {"mode": "t3"}}, HELIOS + USB + LIST_MODE),
    "timetagger": ("timetagger", {}, SERIAL + TRIGGERSCOPE + TAGGER),
    "timetagger list": ("timetagger", {"counter": {"mode": "list"}}, SERIAL + TRIGGERSCOPE + TAGGER),
}


@cache
def _faultless(name: str) -> BenchSettings:
    file, changes, _ = BENCHES[name]
    text = load("bench", file, BenchSettings).settings.model_dump(mode="json")
    for block, values in changes.items():
        text[block] |= values
    text["simulation"]["scene"]["surfel_m"] = 0.05
    return BenchSettings.model_validate_json(json.dumps(text))


def settings(name: str, *faults: Fault) -> BenchSettings:
    whole = _faultless(name)
    assert whole.simulation is not None
    return whole.model_copy(update={"simulation": whole.simulation.model_copy(update={"faults": faults})})


def drawn(chance: random.Random) -> tuple[str, list[list[Fault]]]:
    """A bench, and one to three faults at once on the first attempt, perhaps on the resumed one too."""
    name = chance.choice(sorted(BENCHES))

    def some() -> list[Fault]:
        return [
            Fault(name=word, skip=chance.choice((0, 1, 3, 10, 30, 60)), parameters=parameters)
            for word, parameters in chance.choices(BENCHES[name][2], k=chance.choice((1, 2, 2, 3)))
        ]

    return name, [some() for _ in range(chance.choice((1, 1, 2)))]


@cache
def plan(name: str, rows: int = 6, cols: int = 6, dwell_ms: float = 2.0, frames: int = 1) -> ScanPlan:
    width_ps = 40.0 if name == "multiharp" else 32.0
    return ScanSettings.model_validate(
        {
            "wall": {"width_m": 0.6, "height_m": 0.6, "rows": rows, "cols": cols},
            "pattern": {"kind": "serpentine"},
            "dwell_ms": dwell_ms,
            "frames": frames,
            "histogram": {"bins": 512, "bin_width_ps": width_ps, "offset_ns": 8.0},
        }
    ).plan()


def cuts_off_the_shutter(name: str, *faults: Fault) -> bool:
    """Whether a cable that is pulled is the shutter's own: a watchdog or the interlock has to close it then."""
    by_pin = settings(name).shutter.model == "triggerscope_ttl"
    return any(fault.name == ("G8" if by_pin else "U11") for fault in faults)


@contextmanager
def patience() -> Iterator[None]:
    """Fails the test whose block hangs."""

    def hangs(number: int, frame: object) -> None:
        pytest.fail(f"it hangs: nothing came of it in {PATIENCE_S} s")

    before = signal.signal(signal.SIGALRM, hangs)
    signal.alarm(PATIENCE_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def acknowledged(path: Path) -> dict[int, bytes]:
    """What the file has promised to keep: point number -> counts."""
    try:
        with Recording.open(path) as recording:
            first = [sample for sample in list(recording.rows())[: recording.acknowledged] if sample is not None]
            return {sample.point.number: sample.histogram.counts.tobytes() for sample in first}
    except (InvalidData, FileNotFoundError):
        return {}


def resumed_until_complete(
    path: Path,
    attempt: Callable[[list[Fault]], None],
    rounds: list[list[Fault]],
    after_each: Callable[[dict[int, bytes]], None],
) -> None:
    """Each round meets its faults. One that ends with a device's error is resumed: then what was acknowledged before
    still stands, and `after_each` judges what is acknowledged now. In the end the recording is complete."""
    safe: dict[int, bytes] = {}
    for faults in [*rounds, [], []]:  # at the end the person has fixed what broke
        try:
            attempt(faults)
        except DeviceError:
            now = acknowledged(path)
            assert safe.items() <= now.items()
            after_each(now)
            safe = now
            continue
        break
    else:
        pytest.fail("it did not even end with the faults gone")
    assert verify(path).complete
    assert safe.items() <= acknowledged(path).items()
