"""What hangs on a Helios laser DAC: a galvo head on x and y, cables on the colour outputs; alike for any firmware."""

import math
from collections.abc import Callable

from nlos.drivers.galvo.helios.settings import HeliosSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.servo import GalvoHead

_CENTRE = 0x800
_HIGH_V = 1.4
"""From here on an input sees a colour output as high."""
_FULL_V = 5.0
_MARKERS = ("marker_1", "marker_2", "marker_4")  # R, G, B; I goes to the trigger input

OutputLog = Callable[[float, int, int, bytes], None]
"""(bench time, x, y, colours): every change of an output."""


class Outputs:
    """A colour output is a mark where the bench file says so."""

    def __init__(self, bench: SimulatedBench, settings: HeliosSettings) -> None:
        self.log: OutputLog | None = None
        self._bench = bench
        self._head = GalvoHead(bench.servo)
        self._rad_per_code = math.radians(settings.optical_deg_at_full_scale) / 0x7FF
        self._wired = settings.markers == "colours"
        self._codes, self._colours = (_CENTRE, _CENTRE), bytes(4)

    def put(self, x: int, y: int, colours: bytes, when_s: float) -> None:
        """A sample. Whoever looks back at a mark is told before the mirror leaves, whoever looks ahead after."""
        before, self._colours = self._colours, colours
        rises = [now >= self._code(_HIGH_V) > then for then, now in zip(before, colours, strict=True)]
        moves = (x, y) != self._codes
        if (moves or colours != before) and self.log:
            self.log(when_s, x, y, colours)
        for line, rose in zip(_MARKERS, rises, strict=False):
            if rose and self._wired and self._bench.faults.strikes("H2", when_s, line) is None:
                self._bench.edge(line, when_s)
        if moves:
            self._steer((x, y), when_s)
        if rises[3] and self._wired and self._bench.faults.strikes("H2", when_s, "trigger") is None:
            self._bench.edge("counter_trigger", when_s)

    def blank(self, when_s: float) -> None:
        """All colours dark; the mirror stays. It ends the last point's step, which is all that light has to know."""
        if any(self._colours) and self.log:
            self.log(when_s, *self._codes, bytes(4))
        self._colours = bytes(4)
        if self._wired:
            self._bench.edge("last_step_over", when_s)

    def centre(self, when_s: float) -> None:
        """Both axes at once, the colours as they are."""
        if self._codes != (_CENTRE, _CENTRE):
            if self.log:
                self.log(when_s, _CENTRE, _CENTRE, self._colours)
            self._steer((_CENTRE, _CENTRE), when_s)

    def _steer(self, codes: tuple[int, int], when_s: float) -> None:
        self._codes = codes
        x, y = ((code - _CENTRE) * self._rad_per_code for code in codes)
        target = MirrorAngles(x, y)
        self._head.steer(target, when_s)
        self._bench.follow_path(self._head.at, target, when_s)

    @staticmethod
    def _code(volts: float) -> int:
        return round(volts / _FULL_V * 255)
