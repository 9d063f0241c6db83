"""Messages cut out of a stream of bytes: pure functions, without any port."""

from collections.abc import Callable

Take = Callable[[bytearray], bytes | None]
"""Removes one complete message from the front of the buffer and returns it, or None while it is incomplete. Raises
`ValueError`, with the buffer as it was, where that holds what the protocol does not allow."""


def take_line(buffer: bytearray) -> bytes | None:
    """A line of printable ASCII, without its CR LF."""
    end = buffer.find(b"\r\n")
    if end < 0:
        return None
    line = bytes(buffer[:end])
    if any(not 32 <= byte < 127 for byte in line):
        raise ValueError(f"{line!r} is not a line of printable text")
    del buffer[: end + 2]
    return line
