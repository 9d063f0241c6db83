"""The bytes of USBTMC-USB488: headers, control replies and capabilities, made and read by pure functions.

Sources: USBTMC 1.0 sections 3.2, 3.3 and 4.2; USBTMC-USB488 1.0 sections 3 and 4.
"""

import struct
from dataclasses import dataclass

DEV_DEP_MSG_OUT = 1
REQUEST_DEV_DEP_MSG_IN = 2
DEV_DEP_MSG_IN = 2
TRIGGER = 128

INITIATE_ABORT_BULK_OUT = 1
CHECK_ABORT_BULK_OUT_STATUS = 2
INITIATE_ABORT_BULK_IN = 3
CHECK_ABORT_BULK_IN_STATUS = 4
INITIATE_CLEAR = 5
CHECK_CLEAR_STATUS = 6
GET_CAPABILITIES = 7
READ_STATUS_BYTE = 128

STATUS_SUCCESS = 0x01
STATUS_PENDING = 0x02
STATUS_INTERRUPT_IN_BUSY = 0x20
STATUS_FAILED = 0x80
STATUS_TRANSFER_NOT_IN_PROGRESS = 0x81

HEADER_BYTES = 12
MAX_PADDING_BYTES = 3
_HEADER = struct.Struct("<BBBBIBBH")
_EOM = 1


class HeaderError(ValueError):
    """A Bulk-IN header that does not answer the request under way."""


def next_tag(tag: int) -> int:
    """The bTag after `tag`: 1..255, never 0."""
    return tag % 255 + 1


def encode_message(tag: int, data: bytes, end: bool = True) -> bytes:
    """A DEV_DEP_MSG_OUT transfer: header, data and zero bytes up to a multiple of 4."""
    header = _HEADER.pack(DEV_DEP_MSG_OUT, tag, tag ^ 0xFF, 0, len(data), _EOM if end else 0, 0, 0)
    return header + data + bytes(-len(data) % 4)


def encode_request(tag: int, size: int) -> bytes:
    """A REQUEST_DEV_DEP_MSG_IN for at most `size` bytes of data, without a termination character."""
    return _HEADER.pack(REQUEST_DEV_DEP_MSG_IN, tag, tag ^ 0xFF, 0, size, 0, 0, 0)


def encode_trigger(tag: int) -> bytes:
    """The USB488 TRIGGER message."""
    return _HEADER.pack(TRIGGER, tag, tag ^ 0xFF, 0, 0, 0, 0, 0)


def decode_response(head: bytes | memoryview, tag: int, requested: int) -> tuple[int, bool]:
    """TransferSize and EOM of the Bulk-IN header that answers request `tag`.

    Raises `HeaderError` for a header cut short, another MsgID, another or inconsistent bTag, reserved bits set, or
    more data announced than were requested.
    """
    if len(head) < HEADER_BYTES:
        raise HeaderError(f"the first packet holds {len(head)} bytes; a header has {HEADER_BYTES}")
    message, echoed, inverse, reserved, size, attributes, reserved_9, reserved_10 = _HEADER.unpack_from(head)
    if message != DEV_DEP_MSG_IN:
        raise HeaderError(f"MsgID is {message}; a response has {DEV_DEP_MSG_IN}")
    if inverse != echoed ^ 0xFF:
        raise HeaderError(f"bTag {echoed} comes with inverse {inverse}")
    if echoed != tag:
        raise HeaderError(f"bTag is {echoed}; the request under way has {tag}")
    if reserved or reserved_9 or reserved_10 or attributes & ~_EOM:
        raise HeaderError(f"reserved bits are set ({bytes(head[:HEADER_BYTES]).hex(' ')})")
    if size > requested:
        raise HeaderError(f"{size} bytes are announced, {requested} were requested")
    return size, bool(attributes & _EOM)


@dataclass(frozen=True)
class Capabilities:
    """What GET_CAPABILITIES says, as far as this project uses it."""

    is_488_2: bool
    takes_trigger: bool
    has_service_request: bool


def decode_capabilities(reply: bytes) -> Capabilities:
    """Reads the 24-byte reply to GET_CAPABILITIES (USB488 table 8). Raises `HeaderError` when it is short or failed."""
    if len(reply) < 24 or reply[0] != STATUS_SUCCESS:
        raise HeaderError(f"GET_CAPABILITIES answered {bytes(reply).hex(' ') or 'nothing'}")
    return Capabilities(
        is_488_2=bool(reply[14] & 4), takes_trigger=bool(reply[14] & 1), has_service_request=bool(reply[15] & 4)
    )
