"""What drivers had to ask for twice while the bench was examined: nothing is lost by it, but a cable shows itself."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from nlos.doctor.findings import Finding, passed, warned
from nlos.drivers.link.repeats import LOGGER


class Repeats(logging.Handler):
    """Keeps what it hears."""

    def __init__(self) -> None:
        super().__init__(logging.DEBUG)
        self.heard: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.heard.append(record.getMessage())

    def finding(self) -> Finding:
        """How many there were, and the first."""
        if not self.heard:
            return passed("repeats", "no answer had to be requested twice")
        said = f"{len(self.heard)} answers had to be requested again; the first: {self.heard[0]}"
        return warned("repeats", said, "Check that cable, its shielding and its length; avoid hubs.")


@contextmanager
def listening() -> Iterator[Repeats]:
    """Hears what is repeated until the block ends."""
    logger, repeats = logging.getLogger(LOGGER), Repeats()
    before = logger.level
    logger.setLevel(logging.DEBUG)
    logger.addHandler(repeats)
    try:
        yield repeats
    finally:
        logger.removeHandler(repeats)
        logger.setLevel(before)
