"""A TriggerScope-MM's firmware (V4B v.620-MM, V4 v.613-MM or V4B v.622-MM by its name), traps included.

Written from the behaviour of the vendor's published sketches, independently of the driver, and compared with the
compiled ones by `make peers`: commands arriving together are parsed as one, malformed ones are often carried out, a
range zeroes every output, tables are written past their end, and nothing is forgotten as a port is closed.
"""

from collections.abc import Callable

from nlos.drivers.galvo.triggerscope.settings import TriggerScopeSettings
from nlos.drivers.simulated.beam import Misalignment
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import one_of
from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS
from nlos.drivers.simulated.triggerscope.lines import Line, integer
from nlos.drivers.simulated.triggerscope.outputs import STATES, Output
from nlos.drivers.simulated.triggerscope.trigger_input import TriggerInput
from nlos.drivers.simulated.triggerscope.wiring import DACS, Wiring

V4B = b"ARC TRIGGERSCOPE 16 R4 Board 4B v.620-MM"
V4 = b"ARC TRIGGERSCOPE 16 R3C Board 4 v.613-MM"
"""Its firmware switches a light off, before each command, by a pin that is TTL output 6 on this board."""
WAVES = b"ARC TRIGGERSCOPE 16 R4 Board 4B v.622-MM"
_REPLY_BUFFER = 20  # bytes, the NUL included, for the reply to PAO and PDO
_CLEAR_LINE = 25  # bytes of a CLEAR_DAC that fit its buffer
_HELP = (b"*", b"?", b"SAR<n>-<r>", b"SAO<n>-<v>", b"PAO<n>-<s>-<v>...", b"PAS<n>-<s>-<t>", b"SDO<g>-<m>", b"")
_UNKNOWN = b"ERROR_UNKNOWN_COMMAND"


class TriggerScopeFirmware:
    """The controller; `wiring` is what hangs on it. `STAT?` and `TEST?`, for a person's terminal, are missing."""

    def __init__(
        self, bench: SimulatedBench, wiring: Wiring | None = None, *, sd_card: bool = True, board: bytes = V4B
    ) -> None:
        self.wiring = wiring or Wiring(bench)
        self._bench = bench
        self._board = board
        self._sd_card = sd_card
        self._act: dict[bytes, Callable[[Line], bytes | None]] = {
            b"SAR": self._set_range,
            b"SAO": self._set_code,
            b"PAN": lambda line: self._capacity(line, range(1, DACS + 1)),
            b"PAC": self._clear,
            b"PAO": self._load,
            b"PAS": self._step_by_trigger,
            b"BAO": self._blank,
            b"BAD": self._blanking_time,
            b"BAL": self._blanking_time,
            b"SDO": self._set_mask,
            b"PDN": lambda line: self._capacity(line, range(2)),
            b"PDC": self._clear_masks,
            b"PDO": self._load_masks,
            b"PDS": self._step_masks_by_trigger,
            b"BDO": self._blank_masks,
            b"SSL": self._signal_leds,
        }
        if board == WAVES:
            self._act[b"WAV"] = self._set_wave
        self._power_up()
        self._trigger = TriggerInput(bench, self._follow)

    @classmethod
    def matching(
        cls, bench: SimulatedBench, settings: TriggerScopeSettings, out_of_place: Misalignment | None = None
    ) -> "TriggerScopeFirmware":
        """The controller and head that these settings describe."""
        return cls(bench, Wiring.matching(bench, settings, out_of_place))

    def opened(self) -> bytes:
        """The start-up text waits for the first host after power-up; later ones find everything as it was left."""
        faults, now_s = self._bench.faults, self._bench.clock.now()
        if faults.strikes("A3", now_s):
            self._banner, self.wiring.live = b"", False
        if fault := faults.strikes("A8", now_s):
            for command in LEFT_OVERS[one_of(fault.parameters, "state", "opens_on_edges", LEFT_OVERS)]:
                self._answer(Line(command + b"\n"))
        if fault := faults.strikes("A9", now_s):
            self._text += HALF_LINES[one_of(fault.parameters, "line", "table", HALF_LINES)]
        banner, self._banner = self._banner, b""
        return banner

    def reboot(self) -> bytes:
        self._power_up()
        return self.opened()

    def receive(self, data: bytes, when_s: float) -> bytes:
        """One string collects whatever arrives; a newline anywhere in it makes it one command, the rest is lost."""
        self._trigger.fall_if_due(when_s)
        self._text += data
        if b"\n" not in self._text or self._crashed:
            return b""
        text = bytes(self._text)
        self._text.clear()
        if self._board == V4:
            self.wiring.set_pin(6, False, when_s)
        now_s = self._bench.clock.now()
        if fault := self._bench.faults.strikes("A2", now_s):
            if fault.parameters.get("kind") == "unknown":
                return _UNKNOWN + b"\r\n"
            return b"!ERROR_%s: refused\r\n" % text[:3]
        intruder = b""
        self._when_s = now_s
        if fault := self._bench.faults.strikes("A7", now_s):  # somebody else's command, its reply comes our way too
            line = Line(b"SAR%d-%d\n" % (self.wiring.x_dac, int(fault.parameters.get("range", 3))))
            intruder = self._answer(line) + b"\r\n"
        self._when_s = when_s
        return intruder + self._answer(Line(text)) + b"\r\n"

    def _power_up(self) -> None:
        self._text = bytearray()
        self._crashed = False
        self._when_s = self._bench.clock.now()
        self._banner = b"done.\r\n" + self._board + b"\r\n" if self._sd_card else b""
        self.wiring.live = self._sd_card  # without its card it never gets to the DACs
        self._dacs = {dac: Output(self._putter(dac), 65535) for dac in range(1, DACS + 1)}
        self._groups = [Output(self._pin_putter(group), 255) for group in range(2)]
        self.wiring.power_up()

    def _putter(self, dac: int) -> Callable[[int], None]:
        return lambda code: self.wiring.set_code(dac, code, self._when_s)

    def _pin_putter(self, group: int) -> Callable[[int], None]:
        return lambda mask: self.wiring.set_pins(group, mask, self._when_s)

    def _follow(self, level: bool, when_s: float) -> None:
        self._when_s = when_s
        for output in (*self._dacs.values(), *self._groups):
            output.follow(level)

    # Commands: each returns its reply, or None where the firmware reports an error

    def _answer(self, line: Line) -> bytes:
        if line.string == b"*\n":
            return self._board
        if line.string == b"?\n":
            return b"\r\n".join(_HELP)
        if line.string == b"CLEAR_ALL\n":  # keeps lengths and stepping: what steps on then steps through code 0
            for output in self._dacs.values():
                output.table = [0] * STATES
            for group in self._groups:
                group.table, group.length = [0] * STATES, 0
            return b"!CLEAR_ALL"
        if line.part(0, 9) == b"CLEAR_DAC":
            return self._clear_first(line)
        if line.name not in self._act:
            return _UNKNOWN
        reply = self._act[line.name](line)
        named = b"BAD" if line.name == b"BAL" else line.name  # as the firmware itself confuses them
        return b"!ERROR_%s: bad argument" % named if reply is None else b"!" + line.name + reply

    def _clear_first(self, line: Line) -> bytes:
        """Clears 50 states of a DAC; neither its number nor the length of the line is checked."""
        self._crashed |= len(line.text) > _CLEAR_LINE
        column = (integer(line.part(10)) - 1) & 255
        for state in range(50):
            row, dac = divmod(state * DACS + column, DACS)
            self._dacs[dac + 1].table[row] = 0
        return b"!CLEAR_DAC,%d" % (column + 1)

    def _set_range(self, line: Line) -> bytes | None:
        dac = line.byte(3)
        number = line.byte(6 if dac > 9 else 5)
        if not (1 <= number <= 5 and 1 <= dac <= DACS):
            return None
        self.wiring.set_range(dac, number, self._when_s)
        self._dacs[dac].value = 32767 if number > 2 else 0
        self._dacs[dac].put_out(self._dacs[dac].value)  # whatever blanking says
        return b"%d-%d" % (dac, number)

    def _set_code(self, line: Line) -> bytes | None:
        if (output := line.output()) is None:
            return None
        dac, start = output
        code = line.number(start)
        if not 0 <= code <= 65535:
            return None
        self._dacs[dac].value = code
        self._dacs[dac].show(self._trigger.level)
        return b"%d-%d" % (dac, code)

    def _set_wave(self, line: Line) -> bytes | None:
        dac, amplitude, offset, updates, delay = (integer(word) for word in line.part(3).split(b"-"))
        self._dacs[dac].wave = (offset, amplitude) if amplitude else None
        return b"%d-%d-%d-%d-%d" % (dac, amplitude, offset, updates, delay)

    def _capacity(self, line: Line, outputs: range) -> bytes | None:
        number = line.byte(3)
        return b"%d-%d" % (number, STATES) if number in outputs else None

    def _clear(self, line: Line) -> bytes | None:
        dac = line.number(3)
        if len(line.text) not in (5, 6) or dac not in self._dacs:
            return None
        self._dacs[dac].clear()  # the output itself stays where it is
        return b"%d" % dac

    def _load(self, line: Line) -> bytes | None:
        if (output := line.output()) is None:
            return None
        dac, start = output
        shorter = bool(self._bench.faults.strikes("A4", self._bench.clock.now()))
        return self._fill(self._dacs[dac], dac, line.states(start), shorter)

    def _fill(self, output: Output, number: int, states: tuple[int, list[int]] | None, shorter: bool) -> bytes | None:
        """Nothing stops it at the table's end: it confirms, and writes on into whatever memory comes next."""
        if states is None:
            return None
        first, values = states
        count = 0
        for value in values[: len(values) - shorter]:
            if not 0 <= value <= output.most:
                return None
            if first + count < STATES:
                output.table[first + count] = value
            else:
                self._crashed = True
            count += 1
            output.length = max(output.length, first + count)
        reply = b"%d-%d-%d-%d" % (number, first, count, output.length)
        self._crashed |= len(reply) + 4 >= _REPLY_BUFFER
        return reply

    def _step_by_trigger(self, line: Line) -> bytes | None:
        output = line.output()
        if len(line.text) not in (9, 10) or output is None:
            return None
        dac, start = output
        return self._step(self._dacs[dac], dac, line.number(start, start + 1), line.number(start + 2))

    def _step(self, output: Output, number: int, on: int, rising: int) -> bytes | None:
        if on not in (0, 1) or rising not in (0, 1):
            return None
        (output.begin_stepping if on else output.end_stepping)(bool(rising))
        return b"%d-%d-%d" % (number, on, rising)

    def _blank(self, line: Line) -> bytes | None:
        if (output := line.output()) is None:
            return None
        dac, start = output
        if not line.separated(start + 1):
            return None
        return self._blank_output(self._dacs[dac], dac, line.number(start, start + 1), line.number(start + 2))

    def _blank_output(self, output: Output, number: int, on: int, inverse: int) -> bytes | None:
        if on not in (0, 1) or inverse not in (0, 1):
            return None
        output.blanking, output.active_at = bool(on), not inverse
        output.show(self._trigger.level)
        return b"%d-%d-%d" % (number, on, inverse)

    def _blanking_time(self, line: Line) -> bytes | None:
        if (output := line.output()) is None:
            return None
        dac, start = output
        return b"%d-%d" % (dac, line.number(start) & 0xFFFFFFFF)

    def _set_mask(self, line: Line) -> bytes | None:
        group, mask = line.byte(3), line.number(5)
        if group > 1 or not 0 <= mask <= 255:
            return None
        self._groups[group].value = mask
        self._groups[group].show(self._trigger.level)
        return b"%d-%d" % (group, mask)

    def _clear_masks(self, line: Line) -> bytes | None:
        group = line.number(3, 4)
        if len(line.text) != 5 or group not in (0, 1):
            return None
        self._groups[group].clear()
        return b"%d" % group

    def _load_masks(self, line: Line) -> bytes | None:
        group = line.number(3, 4)
        if group not in (0, 1) or not line.separated(4):
            return None
        return self._fill(self._groups[group], group, line.states(5), False)

    def _step_masks_by_trigger(self, line: Line) -> bytes | None:
        group = line.number(3, 4)
        if len(line.text) != 9 or group not in (0, 1):
            return None
        return self._step(self._groups[group], group, line.number(5, 6), line.number(7, 8))

    def _blank_masks(self, line: Line) -> bytes | None:
        group = line.number(3, 4)
        if len(line.text) != 9 or group not in (0, 1):
            return None
        return self._blank_output(self._groups[group], group, line.number(5, 6), line.number(7, 8))

    def _signal_leds(self, line: Line) -> bytes | None:
        on = line.byte(3)
        return b"%d" % on if on in (0, 1) else None
