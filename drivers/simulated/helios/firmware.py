"""The firmware of a Helios laser DAC, as its published source has it (main.c): frames, stops, what it skips in silence.

A frame whose size fields disagree, or that comes within 100 ms of a stop, is skipped and nobody is told. A stop centres
the mirrors 100 ms later and leaves the shutter pin. Without a host it stops.
"""

import math

from nlos.drivers.galvo.helios.settings import HeliosSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.servo import GalvoHead
from nlos.drivers.simulated.usb.descriptors import UsbDescription

_POINT_BYTES, _TAIL_BYTES, _MOST_POINTS = 7, 5, 0xFFF
_STOPPED_S = 0.1
_CENTRE = (0x800, 0x800)
_FIRMWARE_VERSION = 6
_NAME = b"Helios 1050\0"


class HeliosFirmware:
    """One DAC with an ILDA head behind it. `erased`: its bootloader was entered, which needs a screwdriver to undo."""

    def __init__(self, bench: SimulatedBench, settings: HeliosSettings) -> None:
        self.usb = UsbDescription(0x1209, 0xE500, "Bitlasers", "Helios Laser DAC", "", 64)
        self.shutter_pin = self.erased = False
        self.commands: list[int] = []
        self._bench = bench
        self._rad_per_code = math.radians(settings.optical_deg_at_full_scale) / 0x7FF
        self._head = GalvoHead(bench.servo)
        self._connected = False
        self._frame: list[tuple[int, int]] = []
        self._waiting: tuple[list[tuple[int, int]], float, bool] | None = None
        self._position, self._period_s, self._once = 0, 1e-3, False
        self._next_s = self._centre_s = math.inf
        self._stopped_until_s = -math.inf

    def connected(self, is_connected: bool, now_s: float) -> None:
        if self._connected and not is_connected:
            self._stop(now_s)
        self._connected = is_connected

    def command(self, data: bytes, now_s: float) -> bytes | None:
        self._advance(now_s)
        code, value = data[0], data[1] if len(data) > 1 else 0
        self.commands.append(code)
        if code == 1:
            self._stop(now_s)
        elif code == 2:
            self.shutter_pin = value != 0
        elif code == 3:
            return bytes([0x83, self._waiting is None])
        elif code == 4:
            return bytes([0x84]) + _FIRMWARE_VERSION.to_bytes(4, "little")
        elif code == 5:
            return (b"\x85" + _NAME).ljust(32, b"\0")
        elif code == 0xDE:
            self.erased = True
        return None

    def bulk(self, data: bytes, now_s: float) -> None:
        self._advance(now_s)
        length = len(data) - _TAIL_BYTES
        said = int.from_bytes(data[-3:-1], "little") * _POINT_BYTES
        if length != said or length > _MOST_POINTS * _POINT_BYTES or now_s < self._stopped_until_s:
            return
        points = []
        for at in range(0, length, _POINT_BYTES):
            packed = int.from_bytes(data[at : at + 3], "big")
            points.append((packed >> 12, packed & 0xFFF))
        rate = min(max(int.from_bytes(data[-5:-3], "little"), 7), 0xFFFF)
        frame = points, 1 / rate, bool(data[-1] & 2)
        if self._frame and not data[-1] & 1:
            self._waiting = frame
        else:
            self._play(frame, now_s)

    def _play(self, frame: tuple[list[tuple[int, int]], float, bool], now_s: float) -> None:
        self._frame, self._period_s, self._once = frame
        self._position, self._waiting, self._next_s = 0, None, now_s + self._period_s
        self._bench.follow_path(self._at, self._angles(self._frame[0]), now_s)

    def _stop(self, now_s: float) -> None:
        self._frame, self._waiting, self._next_s = [], None, math.inf
        self._stopped_until_s = self._centre_s = now_s + _STOPPED_S
        self._bench.follow_path(self._at, self._angles(_CENTRE), now_s)

    def _at(self, when_s: float) -> MirrorAngles:
        self._advance(when_s)
        return self._head.at(when_s)

    def _advance(self, now_s: float) -> None:
        if self._centre_s <= now_s:
            self._head.steer(self._angles(_CENTRE), self._centre_s)
            self._centre_s = math.inf
        while self._next_s <= now_s:
            self._head.steer(self._angles(self._frame[self._position]), self._next_s)
            self._position += 1
            self._next_s += self._period_s
            if self._position < len(self._frame):
                continue
            if self._waiting is not None:
                self._play(self._waiting, self._next_s - self._period_s)
            elif self._once:
                self._frame, self._next_s = [], math.inf
            else:
                self._position = 0
                if len(set(self._frame)) == 1:  # it stays where it is
                    self._next_s = math.inf

    def _angles(self, codes: tuple[int, int]) -> MirrorAngles:
        x, y = ((code - 0x800) * self._rad_per_code for code in codes)
        return MirrorAngles(x, y)
