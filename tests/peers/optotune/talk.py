"""The vendor's SDK for the MR-E-2 as host of the simulated controller, in turns with our driver. Prints counts.

talk.py FOLDER, which holds the SDK as `copylot.hardware.mirrors.optotune.optoMDC`.
"""

import contextlib
import io
import struct
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import serial

from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.optotune import wire
from nlos.drivers.galvo.optotune.mirror import Optotune
from nlos.drivers.galvo.optotune.settings import OptotuneSettings
from nlos.drivers.simulated.bench import Exposure, SimulatedBench
from nlos.drivers.simulated.optotune import pro_mode
from nlos.drivers.simulated.optotune.firmware import OptotuneFirmware
from nlos.drivers.simulated.serial.port import SimulatedSerial, plug

sys.path.insert(0, sys.argv[1])
bench = SimulatedBench(lambda gate, beam, lit: Exposure(np.zeros(gate.bins, np.uint32), gate.dwell_s, 0, 0, False))
firmware = OptotuneFirmware(bench, model=b"MR-E-2")
url = plug("sdk", firmware, bench, 1e-4)


class Port(SimulatedSerial):
    """As the SDK opens one: by pyserial's former names, and with text where bytes are expected."""

    def __init__(self, interCharTimeout: float | None = None, **others: Any) -> None:
        super().__init__(inter_byte_timeout=interCharTimeout, **others)

    def read_until(self, expected: Any = b"\n", size: int | None = None) -> bytes:
        return super().read_until(expected.encode() if isinstance(expected, str) else expected, size)


serial.Serial = Port  # type: ignore[misc, assignment]
time.sleep = bench.clock.sleep
from copylot.hardware.mirrors.optotune import optoMDC  # noqa: E402
from copylot.hardware.mirrors.optotune.optoMDC.optoKummenberg.tools import parsing_tools  # noqa: E402


@contextlib.contextmanager
def their_host(**how: Any) -> Iterator[Any]:
    """A board that the SDK has connected to; what it prints is not looked at, but for its errors."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        board = optoMDC.connect(port=url, **how)
        yield board
        board.Connection.disconnect()
    errors = [line for line in said.getvalue().splitlines() if line.startswith("ERROR")]
    assert not errors, errors


@contextlib.contextmanager
def our_host() -> Iterator[Optotune]:
    mirror = Optotune.open(OptotuneSettings(model="optotune", port=url, controller="MR-E-2"), bench.clock)
    yield mirror
    mirror.close()


def connections() -> int:
    """From either mode to either, and on to our driver, which finds Simple mode whatever was left."""
    tried = 0
    for before in (True, False):
        for wanted in (True, False):
            with their_host(boot_in_simple=before):
                pass
            with their_host(boot_in_simple=wanted) as board:
                assert board._simple is wanted, (before, wanted)
            with our_host() as mirror:
                assert mirror.identity.product == "MR-E-2"
            tried += 1
    with their_host(boot_in_simple=True) as board:
        assert board.reset() == board.handshake() == b"OK\r\n"
    return tried


def places(draw: np.random.Generator) -> int:
    """Where our driver sends the mirror, their SDK reads it."""
    for _ in range(50):
        angles = MirrorAngles(*draw.uniform(-0.5, 0.5, 2))
        with our_host() as mirror:
            mirror.move_to(angles)
        with their_host() as board:
            seen = board.get_value([board.Mirror.OpticalFeedback.x, board.Mirror.OpticalFeedback.y])
            assert np.allclose(seen, wire.coordinates(angles), atol=1e-6), (angles, seen)
            assert not any(list(board.Status.GetErrorFlagRegister().values())[:-1])
    return 50


def flags() -> int:
    """Each flag has the same bit in their table and in ours."""
    for flag in wire.Status:
        firmware._stuck = int(flag)
        with their_host() as board:
            said = board.Status.GetErrorFlagRegister()
        assert [name for name, on in said.items() if on is True] == [list(said)[flag.bit_length() - 1]], (flag, said)
    firmware._stuck = 0
    return len(wire.Status)


def refusals() -> int:
    """What we call a refusal, they do."""
    for register in (0x9999, 0x0000):
        with their_host() as board:
            board.Connection.send(parsing_tools.encode(0x11, register))
            command, payload = wire.decode_frame(board.Connection.receive(terminator=b"~"))
        theirs = parsing_tools.parse_error(int.from_bytes(payload, "big")).lower().replace("_", " ")
        assert command == 0x91
        assert wire.reason(payload) == f"{theirs} (0x{payload.hex()})"
    return 2


def frames(draw: np.random.Generator) -> int:
    """Requests byte for byte, and replies that they unpack to what was packed."""
    assert parsing_tools.encode(0x06, 0) == wire.to_simple()
    for _ in range(2000):
        ids = draw.integers(0, 1 << 16, draw.integers(2, 9)).tolist()
        assert parsing_tools.encode(0x11, ids[0]) == wire.get_registers(ids[0]), ids
        assert parsing_tools.encode(0x13, ids) == wire.get_registers(*ids), ids
        values = draw.bytes(4 * len(ids))
        payload = struct.pack(">H", len(ids)) + values
        reply = pro_mode.pack(0x13, payload)
        theirs = parsing_tools.decode(reply)
        assert theirs is not None
        assert theirs[3:-2] == payload == wire.decode_frame(reply)[1], reply
    return 2000


if __name__ == "__main__":
    random = np.random.default_rng(5)
    print(
        f"connections {connections()} places {places(random)} flags {flags()} refusals {refusals()} "
        f"frames {frames(random)}"
    )
