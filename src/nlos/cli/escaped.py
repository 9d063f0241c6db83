"""Text from files and file names, made safe to print: what would command a terminal is shown, not sent."""

import re
import sys

from nlos.cli.passing_stream import PassingStream

_COMMANDS = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # control characters but tab and line feed
    "\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"  # invisible, or turning the direction of what follows
    "\ud800-\udfff\ufff9-\ufffb\U000e0000-\U000e007f]"  # bytes of names that are no text, annotations, tags
)


def escaped(text: str) -> str:
    r"""`text` with every character that commands a terminal, or hides, written as Python writes it: `\x1b`.

    Tab and line feed stay. Idempotent.
    """
    return _COMMANDS.sub(_written, text)


def _written(found: re.Match[str]) -> str:
    code = ord(found[0])
    if 0xDC80 <= code <= 0xDCFF:  # how Python carries the bytes of a file name that is not UTF-8
        return f"\\x{code - 0xDC00:02x}"
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


class EscapedStream(PassingStream):
    """A text stream whose every write is `escaped`; `sent` is the stream below, for what has to move the cursor."""

    def write(self, text: str) -> int:
        self.sent.write(escaped(text))
        return len(text)


def escape_what_is_printed() -> None:
    """From now on nothing that this process prints commands the terminal, and no name is beyond its alphabet."""
    for stream in (sys.stdout, sys.stderr):
        if (reconfigure := getattr(stream, "reconfigure", None)) is not None:
            reconfigure(errors="backslashreplace")
    if sys.stdout is not None:
        sys.stdout = EscapedStream(sys.stdout)
    if sys.stderr is not None:
        sys.stderr = EscapedStream(sys.stderr)
