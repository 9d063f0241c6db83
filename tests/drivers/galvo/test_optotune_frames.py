"""Frames of the Optotune's Pro mode that are nearly right."""

from collections.abc import Callable

import pytest

from nlos.drivers.galvo.optotune import wire
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.optotune.firmware import OptotuneFirmware


def framed(content: bytes) -> bytes:
    """With a right CRC, whatever it says; none of these bytes needs an escape."""
    return b"~" + content + wire.crc_16(content).to_bytes(2, "little") + b"~"


def test_a_frame_that_is_longer_or_shorter_than_it_says_is_refused() -> None:
    assert wire.decode_frame(framed(b"\0\x11\x02ab")) == (0x11, b"ab")
    for content in (b"\0\x11\x03ab", b"\0\x11\x01ab", b"\0\x11", b"\1\x11\x02ab"):
        with pytest.raises(ValueError, match="is cut or damaged"):
            wire.decode_frame(framed(content))


def test_a_position_a_little_off_the_disc_is_one_and_farther_off_is_none() -> None:
    assert wire.decode_position(b"\0\2" + b"\x3f\x99\x00\x00" + bytes(4)) == (1.1953125, 0.0)
    for x in (b"\x3f\xa0\x00\x00", b"\x7f\xc0\x00\x00"):  # 1.25, not a number
        with pytest.raises(ValueError, match="off the unit disc"):
            wire.decode_position(b"\0\2" + x + bytes(4))


def test_the_dialogues_that_the_vendor_s_kit_shows_are_the_simulated_controller_s(
    dark_bench: Callable[..., SimulatedBench],
) -> None:
    """Byte by byte: a board in Simple mode that is sent the frame which ends Pro mode, and one register read."""
    firmware = OptotuneFirmware(dark_bench())
    for said, answered in (
        (b"~\x00\x06\x02\x00\x00\x00\x00~", b""), (b"Start\r\n", b"NO\r\n"), (b"Start\r\n", b"OK\r\n"),
        (b"GoPro\r\n", b"OK\r\n"), (b"~\x00\x11\x02P\x01\x00\x00~", b"~\x00\x11\x04\x00\x00\x00\x00\xf2\x81~"),
    ):  # fmt: skip
        assert firmware.receive(said, 0.0) == answered, said
    assert wire.to_simple() == b"~\x00\x06\x02\x00\x00\x00\x00~"
    assert wire.get_registers(0x5001) == b"~\x00\x11\x02P\x01\x00\x00~"


def test_why_a_request_was_refused_is_said(dark_bench: Callable[..., SimulatedBench]) -> None:
    firmware = OptotuneFirmware(dark_bench(), left_in_pro_mode=True)
    for request, why in (
        (wire.get_registers(0x9999), "register does not exist (0x00000101)"),
        (wire.encode_frame(0x11, b"\x50\x01\x00"), "command length mismatch (0x00000003)"),
        (wire.encode_frame(0x13, b"\0\2\x50\x01"), "command length mismatch (0x00000003)"),
        (wire.encode_frame(0x42), "command unknown (0x00000002)"),
    ):
        command, payload = wire.decode_frame(firmware.receive(request, 0.0))
        assert (command, wire.reason(payload)) == (request[2] | 0x80, why)
    assert wire.reason(b"\0\0\x07\x01") == "unknown code (0x00000701)"


def test_the_older_controller_has_its_status_in_the_register_of_faults(
    dark_bench: Callable[..., SimulatedBench],
) -> None:
    firmware = OptotuneFirmware(dark_bench(), model=b"MR-E-2")
    firmware.receive(b"XY=0.5;0\r\nGOPRO\r\n", 0.0)
    _, payload = wire.decode_frame(firmware.receive(wire.get_registers(wire.BOARD_FAULTS), 0.0))
    assert wire.Status(int.from_bytes(payload, "big")) == wire.Status.NOT_STABLE
