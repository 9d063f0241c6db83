"""A stand-in for PHLib, HHLib or MHLib with one instrument behind it, for whoever calls through ctypes.

Pointers arrive as `byref(...)`, strings and arrays as ctypes buffers, and the C functions' return codes go back. What
the calls do, and the order that they must come in, is taken from the libraries' manuals, not from the adapter.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.drivers.simulated.bench import Gate, SimulatedBench
from nlos.drivers.simulated.picoquant.error_texts import TEXTS
from nlos.drivers.simulated.picoquant.inputs import NIM_MV, SYNC_DEAD_S, edge_crossed
from nlos.drivers.simulated.sync_input import SyncInput
from nlos.drivers.simulated.t3_instrument import T3Instrument
from nlos.drivers.tcspc.picoquant.families import FAMILIES

_TEXT_BYTES = {"GetLibraryVersion": 8, "GetErrorString": 40, "OpenDevice": 32, "GetSerialNumber": 32}
"""How much a call may write to its first string, whatever the caller reserved (the vendor's demo)."""
_RATES_VALID_S = {"PH": 0.1, "HH": 0.4, "MH": 0.15}
"""After Initialize or SetSyncDiv, by the demo programs of PHLib 3, HHLib 3 and MHLib 3."""
_BASE_PS, _T3 = {"PH": 4.0, "HH": 1.0, "MH": 5.0}, 3
_BEFORE_OPEN = frozenset(("GetLibraryVersion", "GetErrorString", "OpenDevice", "CloseDevice"))
_BEFORE_INITIALIZE = frozenset(("Initialize", "GetSerialNumber"))


def _write(pointer: Any, value: float) -> None:
    """Sets what a `byref` points at."""
    pointer._obj.value = value


class PicoquantLibrary:
    """Functions by their full names (`MH_StartMeas`), as attributes."""

    def __init__(
        self,
        bench: SimulatedBench,
        device: str,
        repetition_hz: float,
        seed: int = 0,
        serial: str = "1050001",
        version: str = "3.1",
    ) -> None:
        self._bench, self._family = bench, FAMILIES[device]
        self._serial, self._version, self._seed = serial, version, seed
        self._sync = SyncInput(repetition_hz, SYNC_DEAD_S[self._family.prefix])
        self._t3 = T3Instrument(bench, self._family.layout, repetition_hz, seed, self._sync)
        self._open = self._calibrated = False
        self._sync_crossed = self._detector_crossed = False
        self._mode: int | None = None
        self._binning = self._offset = 0
        self._length = self._family.fixed_bins or 65536
        self._counts: npt.NDArray[np.uint32] | None = None
        self._set_up_s = self._started_s = self._ends_s = 0.0
        self._running = False
        self._sticky_flags = 0
        self._pulses = True

    def __getattr__(self, name: str) -> Callable[..., int]:
        prefix, _, bare = name.partition("_")
        method = getattr(type(self), f"_{bare}", None)
        if prefix != self._family.prefix or method is None or (bare == "SetTriggerOutput" and prefix != "MH"):
            raise AttributeError(f"{self._family.linux_library}: undefined symbol: {name}")

        def call(*arguments: Any) -> int:
            strings = [each for each in arguments if isinstance(getattr(each, "value", None), bytes)]
            if any(len(each) < _TEXT_BYTES.get(bare, 0) for each in strings):
                raise MemoryError(f"{name} writes {_TEXT_BYTES[bare]} bytes into a buffer of {len(strings[0])}")
            return self._called(bare, method, arguments)

        return call

    def _called(self, name: str, method: Callable[..., int], arguments: tuple[Any, ...]) -> int:
        now_s = self._bench.clock.now()
        fault = self._bench.faults.strikes("V1", now_s, name)
        if fault is not None:
            return int(fault.parameters.get("code", -36))
        if name in _BEFORE_OPEN:
            return method(self, *arguments)
        if not self._open or arguments[0] != 0:
            return -20  # as the real libraries say where nothing was opened
        if self._mode is None and name not in _BEFORE_INITIALIZE:
            return -22
        if name == "StartMeas" and not self._calibrated:
            return -23
        if self._mode == _T3:
            self._t3.advance(now_s)
        return method(self, *arguments[1:])

    # Opening

    def _GetLibraryVersion(self, text: Any) -> int:
        text.value = self._version.encode()
        return 0

    def _GetErrorString(self, text: Any, code: int) -> int:
        text.value = f"{self._family.prefix}_{TEXTS.get(code, f'ERROR_{-code}')}".encode()
        return 0

    def _OpenDevice(self, index: int, serial: Any) -> int:
        if index != 0:
            return -1
        if self._open:
            return -2 if self._family.prefix == "HH" else -11  # HHLib's header has no -11
        serial.value = self._serial.encode()
        self._open = True
        return 0

    def _CloseDevice(self, index: int) -> int:
        if index == 0 and self._open:
            self._open, self._mode, self._running = False, None, False
            self._t3.stop()
        return 0

    def _Initialize(self, mode: int, reference: int = 0) -> int:
        if mode not in (0, 2, _T3) or reference not in (0, 1):
            return -17
        self._mode, self._calibrated = mode, not self._family.constant_fraction
        self._set_up_s = self._bench.clock.now()
        return 0

    def _Calibrate(self) -> int:
        self._calibrated = True
        return 0

    def _GetSerialNumber(self, text: Any) -> int:
        text.value = self._serial.encode()
        return 0

    def _GetHardwareInfo(self, model: Any, part: Any, version: Any) -> int:
        model.value, part.value, version.value = self._family.product.encode(), b"930000", b"2.0"
        return 0

    def _GetBaseResolution(self, resolution: Any, steps: Any) -> int:
        _write(resolution, _BASE_PS[self._family.prefix])
        _write(steps, self._family.most_binning_codes)
        return 0

    # Setting

    def _SetSyncDiv(self, divider: int) -> int:
        if divider not in self._family.sync_dividers:
            return -17
        self._set_up_s, self._sync.divider = self._bench.clock.now(), divider
        return 0

    def _accept(self, *_: Any) -> int:
        return 0

    def _SetSyncEdgeTrg(self, level_mv: int, edge: int) -> int:
        if not (-1200 <= level_mv <= 1200 and edge in (0, 1)):
            return -17
        self._sync_crossed = edge_crossed(level_mv, edge)
        return 0

    def _SetInputEdgeTrg(self, channel: int, level_mv: int, edge: int) -> int:
        if not (-1200 <= level_mv <= 1200 and edge in (0, 1)):
            return -17
        self._detector_crossed = self._t3.hears = edge_crossed(level_mv, edge)
        return 0

    def _SetSyncCFD(self, level_mv: int, zero_cross_mv: int) -> int:
        if not (0 <= level_mv <= 1000 and 0 <= zero_cross_mv <= self._family.most_zero_cross_mv):
            return -17
        self._sync_crossed = 0 < level_mv < NIM_MV
        return 0

    def _SetInputCFD(self, channel: int, level_mv: int, zero_cross_mv: int) -> int:
        if self._family.prefix == "PH" and channel == 0:
            return self._SetSyncCFD(level_mv, zero_cross_mv)
        if not (0 <= level_mv <= 1000 and 0 <= zero_cross_mv <= self._family.most_zero_cross_mv):
            return -17
        self._detector_crossed = self._t3.hears = 0 < level_mv < NIM_MV
        return 0

    _SetSyncOffset = _SetSyncChannelOffset = _accept
    _SetInputChannelOffset = _SetInputChannelEnable = _SetStopOverflow = _SetMarkerEdges = _SetMarkerEnable = _accept
    _SetMarkerHoldoffTime = _accept

    def _SetBinning(self, binning: int) -> int:
        if not 0 <= binning < self._family.most_binning_codes:
            return -17
        self._binning = binning
        return 0

    def _GetResolution(self, picoseconds: Any) -> int:
        _write(picoseconds, self._bin_width_s * 1e12)
        return 0

    def _SetOffset(self, offset: int) -> int:
        if not 0 <= offset <= self._family.largest_offset:
            return -17
        self._offset = offset
        return 0

    def _SetHistoLen(self, code: int, actual: Any) -> int:
        if not 0 <= code <= 6:
            return -17
        self._length = 1024 << code
        _write(actual, self._length)
        return 0

    def _SetTriggerOutput(self, period_100ns: int) -> int:
        if not 0 <= period_100ns <= 16_777_215:
            return -17
        self._t3.set_clock(period_100ns, self._bench.clock.now())
        return 0

    # Measuring

    @property
    def _bin_width_s(self) -> float:
        return _BASE_PS[self._family.prefix] * 1e-12 * (1 << self._binning)

    def _ClearHistMem(self, block: int = 0) -> int:
        self._counts = None
        return -18 if self._mode else 0

    def _StartMeas(self, milliseconds: int) -> int:
        if self._running and self._family.prefix != "HH":  # two demos of HHLib's start once more, and go on
            return -16
        if not 1 <= milliseconds <= 360_000_000:
            return -17
        now_s = self._bench.clock.now()
        self._running, self._started_s, self._ends_s = True, now_s, now_s + milliseconds * 1e-3
        self._sticky_flags = 0
        if self._mode == _T3:
            self._t3.start(now_s, self._ends_s, self._bin_width_s)
        else:
            offset_s, number = self._offset * self._family.offset_unit_s, self._bench.turns.next_number()
            gate = Gate(now_s, milliseconds * 1e-3, self._length, self._bin_width_s, offset_s, number)
            self._counts = self._sync.histogram(self._bench, gate, self._seed)
        return 0

    def _StopMeas(self) -> int:
        if self._running:
            self._ends_s = min(self._ends_s, self._bench.clock.now())
        self._running = False
        self._t3.stop()
        return 0

    def _CTCStatus(self, status: Any) -> int:
        _write(status, int(not self._running or self._bench.clock.now() >= self._ends_s - 1e-9))
        return 0

    def _GetElapsedMeasTime(self, elapsed_ms: Any) -> int:
        until_s = min(self._bench.clock.now(), self._ends_s)
        _write(elapsed_ms, round((until_s - self._started_s) * 1e3, 6))
        return 0

    def _GetHistogram(self, counts: Any, block_or_channel: int, *_: int) -> int:
        if self._mode != 0:
            return -18
        if self._running:
            return -16
        target: npt.NDArray[np.uint32] = np.frombuffer(counts, np.uint32)
        target[:] = 0
        if self._counts is not None and self._detector_crossed and block_or_channel == 0:
            target[: self._length] = np.minimum(self._counts, self._family.largest_count)
        return 0

    def _ReadFiFo(self, buffer: Any, *rest: Any) -> int:
        if self._mode != _T3:
            return -18
        most = min(rest[0] if self._family.fifo_takes_count else len(buffer), len(buffer))
        records = self._t3.read(most)
        np.frombuffer(buffer, np.uint32)[: len(records)] = records
        _write(rest[-1], len(records))
        return 0

    def _GetFlags(self, flags: Any) -> int:
        family, now_s = self._family, self._bench.clock.now()
        for name, bit in (("V2", family.fifo_full), ("V3", family.sync_lost), ("V4", family.system_error)):
            if self._bench.faults.strikes(name, now_s) is not None:
                self._sticky_flags |= bit
                self._pulses &= name != "V3"
        if self._counts is not None and int(self._counts.max(initial=0)) > family.largest_count:
            self._sticky_flags |= family.overflow
        _write(flags, self._sticky_flags | (family.fifo_full if self._t3.overrun else 0))
        return 0

    def _GetSyncRate(self, rate: Any) -> int:
        _write(rate, round(self._sync.rate_hz) if self._sync_crossed and self._pulses and self._counted else 0)
        return 0

    def _GetCountRate(self, channel: int, rate: Any) -> int:
        if self._family.prefix == "PH" and channel == 0:
            return self._GetSyncRate(rate)
        seen = self._bench.expose(Gate(self._bench.clock.now(), 0.1, 1024, self._bin_width_s, 0.0, kept=False))
        wired = channel == (1 if self._family.prefix == "PH" else 0)
        _write(rate, round(seen.total_count / seen.live_s) if wired and self._detector_crossed and self._counted else 0)
        return 0

    @property
    def _counted(self) -> bool:
        """Whether the rate meters have, since the inputs were set up."""
        return self._bench.clock.now() >= self._set_up_s + _RATES_VALID_S[self._family.prefix]
