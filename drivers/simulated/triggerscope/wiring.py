"""What hangs on a TriggerScope's outputs: DAC chip, galvo head, marker lines, shutter. The same for any firmware."""

import math
from collections.abc import Callable

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.settings import AxisSettings, TriggerScopeSettings
from nlos.drivers.simulated.beam import Misalignment
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.servo import GalvoHead, ServoSettings

DACS = 16
X, Y = AxisSettings(dac=1), AxisSettings(dac=2)
SPAN_V = {1: (0.0, 5.0), 2: (0.0, 10.0), 3: (-5.0, 5.0), 4: (-10.0, 10.0), 5: (-2.5, 2.5)}

_MARKERS = {1: "marker_1", 2: "marker_2", 3: "marker_4"}  # TTL output -> line, named by its bit

OutputLog = Callable[[float, str, int, int], None]
"""(bench time, "range", "code" or "pin", number from 1, value): every change of an output."""


class Wiring:
    """Two DACs drive a galvo head, TTL outputs 1 to 3 mark steps, one may drive the shutter. Without `servo` the beam
    is there at once."""

    def __init__(
        self,
        bench: SimulatedBench,
        *,
        x: AxisSettings = X,
        y: AxisSettings = Y,
        servo: ServoSettings | None = None,
        shutter_pin: int | None = None,
    ) -> None:
        self.bench = bench
        self.live = True
        """False: the DAC chip was never initialised and puts out nothing."""
        self.log: OutputLog | None = None
        self.x_dac, self.y_dac = x.dac, y.dac
        self._volts_per_degree = {each.dac: each.volts_per_degree for each in (x, y)}
        self._head = GalvoHead(servo) if servo else None
        self._shutter_pin = shutter_pin
        self._range = dict.fromkeys(range(1, DACS + 1), 1)
        self._code = dict.fromkeys(range(1, DACS + 1), 0)
        self._pins = dict.fromkeys(range(1, DACS + 1), False)

    @classmethod
    def matching(
        cls, bench: SimulatedBench, settings: TriggerScopeSettings, out_of_place: Misalignment | None = None
    ) -> "Wiring":
        """The head, markers and shutter that these settings describe, but for what is out of place."""
        off = out_of_place or Misalignment()
        x, y = (
            AxisSettings(dac=axis.dac, volts_per_degree=other or axis.volts_per_degree)
            for axis, other in ((settings.x, off.x_volts_per_degree), (settings.y, off.y_volts_per_degree))
        )
        return cls(bench, x=x, y=y, servo=bench.servo, shutter_pin=settings.shutter_pin)

    def power_up(self) -> None:
        """Ranges 0 to 5 V, code 0, every pin low."""
        now_s = self.bench.clock.now()
        for number in range(1, DACS + 1):
            self.set_pin(number, False, now_s)
        for dac in range(1, DACS + 1):
            self._range[dac] = 1
            self.set_code(dac, 0, now_s)

    def set_range(self, dac: int, number: int, when_s: float) -> None:
        """A DAC's span and, the chip's way, code 0 on all of them: the other axis of a mirror goes to -10 V."""
        self._range[dac] = number
        self._note(when_s, "range", dac, number)
        for each in range(1, DACS + 1):
            self.set_code(each, 0, when_s)

    def set_code(self, dac: int, code: int, when_s: float) -> None:
        """A DAC's output; the head follows if it hangs on this one."""
        self._code[dac] = code
        self._note(when_s, "code", dac, code)
        if self.live and dac in (self.x_dac, self.y_dac):
            target = MirrorAngles(self._deflection(self.x_dac), self._deflection(self.y_dac))
            if self._head is None:
                self.bench.steer(target, when_s)
            else:
                self._head.steer(target, when_s)
                self.bench.follow_path(self._head.at, target, when_s)

    def set_pin(self, number: int, high: bool, when_s: float) -> None:
        """A TTL output, 1 to 16."""
        if high == self._pins[number]:
            return
        self._pins[number] = high
        self._note(when_s, "pin", number, high)
        if number == self._shutter_pin:
            self.bench.set_shutter(high)
        if high and number in _MARKERS:
            self.bench.edge(_MARKERS[number], when_s)

    def set_pins(self, group: int, mask: int, when_s: float) -> None:
        """Outputs 1 to 8 (group 0) or 9 to 16 (group 1), in their order."""
        for bit in range(8):
            self.set_pin(8 * group + bit + 1, bool(mask >> bit & 1), when_s)

    def _note(self, when_s: float, what: str, number: int, value: int) -> None:
        if self.log:
            self.log(when_s, what, number, value)

    def _deflection(self, dac: int) -> float:
        low_v, high_v = SPAN_V[self._range[dac]]
        volts = low_v + (high_v - low_v) * self._code[dac] / 65536
        return 2.0 * math.radians(volts / self._volts_per_degree[dac])
