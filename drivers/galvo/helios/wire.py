"""Frames and commands of a Helios laser DAC, as bytes (SDK and firmware source, github.com/Grix/helios_dac)."""

import math
from collections.abc import Sequence

CENTRE = 0x800
MOST_POINTS = 0xFFF
RATES = (7, 0xFFFF)
START_AT_ONCE, ONCE = 1, 2
STOP, SHUTTER, STATUS, FIRMWARE, NAME = 1, 2, 3, 4, 5
_SENT = frozenset((STOP, SHUTTER, STATUS, FIRMWARE, NAME))
_PACKET_BYTES = 64


def encode_command(code: int) -> bytes:
    """A command with a value of 0: the shutter pin is only ever driven low. Raises `ValueError` for any code but those
    above; 0xDE would erase the firmware."""
    if code not in _SENT:
        raise ValueError(f"command 0x{code:02X} is never sent")
    return bytes([code, 0])


def encode_frame(codes: Sequence[tuple[int, int]], points_per_s: int, flags: int) -> bytes:
    """Points as 12-bit x and y in three bytes and four dark colours, then rate, count and flags. Raises `ValueError`
    for what the DAC would skip in silence."""
    length = len(codes) * 7 + 5
    if not 1 <= len(codes) <= MOST_POINTS or not RATES[0] <= points_per_s <= RATES[1]:
        raise ValueError(f"{len(codes)} points at {points_per_s} a second")
    if length % _PACKET_BYTES == 0:
        raise ValueError(f"{len(codes)} points fill whole packets, which the DAC never takes for a whole frame")
    if any(not 0 <= code <= 0xFFF for pair in codes for code in pair):
        raise ValueError("a code of more than 12 bits")
    points = b"".join((x << 12 | y).to_bytes(3, "big") + bytes(4) for x, y in codes)
    return points + points_per_s.to_bytes(2, "little") + len(codes).to_bytes(2, "little") + bytes([flags])


def code_for(angle_rad: float, deg_at_full_scale: float) -> int:
    """The code nearest to an optical angle. Raises `ValueError` beyond the DAC."""
    code = round(math.degrees(angle_rad) / deg_at_full_scale * 0x7FF) if math.isfinite(angle_rad) else 0x1000
    if abs(code) > 0x7FF:
        raise ValueError(f"needs code {code + CENTRE:#x}; the DAC has 12 bits")
    return CENTRE + code
