"""USBTMC headers as bytes: what is made can be read, and nothing else can."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nlos.drivers.link.usbtmc_headers import (
    HeaderError,
    decode_capabilities,
    decode_response,
    encode_message,
    encode_request,
    encode_trigger,
    next_tag,
)

TAGS = st.integers(1, 255)


def test_a_message_is_the_bytes_of_the_standard() -> None:
    assert encode_message(7, b"*IDN?\n") == bytes.fromhex("01 07 f8 00 06 00 00 00 01 00 00 00") + b"*IDN?\n\0\0"
    assert encode_request(8, 256) == bytes.fromhex("02 08 f7 00 00 01 00 00 00 00 00 00")
    assert encode_trigger(9) == bytes.fromhex("80 09 f6 00 00 00 00 00 00 00 00 00")


@given(TAGS, st.binary(max_size=600))
def test_a_message_is_always_a_multiple_of_four_and_says_its_own_length(tag: int, data: bytes) -> None:
    message = encode_message(tag, data)
    assert len(message) % 4 == 0
    assert int.from_bytes(message[4:8], "little") == len(data)
    assert message[12 : 12 + len(data)] == data
    assert not any(message[12 + len(data) :])


def test_tags_count_from_1_to_255_and_never_reach_0() -> None:
    tags = [1]
    for _ in range(254):
        tags.append(next_tag(tags[-1]))
    assert tags == list(range(1, 256))
    assert next_tag(255) == 1
    assert next_tag(0) == 1


@given(TAGS, st.integers(0, 70000), st.integers(0, 70000), st.booleans())
def test_a_response_header_is_read_or_refused(tag: int, size: int, requested: int, end: bool) -> None:
    head = bytes([2, tag, tag ^ 0xFF, 0]) + size.to_bytes(4, "little") + bytes([end, 0, 0, 0])
    if size > requested:
        with pytest.raises(HeaderError, match="announced"):
            decode_response(head, tag, requested)
    else:
        assert decode_response(head, tag, requested) == (size, end)


@given(TAGS, st.integers(0, 11), st.integers(0, 7))
def test_no_flipped_bit_of_a_header_goes_unnoticed_where_that_could_do_harm(tag: int, byte: int, bit: int) -> None:
    head = bytearray([2, tag, tag ^ 0xFF, 0, 16, 0, 0, 0, 1, 0, 0, 0])
    head[byte] ^= 1 << bit
    try:
        size, end = decode_response(bytes(head), tag, 16)
    except HeaderError:
        return
    assert (byte, end) == (8, False) or (4 <= byte < 8 and size < 16)  # the message's own framing catches these


@given(st.binary(max_size=11))
def test_a_header_cut_short_is_refused(head: bytes) -> None:
    with pytest.raises(HeaderError, match="first packet"):
        decode_response(head, 1, 10)


def test_capabilities_follow_the_usb488_table() -> None:
    reply = bytes([1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0b101, 0b0100]) + bytes(8)
    seen = decode_capabilities(reply)
    assert (seen.is_488_2, seen.takes_trigger, seen.has_service_request) == (True, True, True)
    assert not decode_capabilities(bytes([1]) + bytes(23)).takes_trigger
    for short in (b"", reply[:23], b"\x80" + reply[1:]):
        with pytest.raises(HeaderError):
            decode_capabilities(short)
