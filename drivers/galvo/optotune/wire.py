"""Words and frames of the Optotune MR-E-2 and MR-E-3: pure functions, in both directions.

Simple mode speaks lines of text, Pro mode frames `7E | addr | command | length | payload | CRC | 7E`. The CRC of a
request after GOPRO is 0 0; that of a reply is always a real one. The facts are from the operation manuals and the
vendor's SDK; none was verified on a device.
"""

import math
import re
import struct
from enum import IntFlag

from nlos.drivers.galvo.mirror import MirrorAngles

FULL_SCALE = math.tan(math.radians(50.0))
"""Tangent of the optical angle that coordinate 1 stands for: 25 degrees mechanical."""

SET_COMM_MODE, GET_VALUE, GET_MULTIPLE = 0x06, 0x11, 0x13
REFUSED = 0x80
BOARD_FAULTS = 0x1007
"""An MR-E-2 has the flags of STATUS there (SDK, `MiscSystems.Status`), an MR-E-3 faults of its board."""
MEASURED_XY = {"MR-E-2": (0x2302, 0x2303), "MR-E-3": (0x3B00, 0x3B01)}
"""Registers of the position that the mirror's own sensor sees, by controller."""

_REASONS = {
    0x0001: "frame invalid", 0x0002: "command unknown", 0x0003: "command length mismatch", 0x0004: "CRC fail",
    0x0005: "command not implemented", 0x0101: "register does not exist", 0x0104: "register is not valid",
    0x0105: "register read unsuccessful", 0x010A: "register is not readable", 0x0201: "system does not exist",
}  # fmt: skip
_FLAG, _ESCAPE, _FLIP = 0x7E, 0x7D, 0x20
# Without a prefix only all eight digits show that it is whole.
_STATUS = re.compile(rb"0x[0-9A-Fa-f]{1,8}|[0-9A-Fa-f]{8}")
_MODEL = re.compile(rb"MR-?E-?([23])")


class Status(IntFlag):
    """The STATUS register. Bits 8 to 13 stay set until acknowledged."""

    NONE = 0
    PROXY_DISCONNECTED = 1 << 0
    PROXY_TOO_HOT = 1 << 1
    MIRROR_TOO_HOT = 1 << 2
    MIRROR_MEMORY_INVALID = 1 << 3
    NOT_STABLE = 1 << 4
    OUTPUT_CURRENT_LIMITED = 1 << 5
    AVERAGE_CURRENT_LIMITED = 1 << 6
    INPUT_TRIMMED = 1 << 7
    WAS_PROXY_DISCONNECTED = 1 << 8
    WAS_PROXY_TOO_HOT = 1 << 9
    WAS_MIRROR_TOO_HOT = 1 << 10
    WAS_OUTPUT_CURRENT_LIMITED = 1 << 11
    WAS_AVERAGE_CURRENT_LIMITED = 1 << 12
    WAS_INPUT_TRIMMED = 1 << 13

    @property
    def faults(self) -> "Status":
        """What is or was wrong: everything but a mirror on its way."""
        return self & ~Status.NOT_STABLE


def coordinates(angles: MirrorAngles) -> tuple[float, float]:
    """Position on the controller's unit disc. Its coordinates are tangents, so that a wall point is proportional to
    them; the angles are those of a two-mirror scanner, whose x deflection happens before y."""
    x = math.tan(angles.x_rad) / math.cos(angles.y_rad) / FULL_SCALE
    return round(x, 6), round(math.tan(angles.y_rad) / FULL_SCALE, 6)


def angles_at(x: float, y: float) -> MirrorAngles:
    """The angles that a position on the unit disc stands for."""
    y_rad = math.atan(y * FULL_SCALE)
    return MirrorAngles(math.atan(x * FULL_SCALE * math.cos(y_rad)), y_rad)


def set_position(x: float, y: float) -> bytes:
    """`XY=x;y` in coordinates of the unit circle, x = tan(angle) / tan(50 deg) (MR-E-2 manual, Simple mode)."""
    return b"XY=%.6f;%.6f\r\n" % (x, y)


def decode_status(line: bytes) -> Status | None:
    """The register, or None for any other line."""
    match = _STATUS.fullmatch(line)
    return Status(int(match[0], 16)) if match else None


def names_model(text: bytes) -> str:
    """The controller that `text` names, "MR-E-2" or "MR-E-3"; empty for none that this driver knows."""
    match = _MODEL.search(text)
    return f"MR-E-{match[1].decode()}" if match else ""


def crc_16(data: bytes) -> int:
    """CRC-16/ARC: polynomial 0x8005 reflected, from 0."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


def encode_frame(command: int, payload: bytes = b"", crc: bool = False) -> bytes:
    """A Pro-mode frame; without a CRC as the host sends it after GOPRO, with one as the controller answers."""
    content = bytes((0, command, len(payload))) + payload
    stuffed = bytearray()
    for byte in content + (crc_16(content) if crc else 0).to_bytes(2, "little"):
        stuffed += bytes((_ESCAPE, byte ^ _FLIP)) if byte in (_FLAG, _ESCAPE) else bytes((byte,))
    return bytes((_FLAG, *stuffed, _FLAG))


def to_simple() -> bytes:
    """The frame that ends Pro mode: SET_COMM_MODE 0, a two-byte value."""
    return encode_frame(SET_COMM_MODE, b"\0\0")


def get_registers(*registers: int) -> bytes:
    """The frame that asks for one register, or for several at once."""
    ids = struct.pack(f">{len(registers)}H", *registers)
    if len(registers) == 1:
        return encode_frame(GET_VALUE, ids)
    return encode_frame(GET_MULTIPLE, struct.pack(">H", len(registers)) + ids)


def take_frame(buffer: bytearray) -> bytes | None:
    """Removes a complete frame from the front of the buffer. Raises `ValueError` where something else stands there."""
    if not buffer:
        return None
    if buffer[0] != _FLAG:
        raise ValueError(f"{bytes(buffer[:20])!r} is not the beginning of a frame")
    end = buffer.find(_FLAG, 1)
    if end < 0:
        return None
    frame = bytes(buffer[: end + 1])
    del buffer[: end + 1]
    return frame


def decode_frame(frame: bytes) -> tuple[int, bytes]:
    """(command, payload) of a complete reply. Raises `ValueError` where it is cut, or its CRC is another one."""
    content = bytearray()
    escaped = False
    for byte in frame[1:-1]:
        if byte == _ESCAPE and not escaped:
            escaped = True
            continue
        content.append(byte ^ _FLIP if escaped else byte)
        escaped = False
    if escaped or len(content) < 5 or content[0] != 0 or content[2] != len(content) - 5:
        raise ValueError(f"{frame[:40]!r} is cut or damaged")
    if crc_16(bytes(content[:-2])) != int.from_bytes(content[-2:], "little"):
        raise ValueError(f"{frame[:40]!r} is damaged: its CRC is {bytes(content[-2:]).hex()}")
    return content[1], bytes(content[3:-2])


def reason(payload: bytes) -> str:
    """Why a request was refused: a code of 32 bits (SDK, `parse_error`)."""
    return _REASONS.get(int.from_bytes(payload, "big"), "unknown code") + f" (0x{payload.hex()})"


def decode_position(payload: bytes) -> tuple[float, float]:
    """Two measured coordinates, behind the count that the reply repeats. Raises `ValueError` where they are none."""
    if len(payload) != 10 or payload[:2] != b"\0\2":
        raise ValueError(f"{payload[:20].hex(' ')} are not two measured coordinates")
    x, y = struct.unpack(">2f", payload[2:])
    if not (math.isfinite(x) and math.isfinite(y) and math.hypot(x, y) <= 1.2):
        raise ValueError(f"measured coordinates {x:g}, {y:g} are off the unit disc")
    return x, y
