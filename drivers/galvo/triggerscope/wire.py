"""Bytes and DAC codes of the TriggerScope-MM protocol: pure functions, in both directions.

Every command is answered by its own text behind a `!`; only PAO and PDO answer with counts.
"""

import math
import re
from collections.abc import Iterator, Sequence

from nlos.drivers.identity import DeviceIdentity

IDENTIFY = b"*\n"
SPOIL = b"99999999999\n"
"""Ends half a line that another program left behind, as a number beyond every argument's range or as a line of a wrong
length, so that it is refused and not carried out; by itself it is an unknown command."""
UNKNOWN = b"ERROR_UNKNOWN_COMMAND"
LEDS_OFF = b"SSL0\n"
"""The signal LEDs no longer show what the outputs do. Firmware before v.613 does not know it."""
PLAYS_WAVES = 621
"""The first version of the firmware of which there are some whose DACs play a wave in place of their table."""
RANGE = 4  # +-10 V
CENTRE = 32767  # what the controller itself sets as mid-scale; half a code, 0.15 mV, below 0 V
CODES = 65536
SPAN_V = 20.0
DACS = range(1, 10)
"""Those whose replies fit the controller's buffer; it has 16."""
STATES = 1200
"""Length of a controller's table of states. It does not check: writing past it corrupts the firmware's memory."""

_LINE_STATES = 99  # a longer line's reply may overrun the controller's buffer of 20 bytes
_IDENTITY = re.compile(rb"ARC TRIGGERSCOPE ([!-~]+) ([!-~]+) Board ([!-~]+) (v\.[!-~]+-MM)")


def code_for(angle_rad: float, volts_per_degree: float, offset_v: float) -> int:
    """DAC code that deflects the beam by an optical angle; `volts_per_degree` is of mechanical angle. Raises
    `ValueError` where the DAC does not reach."""
    volts = math.degrees(angle_rad) / 2.0 * volts_per_degree + offset_v
    code = round((volts / SPAN_V + 0.5) * CODES) if math.isfinite(volts) else -1
    if not 0 <= code < CODES:
        raise ValueError(f"needs {volts:+.3f} V, the controller gives -10 V to +9.9997 V")
    return code


def angle_for(code: int, volts_per_degree: float, offset_v: float) -> float:
    """Optical angle in radians that a DAC code stands for."""
    volts = (code / CODES - 0.5) * SPAN_V
    return 2.0 * math.radians((volts - offset_v) / volts_per_degree)


def set_range(dac: int) -> bytes:
    """`SARn-r`: the span of a DAC. Every output goes to code 0 with it."""
    return b"SAR%d-%d\n" % (dac, RANGE)


def set_code(dac: int, code: int) -> bytes:
    """`SAOn-v`: a DAC to a code, 0 to 65535."""
    return b"SAO%d-%d\n" % (dac, code)


def ask_states(dac: int) -> bytes:
    """`PANn`: asks how long the table of a DAC is. Changes nothing."""
    return b"PAN%d\n" % dac


def clear_states(dac: int) -> bytes:
    """`PACn`: forgets the table of a DAC and stops stepping it."""
    return b"PAC%d\n" % dac


def no_wave(dac: int) -> bytes:
    """`WAVn-a-o-u-d`: what a DAC plays at each edge in place of its table, an amplitude of 0 being none."""
    return b"WAV%d-0-0-1-0\n" % dac


def plays_waves(firmware: str) -> bool:
    """Whether firmware of this version may know `WAV`."""
    number = re.match(r"v\.(\d+)", firmware)
    return number is None or int(number[1]) >= PLAYS_WAVES


def step_states(dac: int, on: bool) -> bytes:
    """Starts (first state at the first rising edge) or stops stepping."""
    return b"PAS%d-%d-1\n" % (dac, on)


def end_blanking(dac: int) -> bytes:
    """An output no longer follows the level of the trigger input; it shows its code."""
    return b"BAO%d-0-0\n" % dac


def set_mask(group: int, mask: int) -> bytes:
    """`SDOg-m`: the eight TTL outputs of a group, a bit each."""
    return b"SDO%d-%d\n" % (group, mask)


def clear_masks(group: int) -> bytes:
    """`PDCg`: forgets the table of a TTL group."""
    return b"PDC%d\n" % group


def step_masks(group: int, on: bool) -> bytes:
    """`PDSg-s-t`: a TTL group steps with trigger edges, or no longer."""
    return b"PDS%d-%d-1\n" % (group, on)


def end_mask_blanking(group: int) -> bytes:
    """`BDOg-0-0`: a TTL group is not blanked by the trigger level."""
    return b"BDO%d-0-0\n" % group


def echo(command: bytes) -> bytes:
    """The reply that confirms a command, without its line end."""
    return b"!" + command[:-1]


def load_states(dac: int, codes: Sequence[int]) -> Iterator[tuple[bytes, bytes]]:
    """Lines that fill a DAC's table, each with the reply that confirms it. Raises `ValueError` before the first."""
    if dac not in DACS:
        raise ValueError(f"DAC {dac}: only 1 to 9, the reply for others overruns the controller's buffer")
    return _load(b"PAO%d" % dac, codes)


def load_masks(group: int, masks: Sequence[int]) -> Iterator[tuple[bytes, bytes]]:
    """Lines that fill a TTL group's table, each with the reply that confirms it."""
    return _load(b"PDO%d" % group, masks)


def _load(name: bytes, values: Sequence[int]) -> Iterator[tuple[bytes, bytes]]:
    if len(values) > STATES:
        raise ValueError(f"{len(values)} states, the controller has room for {STATES}")
    for start in range(0, len(values), _LINE_STATES):
        part = values[start : start + _LINE_STATES]
        line = b"%s-%d-%s\n" % (name, start, b"-".join(b"%d" % value for value in part))
        yield line, b"!%s-%d-%d-%d" % (name, start, len(part), start + len(part))


def marker_masks(count: int) -> list[int]:
    """TTL masks that count the steps: outputs 1 and 2 in turn, each step one rising edge; output 4 at the first."""
    return [(1 if index % 2 == 0 else 2) | (4 if index == 0 else 0) for index in range(count)]


def decode_identity(line: bytes) -> DeviceIdentity | None:
    """Who answers, from the identity line or banner; None for any other line."""
    match = _IDENTITY.search(line)
    if match is None:
        return None
    channels, revision, board, firmware = (group.decode("ascii") for group in match.groups())
    return DeviceIdentity("triggerscope", "ARC", f"TriggerScope {channels} {revision} Board {board}", "", firmware)


def range_changed(text: bytes) -> bool:
    """Whether `text` holds the reply to somebody else's range command: this driver knows +-10 V only."""
    return any(int(number) != RANGE for number in re.findall(rb"!SAR\d+-(\d+)", text))
