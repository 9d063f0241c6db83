"""A picture in passing that the end of its scan overtakes is given up: the last one is wanted, and nothing else."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from nlos.recon.parts import heard_by


class Overtaken(BaseException):
    """The scan has ended meanwhile: no error, and nothing that a method may catch."""


@contextmanager
def given_up_once(overtaken: Callable[[], bool]) -> Iterator[None]:
    """What a method computes within the block, or anything else that counts its rounds, ends with `Overtaken` after the
    plane, iteration, mirror image or drawing in which `overtaken` came true; and so does the block itself."""

    def look(done: int = 0, total: int = 0, name: str = "") -> None:
        if overtaken():
            raise Overtaken

    look()
    with heard_by(None, within=look):
        yield
    look()
