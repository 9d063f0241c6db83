"""The firmware of a Helios laser DAC, as its published source has it (main.c): frames, stops, what it skips in silence.

A frame whose size fields disagree, or that comes within 100 ms of a stop, is skipped and nobody is told. A stop centres
the mirrors 100 ms later and leaves the shutter pin. Without a host it stops. A sample lasts a whole number of processor
cycles, one more than its rate asks for.
"""

import math

from nlos.drivers.galvo.helios.settings import HeliosSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.helios.outputs import Outputs
from nlos.drivers.simulated.usb.descriptors import UsbDescription

_POINT_BYTES, _TAIL_BYTES, _MOST_POINTS = 7, 5, 0x1000
_STOPPED_S = 3277 / 32768  # a tenth of a second by its slow clock
_CYCLES_A_SECOND = 112_000_000
_FIRMWARE_VERSION = 6
_NAME = b"Helios 1050\0"

Sample = tuple[int, int, bytes]
"""x, y, colours."""


class HeliosFirmware:
    """One DAC. `erased`: its bootloader was entered, which needs a screwdriver to undo."""

    def __init__(self, bench: SimulatedBench, settings: HeliosSettings, outputs: Outputs | None = None) -> None:
        self.usb = UsbDescription(0x1209, 0xE500, "Bitlasers", "Helios Laser DAC", "", 64)
        self.outputs = outputs or Outputs(bench, settings)
        self.shutter_pin = self.erased = False
        self.commands: list[int] = []
        self._bench = bench
        self._connected = False
        self._listens = True  # for a frame: after one that waits or was skipped, not before a status was asked for
        self._frame: list[Sample] = []
        self._waiting: tuple[list[Sample], float, bool] | None = None
        self._position, self._sample_s, self._once = 0, 1e-3, False
        self._next_s = self._centre_s = math.inf
        self._held_s = 0.0
        self._stopped_until_s = -math.inf
        bench.ticks(self.let_pass)

    def connected(self, is_connected: bool, now_s: float) -> None:
        """The host selects, or leaves, the interface."""
        self.let_pass(now_s)
        if self._connected and not is_connected:
            self._stop(now_s)
        elif is_connected:
            self._stop_playing(now_s)
        self._connected = is_connected

    def command(self, data: bytes, now_s: float) -> bytes | None:
        """An interrupt transfer; its answer, if any."""
        self.let_pass(now_s)
        if not self._connected:
            return None
        code, value = data[0], data[1] if len(data) > 1 else 0
        self.commands.append(code)
        if code == 1:
            self._stop(now_s)
        elif code == 2:
            self.shutter_pin = value != 0
        elif code == 3:
            self._listens |= self._waiting is None
            return bytes([0x83, self._waiting is None])
        elif code == 4:
            return bytes([0x84]) + _FIRMWARE_VERSION.to_bytes(4, "little")
        elif code == 5:
            return (b"\x85" + _NAME).ljust(32, b"\0")
        elif code == 0xDE:
            self.erased = True
        return None

    def bulk(self, data: bytes, now_s: float) -> bool:
        """A frame, or what was taken for one; false where it does not listen for any."""
        self.let_pass(now_s)
        if not self._listens:
            return False
        self._listens = False
        if self._connected:
            self._take(data, now_s)
        return True

    def _take(self, data: bytes, now_s: float) -> None:
        length = len(data) - _TAIL_BYTES
        said = int.from_bytes(data[-3:-1], "little") * _POINT_BYTES & 0xFFFF
        if length != said or length > _MOST_POINTS * _POINT_BYTES or now_s < self._stopped_until_s:
            return
        if self._bench.faults.strikes("H1", now_s, "sequence" if data[-1] & 2 else "point") is not None:
            return
        samples = []
        for at in range(0, length, _POINT_BYTES):
            packed = int.from_bytes(data[at : at + 3], "big")
            samples.append((packed >> 12, packed & 0xFFF, data[at + 3 : at + 7]))
        rate = min(max(int.from_bytes(data[-5:-3], "little"), 7), 0xFFFF)
        frame = samples, (_CYCLES_A_SECOND // rate + 1) / _CYCLES_A_SECOND, bool(data[-1] & 2)
        if self._frame and not data[-1] & 1:
            self._waiting = frame
            if self._next_s == math.inf:  # it stays at one point, in time with its clock
                ticks = math.ceil((now_s - self._held_s) / self._sample_s)
                self._next_s = self._held_s + ticks * self._sample_s
            return
        self._frame, self._sample_s, self._once = frame
        self._position, self._waiting, self._next_s = 0, None, now_s + self._sample_s
        self._listens = True

    def let_pass(self, now_s: float) -> None:
        """Everything that its clock brings until then."""
        if self._centre_s <= now_s:
            centre_s, self._centre_s = self._centre_s, math.inf
            self._stop_playing(centre_s)
            self.outputs.centre(centre_s)
        while self._next_s <= now_s:
            when_s, self._next_s = self._next_s, self._next_s + self._sample_s
            self._tick(when_s)

    def _tick(self, when_s: float) -> None:
        if self._position >= len(self._frame):
            if self._waiting is not None:
                (self._frame, self._sample_s, self._once), self._waiting = self._waiting, None
                self._next_s = when_s + self._sample_s
                self._listens = True
            elif self._once:
                self._stop_playing(when_s)
                return
            self._position = 0
            if self._waiting is None and len(set(self._frame)) == 1 and not self._once:
                self._next_s, self._held_s = math.inf, when_s  # each sample is the same
        x, y, colours = self._frame[self._position]
        self._position += 1
        self.outputs.put(x, y, colours, when_s)

    def _stop_playing(self, now_s: float) -> None:
        self._frame, self._waiting, self._next_s = [], None, math.inf
        self._listens = True
        self.outputs.blank(now_s)

    def _stop(self, now_s: float) -> None:
        self._stop_playing(now_s)
        self._stopped_until_s = self._centre_s = now_s + _STOPPED_S
