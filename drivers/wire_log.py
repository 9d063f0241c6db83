"""What is kept of the bytes on the cables: keeping it stops none of them."""

import logging
from contextlib import suppress

from nlos.drivers.device_model import WireLog

_log = logging.getLogger(__name__)


def unfailing(wire_log: WireLog | None) -> WireLog | None:
    """The same log. Where it fails it ends, and that is said: a disk that is full must not hold up the command that
    shuts the light."""
    if wire_log is None:
        return None
    going = True

    def log(device: str, direction: str, data: bytes) -> None:
        nonlocal going
        if not going:
            return
        try:
            wire_log(device, direction, data)
        except Exception as error:
            going = False
            with suppress(Exception):  # nor does saying so
                _log.warning("the wire log of %s ends here: %s", device, error)

    return log
