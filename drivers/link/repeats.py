"""What a driver had to ask for twice: told to whoever judges a cable, and on the terminal with -v."""

import logging

LOGGER = "nlos.drivers.link.repeats"
_log = logging.getLogger(LOGGER)


def repeated(device: str, why: object) -> None:
    """The second time is under way; what went wrong the first time."""
    _log.debug("%s: asked again: %s", device, why)
