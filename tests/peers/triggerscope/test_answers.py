"""The compiled sketches and the simulated firmware answer alike and do the same with their outputs."""

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.triggerscope.firmware import V4, V4B, TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS
from nlos.drivers.simulated.triggerscope.wiring import Wiring

BOARDS = {"TriggerScope_V4B": V4B, "TriggerScope_V4": V4}
COMMANDS = 2500
Make = Callable[..., object]


class Pair:
    """Both controllers on a bench each, given the same; what their outputs do is written down."""

    def __init__(self, name: str, sketch: Make, dark_bench: Callable[[], SimulatedBench]) -> None:
        self.benches = [dark_bench(), dark_bench()]
        wirings = [Wiring(bench, shutter_pin=9) for bench in self.benches]
        self.firmwares = [
            sketch(name, self.benches[0], wirings[0]),
            TriggerScopeFirmware(self.benches[1], wirings[1], board=BOARDS[name]),
        ]
        self.logs: list[list[tuple[float, str, int, int]]] = [[], []]
        self.opened = [firmware.opened() for firmware in self.firmwares]
        for wiring, log in zip(wirings, self.logs, strict=True):
            wiring.log = lambda *event, log=log: log.append(event)

    def say(self, data: bytes) -> list[bytes]:
        return [firmware.receive(data, 0.0) for firmware in self.firmwares]

    def pulse(self, when_s: float) -> None:
        for bench in self.benches:
            bench.edge("pixel_clock", when_s)


@pytest.fixture(params=BOARDS)
def pair(request: pytest.FixtureRequest, sketch: Make, dark_bench: Callable[[], SimulatedBench]) -> Pair:
    return Pair(request.param, sketch, dark_bench)


def without_words(answer: bytes) -> bytes:
    """What follows an error's name is text for a person, each with its own."""
    return answer.split(b":")[0] if answer.startswith(b"!ERROR_") else answer


ODD = [b"", b"x", b" 3", b"+4", b"7y", b"-1", b"007", *(b"%d" % n for n in (255, 256, 257, 65536, 2**31, 2**40))]
NAMES = [
    "SAR", "SAO", "SAO", "PAN", "PAC", "PAO", "PAO", "PAS", "PAS", "BAO", "BAD", "BAL", "SDO", "SDO", "PDN", "PDC",
    "PDO", "PDO", "PDS", "PDS", "BDO", "BDO", "SSL", "*", "CLEAR_ALL", "CLEAR_DAC", "SA",
]  # fmt: skip


def number(rng: random.Random) -> bytes:
    return rng.choice(ODD) if rng.random() < 0.4 else b"%d" % rng.randint(0, rng.choice([1, 2, 17, 255, 65535]))


def command(rng: random.Random) -> bytes:
    """Mostly right, often malformed, never one that writes past a table: what that does depends on the linker."""
    name = rng.choice(NAMES).encode()
    if name in (b"PAO", b"PDO"):
        values = [number(rng) if rng.random() < 0.1 else b"%d" % rng.randint(0, 255) for _ in range(rng.randint(0, 20))]
        head = (
            b"%d" % rng.randint(0, 9 if name == b"PAO" else 1)
            if rng.random() < 0.9
            else rng.choice([b"2", b"x", b"", b"9"])
        )
        return b"-".join([name + head, b"%d" % rng.randint(0, 1100), *values])
    if name == b"CLEAR_DAC":
        return name + b" %d" % rng.randint(0, 40)
    right = {b"PAS": 3, b"BAO": 3, b"PDS": 3, b"BDO": 3, b"SAR": 2, b"SAO": 2, b"SDO": 2, b"BAD": 2, b"BAL": 2, b"*": 0}
    count = right.get(name, 1) if rng.random() < 0.9 else rng.randint(0, 4)
    small = [b"%d" % rng.randint(0, 1) for _ in range(count)]
    if name[1:2] == b"A" and small:
        small[0] = b"%d" % rng.randint(1, 16)
    if name in (b"SAR", b"SAO", b"SDO") and count > 1:
        small[1] = b"%d" % rng.randint(1, {b"SAR": 5, b"SAO": 65535, b"SDO": 255}[name])
    if rng.random() < 0.25:
        small = [number(rng) for _ in small]
    return name + rng.choice([b"-"] * 20 + [b",", b" "]).join(small)


def line(rng: random.Random) -> bytes:
    text = command(rng)
    if rng.random() < 0.03:
        at = rng.randrange(len(text) + 1)
        text = text[:at] + bytes([rng.choice([0, 13, 45, 57, 255, 32])]) + text[at:]
    ending = rng.random()
    if ending < 0.02:
        return text  # half a line: the next one completes it
    if ending < 0.04:
        return text + b"\n" + command(rng) + b"\n"  # two at once: the second is lost
    return text + b"\n"


def test_random_commands_are_answered_alike(pair: Pair) -> None:
    """Replies, DAC codes, ranges, pins, with trigger pulses in between."""
    rng = random.Random(1)
    counted, waiting = 0, b""
    for index in range(COMMANDS):
        if rng.random() < 0.2:
            pair.pulse(float(index))
        data = line(rng)
        if (waiting + data).startswith(b"CLEAR_DAC") and len(waiting + data) > 25:
            data = b"\n"  # not past a buffer on the stack
        waiting = b"" if b"\n" in data else waiting + data
        theirs, ours = pair.say(data)
        assert without_words(ours) == without_words(theirs), (index, data)
        assert pair.logs[1] == pair.logs[0], (index, data)
        counted += bool(theirs)
        for log in pair.logs:
            log.clear()
    print(f"{COMMANDS} lines, {counted} answers, 0 differences")


def test_the_start_up_text_is_the_same(pair: Pair) -> None:
    assert pair.opened[0] == pair.opened[1]
    assert b"ARC TRIGGERSCOPE 16" in pair.opened[0]
    assert [firmware.opened() for firmware in pair.firmwares] == [b"", b""]


@pytest.mark.parametrize("state", LEFT_OVERS)
def test_left_overs_put_out_the_same(pair: Pair, state: str) -> None:
    for text in LEFT_OVERS[state]:
        assert len(set(pair.say(text + b"\n"))) == 1
    for when_s in range(1, 6):
        pair.pulse(float(when_s))
    assert bool(pair.logs[0]) == (state != "opens_as_blanking_ends")  # as its name says
    assert pair.logs[1] == pair.logs[0]


@pytest.mark.parametrize("name", HALF_LINES)
def test_eleven_nines_spoil_any_half_line(pair: Pair, name: str) -> None:
    pair.say(HALF_LINES[name])
    for answer in pair.say(b"99999999999\n"):
        assert b"ERROR_" in answer
    assert pair.logs == [[], []]
    assert [answer.startswith(b"ARC") for answer in pair.say(b"*\n")] == [True, True]


@pytest.mark.parametrize(
    "name", ["SDO1-255", "PDS1-1-1", "SAO1-65535", "SAR1-1", "PAO1-0-5-5-5", "BDO1-1-1", "PAS1-1-1", "SSL1"]
)
def test_eleven_nines_spoil_a_command_cut_anywhere(pair: Pair, name: str) -> None:
    """Every prefix of it: nothing is put out."""
    for length in range(len(name) + 1):
        pair.say(name[:length].encode())
        theirs, ours = pair.say(b"99999999999\n")
        assert without_words(theirs) == without_words(ours)
        assert b"ERROR_" in theirs
    assert pair.logs == [[], []]


def test_a_short_pulse_is_the_wirings_business(pair: Pair) -> None:
    for text in (b"PDO0-0-1-2", b"PDS0-1-1"):
        pair.say(text + b"\n")
    for bench in pair.benches:
        bench.edge("pixel_clock", 1.0, width_s=5e-6)
    assert pair.logs == [[], []]


@pytest.mark.parametrize("text", [b"PAO1-1190-" + b"-".join([b"5"] * 12), b"PDO0-1198-1-2-3"])
def test_nothing_in_the_sketch_stops_a_table_at_its_end(
    programs: Callable[..., tuple[Path, dict[tuple[str, int], int]]],
    dark_bench: Callable[[], SimulatedBench],
    text: bytes,
) -> None:
    """Compiled with an address sanitizer, which ends it where it writes into memory that is not the table's."""
    import subprocess

    program, _ = programs("TriggerScope_V4B", "-fsanitize=address")
    script = b"R%d\n%s\n" % (len(text) + 1, text)
    done = subprocess.run([program], input=script, capture_output=True)
    assert b"global-buffer-overflow" in done.stderr
    firmware = TriggerScopeFirmware(dark_bench())
    firmware.receive(text + b"\n", 0.0)
    assert firmware.receive(b"*\n", 0.0) == b""
