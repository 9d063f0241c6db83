"""NI-DAQmx's C library with one simulated card, by the prototypes of NI's header and what NI's help says of each call.

NI's own package `nidaqmx` calls it through the C interface, with the argument types that NI declares. The card and its
wiring share no line with the example: volts are made angles by what is soldered in the bench file's keys.
"""

import ctypes
import json
import math
import time
from ctypes import CFUNCTYPE, POINTER, c_char_p, c_double, c_int32, c_uint8, c_uint32, c_void_p
from functools import partial
from pathlib import Path
from typing import Any

BUSY, NO_CARD, NO_OUTPUT, NO_RANGE, TOO_MUCH, NOT_STARTED = -50103, -200220, -200170, -200077, -200561, -200846
GONE, SHORT = -201003, -200228
WORDS = {
    BUSY: "The specified resource is reserved. The operation could not be completed as specified.",
    NO_CARD: "Device identifier is invalid.",
    NO_OUTPUT: "Physical channel specified does not exist on this device.",
    NO_RANGE: "Requested value is not a supported value for this property.",
    TOO_MUCH: "Attempted writing analog data that is too large or too small.",
    NOT_STARTED: "Write cannot be performed when the auto start input to DAQmx Write is false and task is not running.",
    GONE: "Device cannot be accessed.",
}
_INT, _TEXT = POINTER(c_int32), c_char_p
_SPLIT = (c_int32, c_uint32, c_double, c_int32)  # samples, auto start, timeout, layout
PROTOTYPES: dict[str, tuple[Any, ...]] = {
    "CreateTask": (_TEXT, POINTER(c_void_p)),
    "StartTask": (c_void_p,),
    "StopTask": (c_void_p,),
    "ClearTask": (c_void_p,),
    "CreateAOVoltageChan": (c_void_p, _TEXT, _TEXT, c_double, c_double, c_int32, _TEXT),
    "CreateDOChan": (c_void_p, _TEXT, _TEXT, c_int32),
    "WriteAnalogF64": (c_void_p, *_SPLIT, POINTER(c_double), _INT, c_void_p),
    "WriteDigitalLines": (c_void_p, *_SPLIT, POINTER(c_uint8), _INT, c_void_p),
    "GetTaskAttribute": (c_void_p, c_int32, c_void_p, c_uint32),
    "GetChanAttribute": (c_void_p, _TEXT, c_int32, c_void_p, c_uint32),
    "GetWriteAttribute": (c_void_p, c_int32, c_void_p, c_uint32),
    "GetDeviceAttribute": (_TEXT, c_int32, c_void_p, c_uint32),
    "GetSystemInfoAttribute": (c_int32, c_void_p, c_uint32),
    "GetExtendedErrorInfo": (c_void_p, c_uint32),
}


class Card:
    """One card "Dev1" with two outputs of 16 bits and a port of eight lines; `put` is told (output, value)."""

    def __init__(self, put: Any, ranges: tuple[float, ...] = (-10.0, 10.0)) -> None:
        self.put, self.ranges = put, ranges
        self.outputs = {"Dev1/ao0": 0.0, "Dev1/ao1": 0.0, **{f"Dev1/port0/line{bit}": False for bit in range(8)}}
        self.held: dict[str, int] = {}
        self.plugged, self.hangs, self._said = True, "nothing", 0
        self.tasks: dict[int, dict[str, Any]] = {}

    def CreateTask(self, name: bytes, task: Any) -> int:
        number = max(self.tasks, default=0x1000) + 16
        self.tasks[number] = {"name": name.decode() or f"_unnamedTask<{number:X}>", "channels": {}, "runs": False}
        task[0] = number
        return 0

    def CreateAOVoltageChan(self, task: int, output: bytes, *rest: Any) -> int:
        return self._add(task, output.decode(), rest[1:3])

    def CreateDOChan(self, task: int, lines: bytes, *rest: Any) -> int:
        return self._add(task, lines.decode(), None)

    def _add(self, task: int, output: str, span: tuple[float, float] | None) -> int:
        if not output.startswith("Dev1/"):
            return NO_CARD
        if output not in self.outputs:
            return NO_OUTPUT
        self.tasks[task]["channels"][output] = span
        return 0

    def StartTask(self, task: int) -> int:
        """Verifies, reserves, commits, starts: an output changes by a write alone."""
        channels = self.tasks[task]["channels"]
        if not self.plugged:
            return GONE
        pairs = list(zip(self.ranges[::2], self.ranges[1::2], strict=True))
        if any(span and not any(a <= span[0] and span[1] <= b for a, b in pairs) for span in channels.values()):
            return NO_RANGE
        if any(self.held.get(output, task) != task for output in channels):
            return BUSY
        self.held |= dict.fromkeys(channels, task)
        self.tasks[task]["runs"] = True
        return 0

    def StopTask(self, task: int) -> int:
        self.held = {output: holder for output, holder in self.held.items() if holder != task}
        self.tasks[task]["runs"] = False
        return 0

    def ClearTask(self, task: int) -> int:
        """Outputs keep what they have."""
        self.StopTask(task)
        del self.tasks[task]
        return 0

    def WriteAnalogF64(self, task: int, count: int, auto: int, timeout: float, layout: int, *rest: Any) -> int:
        low, high = next(iter(self.tasks[task]["channels"].values()))
        volts = rest[0][: len(self.tasks[task]["channels"])]
        return self._write(task, auto, rest[1], volts, all(low <= each <= high for each in volts))

    def WriteDigitalLines(self, task: int, count: int, auto: int, timeout: float, layout: int, *rest: Any) -> int:
        return self._write(task, auto, rest[1], [bool(rest[0][0])], True)

    def _write(self, task: int, auto: int, written: Any, values: list[Any], fits: bool) -> int:
        while self.hangs in str(self.tasks[task]["channels"]):
            time.sleep(0.002)
        runs = self.tasks[task]["runs"]
        if not self.plugged:
            return GONE
        if not runs and not auto:
            return NOT_STARTED
        if not runs and (code := self.StartTask(task)):
            return code
        if not fits:
            return TOO_MUCH
        step = 20.0 / 65536
        for output, value in zip(self.tasks[task]["channels"], values, strict=True):
            self.outputs[output] = value if isinstance(value, bool) else round(value / step) * step
        self.put(self.outputs)
        written[0] = 1
        return 0 if runs else self.StopTask(task)

    def GetTaskAttribute(self, task: int, attribute: int, value: int, size: int) -> int:
        channels = ", ".join(self.tasks[task]["channels"])
        return self._text({0x1276: self.tasks[task]["name"], 0x1273: channels}[attribute], value, size)

    def GetChanAttribute(self, task: int, channel: bytes, attribute: int, value: int, size: int) -> int:
        digital = None in self.tasks[task]["channels"].values()
        return self._number({0x187F: 10153 if digital else 10102}[attribute], value)  # DO, AO

    def GetWriteAttribute(self, task: int, attribute: int, value: int, size: int) -> int:
        return self._number({0x217F: 1}[attribute], value)  # lines a channel

    def GetDeviceAttribute(self, card: bytes, attribute: int, value: int, size: int) -> int:
        if card != b"Dev1":
            return NO_CARD
        if attribute == 0x299B:
            return self._doubles(value, size)
        if attribute == 0x0631:
            return self._text("USB-6343", value, size)
        return self._number({0x0632: 0x1ABCDEF, 0x22CA: 0}[attribute], value)

    def GetSystemInfoAttribute(self, attribute: int, value: int, size: int) -> int:
        if attribute == 0x193B:
            return self._text("Dev1" if self.plugged else "", value, size)
        return self._number({0x1272: 24, 0x1923: 5, 0x2F22: 0}[attribute], value)  # version

    def GetExtendedErrorInfo(self, text: int, size: int) -> int:
        self._text(f"{WORDS.get(self._said, '')}\n\nStatus Code: {self._said}", text, size)
        return 0

    def answer(self, name: str, *given: Any) -> int:
        """What a function returns; an error is kept for the next question about it."""
        code: int = getattr(self, name)(*given)
        self._said = code if code < 0 else self._said
        return code

    @staticmethod
    def _text(text: str, value: int, size: int) -> int:
        """The size that it needs where there is no room at all, as for every text of NI's."""
        data = text.encode() + b"\0"
        if size == 0:
            return len(data)
        ctypes.memmove(value, data, min(len(data), size))
        return 0 if len(data) <= size else SHORT

    @staticmethod
    def _number(number: int, value: int) -> int:
        c_uint32.from_address(value).value = number
        return 0

    def _doubles(self, value: int, size: int) -> int:
        if size:
            (c_double * size).from_address(value)[:] = self.ranges[:size]
        return 0 if size else len(self.ranges)


class Library:
    """What `nidaqmx` takes for the loaded library: a C function by every name; those that are not here are absent."""

    def __init__(self, card: Card) -> None:
        pointer = ctypes.CDLL(None)._FuncPtr
        for name, takes in PROTOTYPES.items():
            called = CFUNCTYPE(c_int32, *takes)(partial(card.answer, name))
            function = pointer(ctypes.cast(called, c_void_p).value)
            function.kept = called
            setattr(self, f"DAQmx{name}", function)


def plugged_in(card: Card) -> Any:
    """NI's package, with the card at the other end."""
    import nidaqmx
    import nidaqmx._lib as lib
    import nidaqmx.system

    lib.lib_importer._windll = lib.lib_importer._cdll = lib.DaqFunctionImporter(Library(card))
    lib.lib_importer._encoding = "utf-8"
    return nidaqmx


def on_table(settings: Any, table: Any) -> Any:
    """The same on a simulated bench: a head behind the outputs, a shutter behind line 0, and a log of every output."""
    from nlos.drivers.galvo.mirror import MirrorAngles
    from nlos.drivers.simulated.servo import GalvoHead

    head, bench, before = GalvoHead(table.bench.servo), table.bench, dict[str, Any]()

    def put(outputs: dict[str, Any]) -> None:
        with Path("outputs.jsonl").open("a") as log:
            log.write(json.dumps([outputs[each] for each in ("Dev1/ao0", "Dev1/ao1", "Dev1/port0/line0")]) + "\n")
        if outputs["Dev1/port0/line0"] != before.get("Dev1/port0/line0"):
            bench.set_shutter(outputs["Dev1/port0/line0"])
        x_v, y_v = outputs["Dev1/ao0"], outputs["Dev1/ao1"]
        there = MirrorAngles(math.radians(x_v / 0.4), math.radians((y_v - 0.25) / -0.25))
        if (x_v, y_v) != (before.get("Dev1/ao0"), before.get("Dev1/ao1")):
            head.steer(there, bench.clock.now())
            bench.follow_path(head.at, there, bench.clock.now())
        before.update(outputs)

    return plugged_in(Card(put))
