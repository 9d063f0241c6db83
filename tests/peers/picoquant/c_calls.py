"""The stand-in for PicoQuant's libraries as functions of C, for hosts that pass whatever ctypes can make a pointer of.

What our driver never asks for is answered here.
"""

import ctypes
from typing import Any

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary

A_CALL_S = 5e-4
_INTEGERS, _TEXT_BYTES = "i", 64
_SIGNATURES = {
    "GetLibraryVersion": "t", "GetErrorString": "ti", "OpenDevice": "it", "CloseDevice": "i", "Initialize": "iii",
    "Calibrate": "i", "GetSerialNumber": "it", "GetHardwareInfo": "ittt", "GetBaseResolution": "idn",
    "SetSyncDiv": "ii",
    "SetSyncEdgeTrg": "iii", "SetInputEdgeTrg": "iiii", "SetSyncCFD": "iii", "SetInputCFD": "iiii",
    "SetSyncOffset": "ii", "SetSyncChannelOffset": "ii", "SetInputChannelOffset": "iii", "SetInputChannelEnable": "iii",
    "SetStopOverflow": "iii", "SetMarkerEdges": "iiiii", "SetMarkerEnable": "iiiii", "SetMarkerHoldoffTime": "ii",
    "SetBinning": "ii", "GetResolution": "id", "SetOffset": "ii", "SetHistoLen": "iin", "SetTriggerOutput": "ii",
    "ClearHistMem": "i", "StartMeas": "ii", "StopMeas": "i", "CTCStatus": "in", "GetElapsedMeasTime": "id",
    "GetHistogram": "ihi", "ReadFiFo": "irin", "GetFlags": "in", "GetSyncRate": "in", "GetCountRate": "iin",
    "GetNumOfInputChannels": "in", "GetWarnings": "in", "GetFeatures": "in", "GetSyncPeriod": "id",
}  # fmt: skip
"""i: an integer; pointers to t: text, n: an integer, d: a double, h: a histogram, r: records."""
_OTHERS = {
    "PH_Initialize": "ii", "PH_ClearHistMem": "ii", "HH_GetHistogram": "ihii", "MH_ReadFiFo": "irn",
}  # fmt: skip
_ANSWERED_HERE = {"GetNumOfInputChannels": 1, "GetWarnings": 0, "GetFeatures": 0, "GetSyncPeriod": 1e-7}


class CCalls:
    """`LIB.MH_StartMeas` is a function pointer of ctypes. Bench time passes while it is called."""

    def __init__(self, functions: PicoquantLibrary, bench: SimulatedBench) -> None:
        self._functions, self._bench = functions, bench
        self._made: dict[str, Any] = {}  # C holds no reference to what it calls
        self.records: list[int] = []
        self.refused: list[tuple[str, int]] = []

    def __getattr__(self, name: str) -> Any:
        prefix, _, bare = name.partition("_")
        if bare not in _SIGNATURES or prefix != self._functions._family.prefix:
            raise AttributeError(name)
        if name not in self._made:
            kinds = _OTHERS.get(name, _SIGNATURES[bare])
            types = [ctypes.c_int if kind == _INTEGERS else ctypes.c_void_p for kind in kinds]
            made = ctypes.CFUNCTYPE(ctypes.c_int, *types)(lambda *given: self._call(name, bare, kinds, given))
            self._made[name] = made
        return self._made[name]

    def _call(self, name: str, bare: str, kinds: str, given: tuple[int, ...]) -> int:
        if bare in _ANSWERED_HERE:
            self._at(kinds[-1], given[-1]).value = _ANSWERED_HERE[bare]
            return 0
        self._bench.clock.sleep(A_CALL_S)
        targets = [self._at(kind, address) for kind, address in zip(kinds, given, strict=True)]
        passed = [ctypes.byref(each) if kind in "nd" else each for kind, each in zip(kinds, targets, strict=True)]
        code = int(getattr(self._functions, name)(*passed))
        for kind, address, each in zip(kinds, given, targets, strict=True):
            if kind == "t" and code == 0:
                ctypes.memmove(address, each.value + b"\0", len(each.value) + 1)
        if bare == "ReadFiFo" and code == 0:
            self.records += targets[1][: targets[-1].value]
        if code < 0:
            self.refused.append((name, code))
        return code

    def _at(self, kind: str, given: int) -> Any:
        """What our stand-in takes for it: an integer, a buffer of its own, or the host's memory."""
        family = self._functions._family
        if kind == _INTEGERS:
            return given
        if kind == "t":
            return ctypes.create_string_buffer(_TEXT_BYTES)
        kinds = {
            "n": ctypes.c_int, "d": ctypes.c_double, "h": ctypes.c_uint * self._functions._length,
            "r": ctypes.c_uint * family.most_fifo_records,
        }  # fmt: skip
        return kinds[kind].from_address(given)
