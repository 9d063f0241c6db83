"""A TriggerScope-MM (firmware V4B v.620-MM) and the galvo head on two of its DACs, traps included.

Written from the behaviour of the vendor's published firmware, independently of the driver: commands arriving together
are parsed as one, PAO writes past its table, long PAO replies overrun their buffer, clearing fills a table with code 0.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.settle import SettleModel
from nlos.drivers.galvo.triggerscope.mirror import TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench

_DACS = 16
_STATES = 1200
_REPLY_BUFFER = 20  # bytes, the NUL included, for the reply to PAO
_SPAN_V = {1: (0.0, 5.0), 2: (0.0, 10.0), 3: (-5.0, 5.0), 4: (-10.0, 10.0), 5: (-2.5, 2.5)}
_BANNER = b"ARC TRIGGERSCOPE 16 R4 Board 4B v.620-MM"
_COMMAND = re.compile(rb"[A-Z]{3}(\d+(?:-\d+)*)")
_HELP = (b"*", b"?", b"SAR<n>-<r>", b"SAO<n>-<v>", b"PAO<n>-<s>-<v>...", b"PAS<n>-<s>-<t>", b"SDO<g>-<m>", b"")


@dataclass
class _Stepper:
    """Where one output is in its table of states."""

    length: int = 0
    index: int = 0
    armed: bool = False

    def step(self) -> int:
        """The state to apply now; wraps at the loaded length, and stays at 0 where nothing was loaded."""
        state = self.index
        self.index = self.index + 1 if self.index + 1 < self.length else 0
        return state


class TriggerScopeFirmware:
    """Controller and head. Volts are per degree of mechanical angle; `settle_scale`: real settling over the model's."""

    def __init__(
        self,
        bench: SimulatedBench,
        *,
        x_dac: int = 1,
        y_dac: int = 2,
        x_volts_per_degree: float = 0.5,
        y_volts_per_degree: float = 0.5,
        settle: SettleModel | None = None,
        settle_scale: float = 0.9,
        shutter_pin: int | None = None,
        sd_card: bool = True,
        board: bytes = _BANNER,
    ) -> None:
        self._bench = bench
        self._x_dac, self._y_dac = x_dac, y_dac
        self._volts_per_degree = {x_dac: x_volts_per_degree, y_dac: y_volts_per_degree}
        self._settle = settle or SettleModel()
        self._settle_scale = settle_scale
        self._shutter_pin = shutter_pin
        self._sd_card = sd_card
        self._board = board
        self._act: dict[bytes, tuple[int, Callable[[bytes, list[int]], bytes]]] = {  # name -> (arguments, what it does)
            b"SAR": (2, self._set_range),
            b"SAO": (2, self._set_code),
            b"PAN": (1, self._capacity),
            b"PAC": (1, self._clear),
            b"PAO": (3, self._load),
            b"PAS": (3, self._step_by_trigger),
            b"BAO": (3, self._blank),
            b"BAD": (2, self._echo),
            b"BAL": (2, self._echo),
            b"SDO": (2, self._set_mask),
            b"PDN": (1, self._capacity),
            b"PDC": (1, self._clear_masks),
            b"PDO": (3, self._load_masks),
            b"PDS": (3, self._masks_by_trigger),
            b"BDO": (3, self._echo),
            b"SSL": (1, self._echo),
        }
        self._power_up()
        bench.wire("pixel_clock", self._on_edge)

    @classmethod
    def matching(cls, bench: SimulatedBench, settings: TriggerScopeSettings) -> "TriggerScopeFirmware":
        """The controller and head that these settings describe."""
        return cls(
            bench,
            x_dac=settings.x.dac,
            y_dac=settings.y.dac,
            x_volts_per_degree=settings.x.volts_per_degree,
            y_volts_per_degree=settings.y.volts_per_degree,
            settle=settings.settle,
            shutter_pin=settings.shutter_pin,
        )

    def opened(self) -> bytes:
        if self._bench.faults.strikes("A3", self._bench.clock.now()):
            self._sd_card = False
        return self._board + b"\r\n" if self._sd_card else b""

    def reboot(self) -> bytes:
        self._power_up()
        self._move(self._bench.clock.now())
        if self._shutter_pin is not None:  # its outputs are low again
            self._bench.set_shutter(False)
        return b"done.\r\n" + self.opened()

    def receive(self, data: bytes, when_s: float) -> bytes:
        """One string collects whatever arrives; a newline anywhere in it makes it one command, the rest is lost."""
        self._text += data
        if b"\n" not in self._text or self._crashed:
            return b""
        text = bytes(self._text)
        self._text.clear()
        now_s = self._bench.clock.now()
        if fault := self._bench.faults.strikes("A2", now_s):
            if fault.parameters.get("kind") == "unknown":
                return b"ERROR_UNKNOWN_COMMAND\r\n"
            return b"!ERROR_%s: refused\r\n" % text[:3]
        intruder = b""
        if fault := self._bench.faults.strikes("A7", now_s):  # somebody else's command, its reply comes our way too
            intruder = self._set_range(b"", [self._x_dac, int(fault.parameters.get("range", 3))]) + b"\r\n"
        self._when_s = when_s
        return intruder + self._answer(text) + b"\r\n"

    def _power_up(self) -> None:
        self._text = bytearray()
        self._crashed = False
        self._when_s = 0.0
        self._range = dict.fromkeys(range(1, _DACS + 1), 1)
        self._code = dict.fromkeys(range(1, _DACS + 1), 0)
        self._states = [0] * (_DACS * _STATES)  # [DAC][state], one block of memory
        self._masks = [[0] * _STATES, [0] * _STATES]
        self._mask = [0, 0]
        self._dac_stepper = {dac: _Stepper() for dac in range(1, _DACS + 1)}
        self._mask_stepper = [_Stepper(), _Stepper()]

    def _answer(self, text: bytes) -> bytes:
        if text == b"*\n":
            return self._board
        if text == b"?\n":
            return b"\r\n".join(_HELP)
        name = text[:3]
        if name not in self._act:
            return b"ERROR_UNKNOWN_COMMAND"
        arguments, act = self._act[name]
        match = _COMMAND.match(text)
        numbers = [int(number) for number in match[1].split(b"-")] if match else []
        outputs = range(1, _DACS + 1) if name[1:2] == b"A" else range(2)
        if match is None or len(numbers) < arguments or numbers[0] not in outputs:
            return b"!ERROR_%s: bad argument" % name
        return act(match[0], numbers)

    def _echo(self, text: bytes, numbers: list[int]) -> bytes:
        return b"!" + text

    def _set_range(self, text: bytes, numbers: list[int]) -> bytes:
        dac, number = numbers[:2]
        if number not in _SPAN_V:
            return b"!ERROR_SAR: no such range"
        self._range[dac] = number
        self._output(dac, 32767 if number >= 3 else 0, self._bench.clock.now())
        return b"!SAR%d-%d" % (dac, number)

    def _set_code(self, text: bytes, numbers: list[int]) -> bytes:
        dac, code = numbers[:2]
        if code > 65535:
            return b"!ERROR_SAO: out of range"
        self._output(dac, code, self._when_s)
        return b"!" + text

    def _capacity(self, text: bytes, numbers: list[int]) -> bytes:
        return b"!%s-%d" % (text, _STATES)

    def _clear(self, text: bytes, numbers: list[int]) -> bytes:
        dac = numbers[0]
        self._states[(dac - 1) * _STATES : dac * _STATES] = [0] * _STATES  # the output itself stays where it is
        self._dac_stepper[dac] = _Stepper()
        return b"!" + text

    def _load(self, text: bytes, numbers: list[int]) -> bytes:
        dac, start, *codes = numbers
        if any(code > 65535 for code in codes):
            return b"!ERROR_PAO: out of range"
        if self._bench.faults.strikes("A4", self._bench.clock.now()):
            codes = codes[:-1]
        first = (dac - 1) * _STATES + start
        if first + len(codes) > len(self._states):  # past the last table lies other memory
            self._crashed = True
            return b""
        self._states[first : first + len(codes)] = codes  # unchecked: may run into the next DAC's table
        stepper = self._dac_stepper[dac]
        stepper.length = max(stepper.length, start + len(codes))
        reply = b"!PAO%d-%d-%d-%d" % (dac, start, len(codes), stepper.length)
        self._crashed = len(reply) >= _REPLY_BUFFER
        return reply

    def _step_by_trigger(self, text: bytes, numbers: list[int]) -> bytes:
        dac, on, rising = numbers[:3]
        stepper = self._dac_stepper[dac]
        stepper.armed, stepper.index = bool(on), 0
        if on and not rising:
            self._output(dac, self._states[(dac - 1) * _STATES + stepper.step()], self._when_s)
        return b"!" + text

    def _blank(self, text: bytes, numbers: list[int]) -> bytes:
        if numbers[1]:
            self._output(numbers[0], 0, self._when_s)
        return b"!" + text

    def _set_mask(self, text: bytes, numbers: list[int]) -> bytes:
        group, mask = numbers[:2]
        if mask > 255:
            return b"!ERROR_SDO: out of range"
        self._pins(group, mask, self._when_s)
        return b"!" + text

    def _load_masks(self, text: bytes, numbers: list[int]) -> bytes:
        group, start, *masks = numbers
        if any(mask > 255 for mask in masks) or start + len(masks) > _STATES:
            return b"!ERROR_PDO: out of range"
        self._masks[group][start : start + len(masks)] = masks
        stepper = self._mask_stepper[group]
        stepper.length = max(stepper.length, start + len(masks))
        return b"!PDO%d-%d-%d-%d" % (group, start, len(masks), stepper.length)

    def _clear_masks(self, text: bytes, numbers: list[int]) -> bytes:
        group = numbers[0]
        self._masks[group] = [0] * _STATES
        self._mask_stepper[group] = _Stepper()
        return b"!" + text

    def _masks_by_trigger(self, text: bytes, numbers: list[int]) -> bytes:
        group, on, rising = numbers[:3]
        stepper = self._mask_stepper[group]
        stepper.armed, stepper.index = bool(on), 0
        if on and not rising:
            self._pins(group, self._masks[group][stepper.step()], self._when_s)
        return b"!" + text

    def _on_edge(self, when_s: float) -> None:
        fault = self._bench.faults.strikes("A6", when_s)
        kind = str(fault.parameters.get("kind", "missed")) if fault else ""
        for _ in range({"missed": 0, "extra": 2}.get(kind, 1)):
            for dac, stepper in self._dac_stepper.items():
                if stepper.armed:
                    self._code[dac] = self._states[(dac - 1) * _STATES + stepper.step()]
            self._move(when_s)
            for group, stepper in enumerate(self._mask_stepper):
                if stepper.armed:
                    self._pins(group, self._masks[group][stepper.step()], when_s)

    def _output(self, dac: int, code: int, when_s: float) -> None:
        self._code[dac] = code
        self._move(when_s)

    def _pins(self, group: int, mask: int, when_s: float) -> None:
        rising = mask & ~self._mask[group]
        self._mask[group] = mask
        if self._shutter_pin is not None and group == (self._shutter_pin - 1) // 8:
            self._bench.set_shutter(bool(mask >> (self._shutter_pin - 1) % 8 & 1))
        if group == 0:
            for bit in (1, 2, 4):
                if rising & bit:
                    self._bench.edge(f"marker_{bit}", when_s)

    def _move(self, when_s: float) -> None:
        """The head follows the voltages of its two DACs. Without SD card the DACs were never initialised."""
        if not self._sd_card:
            return
        target = MirrorAngles(self._deflection(self._x_dac), self._deflection(self._y_dac))
        settle_s = self._settle_scale * self._settle.settle_s(self._bench.beam_at(when_s), target)
        self._bench.steer(target, when_s, settle_s)

    def _deflection(self, dac: int) -> float:
        low_v, high_v = _SPAN_V[self._range[dac]]
        volts = low_v + (high_v - low_v) * self._code[dac] / 65536
        return 2.0 * math.radians(volts / self._volts_per_degree[dac])
