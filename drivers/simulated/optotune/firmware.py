"""An Optotune MR-E-2 or MR-E-3 controller with its mirror, in Simple and in Pro mode, as its manuals and SDK have it.

Written independently of the driver: its own framing, its own register file, its own geometry.
"""

import math
import re
from typing import Any

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.optotune.mirror import OptotuneSettings
from nlos.drivers.galvo.settle import SettleModel
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import one_of
from nlos.drivers.simulated.optotune import pro_mode

_UNIT = math.tan(math.radians(50.0))
_POSITION = re.compile(rb"(X|Y|XY)=(-?\d+(?:\.\d+)?)(?:;(-?\d+(?:\.\d+)?))?")
_MODEL = {"auto": b"MR-E-3", "MR-E-2": b"MR-E-2", "MR-E-3": b"MR-E-3"}
_LATCHED = {0: 8, 1: 9, 2: 10, 5: 11, 6: 12, 7: 13}
_DATA = {
    b"GETVERSION": b"1.4.2",
    b"GETSN": b"SIM00001",
    b"GETDEVICESN": b"SIM-MIRROR-1",
    b"DETECTDEVICE": b"MR-15-30",
    b"GETTEMP": b"31.5",
}


class OptotuneFirmware:
    """Controller and mirror; `settle_scale`: real settling over the model's; `gains`: of its input conditioning, as
    another program left them for x and y."""

    def __init__(
        self,
        bench: SimulatedBench,
        *,
        settle: SettleModel | None = None,
        settle_scale: float = 0.9,
        left_in_pro_mode: bool = False,
        model: bytes = b"MR-E-3",
        gains: tuple[float, float] = (1.0, 1.0),
    ) -> None:
        self._bench = bench
        self._settle = settle or OptotuneSettings(model="optotune", port="").settle
        self._settle_scale = settle_scale
        self._model, self._gains = model, gains
        self._power_up()
        self._pro = left_in_pro_mode

    @classmethod
    def matching(cls, bench: SimulatedBench, settings: OptotuneSettings) -> "OptotuneFirmware":
        """The controller and mirror that these settings describe."""
        return cls(bench, settle=settings.settle, model=_MODEL[settings.controller])

    def opened(self) -> bytes:
        if self._fault("B5", "stuck"):
            self._pro = True
        return b""

    def reboot(self) -> bytes:
        self._power_up()
        self._steer()
        return self._model + b" ready\r\n"

    def receive(self, data: bytes, when_s: float) -> bytes:
        """Answers every complete line, or every complete frame, in turn."""
        self._pending += data
        answer = b""
        while True:
            before = len(self._pending)
            answer += self._take_frame() if self._pro else self._take_line()
            if len(self._pending) == before:
                return answer

    def _power_up(self) -> None:
        self._pending = b""
        self._pro = self._demands_crc = False
        self._puzzled = False  # after Pro mode or garbage the first START is refused
        self._x = self._y = self._off = 0.0
        self._stable_at_s = 0.0
        self._latched = 0
        self._stuck = 0
        self._never_stable = False
        self._reads_until_unstable = -1

    def _fault(self, name: str, place: str = "") -> dict[str, Any] | None:
        fault = self._bench.faults.strikes(name, self._bench.clock.now(), place)
        return None if fault is None else fault.parameters

    def _take_line(self) -> bytes:
        line, end, rest = self._pending.partition(b"\r\n")
        if not end:
            return b""
        self._pending = rest
        return self._say(line.upper()) + b"\r\n"

    def _say(self, line: bytes) -> bytes:
        if len(line) > 64:
            self._puzzled = True
            return b"ERROR"
        if line.endswith(b"~START"):  # behind a frame that Simple mode has taken for text (the SDK's own dialogue)
            return b"NO"
        if line == b"START":
            self._puzzled, puzzled = False, self._puzzled
            return b"NO" if puzzled else b"OK"
        if line == b"STATUS":
            return b"%08X" % self._status()
        if line == b"ACKNOWLEDGE":
            self._latched = self._stuck
            return b"OK"
        if line in (b"GOPRO", b"GOPROCRC"):
            self._pro, self._demands_crc = True, line == b"GOPROCRC"
            return b"OK"
        if line == b"RESET":
            self._power_up()
            self._steer()
            return b"OK"
        if line == b"GETID":
            return self._model
        if line in _DATA:
            return _DATA[line]
        match = _POSITION.fullmatch(line)
        if match and (match[1] == b"XY") == (match[3] is not None):
            return self._set(match)
        self._puzzled = True
        return b"ERROR"

    def _set(self, match: re.Match[bytes]) -> bytes:
        if (fault := self._fault("B1")) is not None:
            refused = one_of(fault, "reply", "NO", ("NO", "ERROR", "OL", "OU"))
            if refused in ("NO", "ERROR"):
                return refused.encode()
        if self._fault("B2") is not None:
            self._never_stable = True
        if self._fault("B3") is not None:
            self._reads_until_unstable = 1
        elsewhere = self._fault("B6")
        self._off = 0.0 if elsewhere is None else float(elsewhere.get("off_by", 0.2))
        if (trouble := self._fault("B4")) is not None:
            bit = int(trouble.get("bit", 1))
            self._latched |= 1 << _LATCHED.get(bit, bit)
            if not trouble.get("latched_only"):
                self._stuck |= 1 << bit
        x, y = {
            b"X": (float(match[2]), self._y),
            b"Y": (self._x, float(match[2])),
            b"XY": (float(match[2]), float(match[3] or 0)),
        }[match[1]]
        radius = math.hypot(x, y)
        if fault is not None:  # trims although the position was on the disc
            x, y, radius = x / 2, y / 2, 2.0
        elif radius > 1.0:
            x, y = x / radius, y / radius
        self._x, self._y = x, y
        self._steer()
        if radius > 1.0:
            self._latched |= 1 << 13
            return str(fault["reply"]).encode() if fault is not None else b"OU"
        return b"OK"

    def _steer(self) -> None:
        now_s = self._bench.clock.now()
        x, y = self._x * self._gains[0] * _UNIT, self._y * self._gains[1] * _UNIT
        target = MirrorAngles(math.atan2(x, math.hypot(1.0, y)), math.atan(y))
        settle_s = self._settle_scale * self._settle.settle_s(self._bench.beam, target)
        self._stable_at_s = now_s + settle_s
        self._bench.steer(target, now_s, settle_s)

    def _status(self) -> int:
        flags = self._flags()
        if not flags & 1 << 4 and self._reads_until_unstable >= 0:
            flags |= (self._reads_until_unstable == 0) << 4
            self._reads_until_unstable -= 1
        return flags

    def _flags(self) -> int:
        moving = self._bench.clock.now() < self._stable_at_s or self._never_stable
        return self._latched | self._stuck | moving << 4

    def _take_frame(self) -> bytes:
        frame, self._pending = pro_mode.cut_frame(self._pending)
        request = pro_mode.unpack(frame, self._demands_crc) if frame else None
        if request is None:
            return b""  # what is no frame is not answered
        command, payload = request
        answer = self._carry_out(command, payload)
        if self._fault("B5", "refused") is not None:
            answer = pro_mode.READ_FAILED
        if isinstance(answer, int):
            return pro_mode.refused(command, answer)
        reply = pro_mode.pack(command, answer)
        if self._fault("B5", "damaged") is not None:
            reply = reply[:4] + bytes((reply[4] ^ 0x01,)) + reply[5:]
        return reply[:-3] if self._fault("B5", "truncated") is not None else reply

    def _carry_out(self, command: int, payload: bytes) -> bytes | int:
        """The payload of the reply, or the code that the request is refused with."""
        if command == pro_mode.SET_COMM_MODE and payload == b"\0\0":
            self._pro, self._puzzled = False, True
            return b""
        return pro_mode.read(command, payload, self._registers())

    def _registers(self) -> dict[int, float | int]:
        """What can be read: the static input's current and coordinates, faults, the measured position."""
        older = self._model == b"MR-E-2"
        x_register, y_register = (0x2302, 0x2303) if older else (0x3B00, 0x3B01)
        board = 0x20 if self._never_stable else 0
        return {
            0x1007: self._flags() if older else board,
            0x5001: 0.0,
            0x5002: self._x,
            0x5102: self._y,
            x_register: self._x * self._gains[0] + self._off,
            y_register: self._y * self._gains[1] + self._off,
        }
