"""What fails in a worker process is told in the one that waits for it."""

import copy
import pickle
from collections.abc import Iterator

import pytest

from nlos.drivers.errors import DeviceError
from nlos.drivers.link.scpi import ErrorsReported, ScpiError


def below(kind: type[DeviceError]) -> Iterator[type[DeviceError]]:
    yield kind
    for each in kind.__subclasses__():
        if each is not ErrorsReported:
            yield from below(each)


EVERY = [kind("counter", "it is gone.", "Plug it in.") for kind in below(DeviceError)]
EVERY.append(ErrorsReported("counter", "ARM", (ScpiError(-113, "Undefined header"),)))


@pytest.mark.parametrize("error", EVERY, ids=lambda error: type(error).__name__)
def test_every_device_error_is_the_same_after_it_was_sent(error: DeviceError) -> None:
    error.add_note("while the bench was opened")
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error)):
        assert type(again) is type(error)
        assert (str(again), vars(again)) == (str(error), vars(error))
