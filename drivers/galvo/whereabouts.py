"""Whether anybody knows where a mirror points."""

from collections.abc import Iterator
from contextlib import contextmanager

from nlos.drivers.errors import DeviceFault


class Whereabouts:
    """Known, until something cuts a motion short; then a driver moves no further until it is opened again."""

    def __init__(self, device: str, remedy: str) -> None:
        self._device, self._remedy = device, remedy
        self.lost_by: BaseException | None = None
        """What cut a motion short; None while it is known where the mirror points."""

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Whatever cuts this short, an interrupt too, leaves the mirror where nobody knows."""
        try:
            yield
        except BaseException as error:
            self.lost_by = self.lost_by or error
            raise

    def check_known(self) -> None:
        """Raises `DeviceFault` with the cause."""
        if self.lost_by is not None:
            cause = getattr(self.lost_by, "what", self.lost_by)
            raise DeviceFault(self._device, f"where the mirror points is not known any more: {cause}", self._remedy)
