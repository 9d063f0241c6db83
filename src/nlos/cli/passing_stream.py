"""A text stream that passes what is written on to another: what differs is how it writes."""

import io
from typing import Any, TextIO


class PassingStream(io.TextIOBase):
    """Passes everything on to `sent`, the stream below, which stays open as long as the process."""

    def __init__(self, sent: TextIO) -> None:
        self.sent = sent

    def __getattr__(self, name: str) -> Any:
        return getattr(self.sent, name)

    def flush(self) -> None:
        self.sent.flush()

    def isatty(self) -> bool:
        return self.sent.isatty()

    def fileno(self) -> int:
        return self.sent.fileno()

    def close(self) -> None:
        """Leaves the process's own stream open."""

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self.sent.encoding
