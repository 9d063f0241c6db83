"""The firmware of a simulated `tcspc488`: every command of the instrument profile, at the level of its messages."""

from collections.abc import Callable
from functools import partial

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.scpi_parser import ErrorQueue, ScpiFault, ScpiParser, block, integer, word
from nlos.drivers.simulated.tcspc488.acquisition import (
    MAX_POINTS,
    RATE_WINDOW_S,
    SLOTS,
    Acquisition,
    AcquisitionSettings,
)
from nlos.drivers.simulated.tcspc488.data import answer_block, answer_records, encode_block
from nlos.drivers.simulated.tcspc488.protection import TRIPS
from nlos.drivers.simulated.usb.descriptors import UsbDescription

BASE_PS = 4
MAX_BINS = 65536
_INPUTS = {
    "INP:SYNC:LEV": (-1200, 1200, -100), "INP:SYNC:DIV": (1, 16, 1), "INP:SYNC:DEL": (-99999, 99999, 0),
    "INP:DET:LEV": (-1200, 1200, -100), "INP:DET:DEL": (-99999, 99999, 0), "INP:DET:DTIM": (800, 160000, 800),
}  # fmt: skip


class Tcspc488Firmware:
    """Plug it in with `SimulatedUsb([Tcspc488Firmware(bench)], bench.clock)`."""

    def __init__(self, bench: SimulatedBench, serial: str = "SIM0001", packet_bytes: int = 512) -> None:
        self.usb = UsbDescription(0x1209, 0x0001, "NLOS", "TCSPC-488", serial, packet_bytes)
        self.faults = bench.faults
        self._bench = bench
        self._errors = ErrorQueue()
        self._now_s = 0.0
        self._events = 0
        self._enable = {"*ESE": 0, "*SRE": 0}
        self._operation = False
        self._srq = False
        self._firmware = "1.0.0"
        self.acquisition = Acquisition(bench, self._refuse, self._operation_event)
        self._power_up()
        self._parser = ScpiParser(self._handlers())

    def _power_up(self) -> None:
        self._inputs = {name: default for name, (_, _, default) in _INPUTS.items()}
        self._edges = {"INP:SYNC:EDGE": "POS", "INP:DET:EDGE": "NEG", "ACQ:TRIG:EDGE": "POS"}
        self._changed_s = self._now_s
        self.acquisition.abort()
        self.acquisition.settings = AcquisitionSettings()

    # The message instrument

    def execute(self, message: bytes, now_s: float) -> bytes:
        """Runs a program message at `now_s`; its response message."""
        self._now_s = now_s
        strikes = self.faults.strikes
        if fault := strikes("U18", now_s):
            self._reboot(bool(fault.parameters.get("new_identity", False)))
        if fault := strikes("U13", now_s):
            for _ in range(int(fault.parameters.get("errors", 1))):
                self._refuse(int(fault.parameters.get("code", -200)))
        return self._parser.execute(message, self._refuse)

    def trigger(self, now_s: float) -> None:
        self._now_s = now_s
        self.acquisition.trigger(now_s)

    def message_exchange_error(self, code: int) -> None:
        self._refuse(code)

    def advance(self, now_s: float) -> None:
        self.acquisition.advance(now_s)

    def next_event_s(self) -> float:
        return self.acquisition.next_event_s()

    def take_service_request(self) -> bool:
        asked, self._srq = self._srq, False
        return asked

    def status_byte(self) -> int:
        status = (4 if len(self._errors) else 0) | (8 if self.acquisition.protection.tripped else 0)
        status |= (32 if self._events & self._enable["*ESE"] else 0) | (128 if self._operation else 0)
        return status | (64 if status & self._enable["*SRE"] else 0)

    def _operation_event(self) -> None:
        self._operation = True
        if self.status_byte() & 64 and not self.faults.strikes("U16", self._bench.clock.now()):
            self._srq = True

    def _refuse(self, code: int) -> None:
        self._errors.push(code)
        self._events |= 32 if -199 <= code <= -100 else 16 if -299 <= code <= -200 else 4 if code <= -400 else 8

    def _reboot(self, new_identity: bool) -> None:
        self._errors.clear()
        self._enable = {"*ESE": 0, "*SRE": 0}
        self._operation = self._srq = False
        if new_identity:
            self._firmware = "0.9.0"
        self.acquisition.protection.command_shutter(False)
        self.acquisition.kick_watchdog(self._now_s, 0.0)
        self._power_up()

    # Commands

    def _handlers(self) -> dict[str, Callable[[bytes], bytes | None]]:
        acquisition, handlers = self.acquisition, {
            "*IDN?": lambda a: f"NLOS,TCSPC-488,{self.usb.serial},{self._firmware}".encode(),
            "*RST": lambda a: self._power_up(),
            "*CLS": self._clear_status,
            "*OPC": lambda a: None, "*OPC?": lambda a: b"1", "*WAI": lambda a: None, "*TST?": lambda a: b"0",
            "*ESR?": self._event_register, "*STB?": lambda a: b"%d" % self.status_byte(),
            "*TRG": lambda a: self.acquisition.trigger(self._now_s),
            "SYST:ERR?": lambda a: self._errors.pop(), "SYST:ERR:NEXT?": lambda a: self._errors.pop(),
            "SYST:CAPS?": lambda a: f"{BASE_PS},{MAX_BINS},{SLOTS},{MAX_POINTS},{self._firmware}".encode(),
            "SYST:WDOG": self._watchdog, "SYST:WDOG?": lambda a: f"{acquisition.protection.watchdog_s:g}".encode(),
            "SYST:WDOG:KICK": lambda a: acquisition.kick_watchdog(self._now_s),
            "INP:RATE?": self._rates,
            "INIT": self._initiate, "ABOR": lambda a: acquisition.abort(),
            "ACQ:STAT?": self._status, "ACQ:MARK?": lambda a: b"%d,%d,%d" % tuple(acquisition.markers),
            "ACQ:DATA?": self._data, "TTAG:DATA?": self._time_tags,
            "TTAG:CRC?": lambda a: b"%d" % acquisition.tags.checksum,
            "ACQ:DWEL": lambda a: self._set(dwells_us=[integer(a, 1, 10**7)]),
            "ACQ:DWEL?": lambda a: b"%d" % acquisition.settings.dwells_us[0],
            "ACQ:DWEL:LIST": lambda a: self._set(dwells_us=self._list(a, 1, 10**7)),
            "ACQ:DWEL:LIST?": lambda a: answer_block(acquisition.settings.dwells_us),
            "ACQ:NUMB:LIST": lambda a: self._set(numbers=self._list(a, 0, 2**32 - 1)),
            "ACQ:NUMB:LIST?": lambda a: answer_block(acquisition.settings.numbers),
            "ACQ:STOP:WIND": self._stop_window,
            "ACQ:STOP:WIND?": lambda a: b"%d,%d" % (acquisition.settings.stop_window or (0, 0)),
            "HIST:BWID": self._bin_width, "HIST:BWID?": lambda a: b"%d" % acquisition.settings.bin_width_ps,
            "HIST:FORM": lambda a: self._set(wide=word(a, ("U16", "U32")) == "U32"),
            "HIST:FORM?": lambda a: b"U32" if acquisition.settings.wide else b"U16",
            "ACQ:MODE": lambda a: self._set(mode=word(a, ("HIST", "T3"))),
            "ACQ:MODE?": lambda a: acquisition.settings.mode.encode(),
            "ACQ:TRIG:SOUR": lambda a: self._set(source=word(a, ("IMM", "BUS", "EXT"))),
            "ACQ:TRIG:SOUR?": lambda a: acquisition.settings.source.encode(),
            "PROT:TRIP?": lambda a: TRIPS.get(acquisition.protection.tripped, "NONE").encode(),
            "PROT:CLE": lambda a: acquisition.clear_trip(),
            "OUTP:SHUT": self._shutter, "OUTP:SHUT?": self._shutter_state,
            "INTL?": lambda a: b"OK" if self._bench.interlock_closed else b"OPEN",
        }  # fmt: skip
        for header, name, low, high in (
            ("HIST:BINS", "bins", 64, MAX_BINS), ("HIST:OFFS", "offset_ps", 0, 10**8),
            ("ACQ:POIN", "points", 1, MAX_POINTS), ("ACQ:BLAN", "blanking_us", 0, 10**6),
            ("ACQ:STOP:COUN", "stop_counts", 0, 2**32 - 1), ("ACQ:TRIG:TOUT", "trigger_timeout_ms", 0, 10**6),
            ("OUTP:PCLK", "clock_100ns", 0, 10**9), ("PROT:RATE", "trip_rate_hz", 0, 10**9),
            ("PROT:TIME", "trip_time_ms", 1, 1000),
        ):  # fmt: skip
            handlers[header] = partial(self._set_number, name, low, high)
            handlers[header + "?"] = partial(self._number, name)
        for header in _INPUTS:
            handlers[header] = partial(self._set_input, header)
            handlers[header + "?"] = partial(self._input, header)
        for header in self._edges:
            handlers[header] = partial(self._set_edge, header)
            handlers[header + "?"] = partial(self._edge, header)
        for header in self._enable:
            handlers[header] = partial(self._set_enable, header)
            handlers[header + "?"] = partial(self._enabled, header)
        return handlers

    def _set(self, **values: object) -> None:
        """Settings stand still while an acquisition is armed (-221); protection may always be changed."""
        protection = next(iter(values)) in ("trip_rate_hz", "trip_time_ms")
        if self.acquisition.state in ("ARMED", "RUN") and not protection:
            raise ScpiFault(-221)
        for name, value in values.items():
            setattr(self.acquisition.settings, name, value)

    def _set_number(self, name: str, low: int, high: int, argument: bytes) -> None:
        self._set(**{name: integer(argument, low, high)})

    def _number(self, name: str, argument: bytes) -> bytes:
        return b"%d" % getattr(self.acquisition.settings, name)

    def _set_input(self, header: str, argument: bytes) -> None:
        low, high, _ = _INPUTS[header]
        value = integer(argument, low, high)
        if header.endswith("DIV") and value not in (1, 2, 4, 8, 16):  # pulses between are reckoned: it changes nothing
            raise ScpiFault(-222)
        self._inputs[header] = value
        self._changed_s = self._now_s

    def _input(self, header: str, argument: bytes) -> bytes:
        return b"%d" % self._inputs[header]

    def _set_edge(self, header: str, argument: bytes) -> None:
        self._edges[header] = word(argument, ("POS", "NEG"))
        self._changed_s = self._now_s

    def _edge(self, header: str, argument: bytes) -> bytes:
        return self._edges[header].encode()

    def _set_enable(self, header: str, argument: bytes) -> None:
        self._enable[header] = integer(argument, 0, 255)

    def _enabled(self, header: str, argument: bytes) -> bytes:
        return b"%d" % self._enable[header]

    def _bin_width(self, argument: bytes) -> None:
        width_ps = integer(argument, BASE_PS, BASE_PS << 15)
        if width_ps % BASE_PS or (width_ps // BASE_PS).bit_count() != 1:
            raise ScpiFault(-222)
        self._set(bin_width_ps=width_ps)

    def _list(self, argument: bytes, low: int, high: int) -> list[int]:
        payload = block(argument)
        if len(payload) % 4 or not 0 < len(payload) <= 4 * MAX_POINTS:
            raise ScpiFault(-222)
        values = memoryview(payload).cast("I").tolist()
        if not low <= min(values) <= max(values) <= high:
            raise ScpiFault(-222)
        return values

    def _stop_window(self, argument: bytes) -> None:
        first, comma, last = argument.partition(b",")
        if not comma:
            raise ScpiFault(-109)
        window = integer(first, 0, MAX_BINS - 1), integer(last, 1, MAX_BINS)
        if window[1] <= window[0]:
            raise ScpiFault(-222)
        self._set(stop_window=window)

    def _watchdog(self, argument: bytes) -> None:
        try:
            period_s = float(argument)
        except ValueError:
            raise ScpiFault(-102 if argument else -109) from None
        if period_s != 0 and not 0.1 <= period_s <= 60:
            raise ScpiFault(-222)
        self.acquisition.kick_watchdog(self._now_s, period_s)

    def _initiate(self, argument: bytes) -> None:
        acquisition = self.acquisition
        settings = acquisition.settings
        if acquisition.protection.tripped:
            raise ScpiFault(acquisition.protection.tripped)
        if acquisition.state in ("ARMED", "RUN"):
            raise ScpiFault(-213)
        if any(1 < len(each) != settings.points for each in (settings.dwells_us, settings.numbers)):
            raise ScpiFault(-221)
        self._operation = False
        acquisition.arm(self._now_s)

    def _status(self, argument: bytes) -> bytes:
        this = self.acquisition
        return b"%s,%d,%d,%d,%d" % (this.state.encode(), this.done, this.free, this.all_lost, this.flags)

    def _data(self, argument: bytes) -> bytes:
        first, comma, count = argument.partition(b",")
        if not comma:
            raise ScpiFault(-109)
        self._require("HIST")
        slots = self.acquisition.slots(integer(first, 0, MAX_POINTS), integer(count, 1, MAX_POINTS))
        if slots is None:
            raise ScpiFault(-230)
        fault = self.faults.strikes("U12", self._now_s)
        return answer_records(slots, self.acquisition, str(fault.parameters.get("what", "crc")) if fault else "")

    def _time_tags(self, argument: bytes) -> bytes:
        self._require("T3")
        return encode_block(self.acquisition.tags.take(integer(argument, 1, 2**20), self._now_s))

    def _require(self, mode: str) -> None:
        if self.acquisition.settings.mode != mode:
            raise ScpiFault(-221)

    def _rates(self, argument: bytes) -> bytes:
        age_s = self._now_s - self._changed_s
        if age_s < RATE_WINDOW_S:
            raise ScpiFault(-221)
        seen = self.acquisition.look(self._now_s)
        rates = seen.sync_count / RATE_WINDOW_S, seen.total_count / RATE_WINDOW_S, min(age_s, 1e6) * 1e3
        return b"%d,%d,%d" % rates

    def _shutter(self, argument: bytes) -> None:
        opens = word(argument, ("OPEN", "CLOS", "CLOSE")) == "OPEN"
        if opens and self.acquisition.protection.tripped:
            raise ScpiFault(self.acquisition.protection.tripped)
        if opens and not self._bench.interlock_closed:
            raise ScpiFault(102)
        self.acquisition.protection.command_shutter(opens)

    def _shutter_state(self, argument: bytes) -> bytes:
        return b"%s,%s" % tuple(
            b"OPEN" if each else b"CLOS"
            for each in (self.acquisition.protection.shutter_commanded, self._bench.shutter_open)
        )

    def _clear_status(self, argument: bytes) -> None:
        self._errors.clear()
        self._events = 0
        self._operation = False

    def _event_register(self, argument: bytes) -> bytes:
        events, self._events = self._events, 0
        return b"%d" % events
