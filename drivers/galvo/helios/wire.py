"""Frames and commands of a Helios laser DAC, as bytes (SDK and firmware source, github.com/Grix/helios_dac)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

CENTRE = 0x800
MOST_POINTS = 0xFFF
RATES = (7, 0xFFFF)
START_AT_ONCE, ONCE = 1, 2
STOP, SHUTTER, STATUS, FIRMWARE, NAME = 1, 2, 3, 4, 5
COLOUR_FULL_V = 5.0  # what a colour output puts out at code 255: the ILDA connector's standard
_SENT = frozenset((STOP, SHUTTER, STATUS, FIRMWARE, NAME))
_PACKET_BYTES = 64
_CPU_HZ = 112_000_000
_DARK = bytes(4)


@dataclass(frozen=True)
class Codes:
    """One sample: 12-bit x and y, and the four colour outputs R, G, B and I (0 to 255 each)."""

    x: int
    y: int
    colours: bytes = _DARK


def encode_command(code: int) -> bytes:
    """A command with a value of 0: the shutter pin is only ever driven low. Raises `ValueError` for any code but those
    above; 0xDE would erase the firmware."""
    if code not in _SENT:
        raise ValueError(f"command 0x{code:02X} is never sent")
    return bytes([code, 0])


def encode_frame(samples: Sequence[Codes], samples_per_s: int, flags: int) -> bytes:
    """Samples as 12-bit x and y in three bytes and four colours, then rate, count and flags. Raises `ValueError` for
    what the DAC would skip in silence."""
    if not 1 <= len(samples) <= MOST_POINTS or not RATES[0] <= samples_per_s <= RATES[1]:
        raise ValueError(f"{len(samples)} points at {samples_per_s} a second")
    if fills_packets(len(samples)):
        raise ValueError(f"{len(samples)} points fill whole packets, which the DAC never takes for a whole frame")
    if any(not 0 <= code <= 0xFFF for each in samples for code in (each.x, each.y)):
        raise ValueError("a code of more than 12 bits")
    points = b"".join((each.x << 12 | each.y).to_bytes(3, "big") + each.colours for each in samples)
    return points + samples_per_s.to_bytes(2, "little") + len(samples).to_bytes(2, "little") + bytes([flags])


def fills_packets(count: int) -> bool:
    """Whether a frame of so many samples is whole USB packets: the DAC then keeps waiting for its end."""
    return (count * 7 + 5) % _PACKET_BYTES == 0


def sample_s(samples_per_s: int) -> float:
    """How long a sample really lasts: the firmware counts processor cycles, and one more than the rate asks for
    (main.c, speed_set)."""
    return (_CPU_HZ // samples_per_s + 1) / _CPU_HZ


def code_for(angle_rad: float, deg_at_full_scale: float) -> int:
    """The code nearest to an optical angle. Raises `ValueError` beyond the DAC."""
    code = round(math.degrees(angle_rad) / deg_at_full_scale * 0x7FF) if math.isfinite(angle_rad) else 0x1000
    if abs(code) > 0x7FF:
        raise ValueError(f"needs code {code + CENTRE:#x}; the DAC has 12 bits")
    return CENTRE + code
