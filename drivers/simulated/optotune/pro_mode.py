"""Pro mode from the controller's side: frames cut, checked and read, as the vendor's SDK makes and expects them.

Sources: the SDK's `commands.py` and `parsing_tools.py`. A reply carries its CRC whether GOPRO or GOPROCRC began it; a
request after GOPRO carries none. What is refused is answered with a code of four bytes.
"""

import re
import struct
from collections.abc import Mapping

SET_COMM_MODE, GET_VALUE, GET_MULTIPLE = 0x06, 0x11, 0x13
UNKNOWN_COMMAND, WRONG_LENGTH, NO_SUCH_REGISTER, READ_FAILED = 0x0002, 0x0003, 0x0101, 0x0105


def _remainder(value: int) -> int:
    for _ in range(8):
        value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


_TABLE = [_remainder(value) for value in range(256)]


def checksum(content: bytes) -> bytes:
    """CRC-16/ARC by table, low byte first."""
    crc = 0
    for byte in content:
        crc = crc >> 8 ^ _TABLE[(crc ^ byte) & 0xFF]
    return struct.pack("<H", crc)


def cut_frame(pending: bytes) -> tuple[bytes, bytes]:
    """What stands between the first two flags, and what comes after; nothing while there are not two."""
    start = pending.find(b"~")
    end = pending.find(b"~", start + 1)
    return (pending[start + 1 : end], pending[end + 1 :]) if 0 <= start < end else (b"", pending)


def unpack(frame: bytes, demands_crc: bool) -> tuple[int, bytes] | None:
    """(command, payload) of a request, None where it is none."""
    content = re.sub(rb"}(.)", lambda match: bytes((match[1][0] ^ 0x20,)), frame, flags=re.S)
    if len(content) < 5 or len(content) != content[2] + 5:
        return None
    if demands_crc and content[-2:] != checksum(content[:-2]):
        return None
    return content[1], content[3:-2]


def pack(command: int, payload: bytes) -> bytes:
    """A reply."""
    content = bytes((0, command, len(payload))) + payload
    content += checksum(content)
    return b"~" + re.sub(rb"[}~]", lambda match: bytes((0x7D, match[0][0] ^ 0x20)), content) + b"~"


def refused(command: int, code: int) -> bytes:
    """The reply to a request that is not carried out."""
    return pack(command | 0x80, struct.pack(">I", code))


def read(command: int, payload: bytes, registers: Mapping[int, float | int]) -> bytes | int:
    """The values of the registers asked for, behind their count where several were; else the code of a refusal."""
    if command == GET_VALUE:
        wanted, count = payload, b""
    elif command == GET_MULTIPLE:
        wanted, count = payload[2:], payload[:2]
    else:
        return UNKNOWN_COMMAND
    if len(wanted) != 2 * (int.from_bytes(count, "big") if count else 1):
        return WRONG_LENGTH
    values = count
    for (register,) in struct.iter_unpack(">H", wanted):
        if register not in registers:
            return NO_SUCH_REGISTER
        value = registers[register]
        values += struct.pack(">f" if isinstance(value, float) else ">I", value)
    return values
