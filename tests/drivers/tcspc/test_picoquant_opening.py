"""PicoQuant instruments as labs' other programs have met them as they are opened."""

from collections.abc import Callable
from typing import Any

import pytest

from nlos.drivers.errors import DeviceNotFound
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import FAMILIES, PicoquantSettings
from tests.drivers.tcspc.test_picoquant import table


class Silent:
    """A library whose OpenDevice leaves the serial number empty; QMI's drivers ask for it afterwards."""

    def __init__(self, functions: PicoquantLibrary) -> None:
        self._functions = functions

    def __getattr__(self, name: str) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            code = int(getattr(self._functions, name)(*arguments))
            if name.endswith("_OpenDevice"):
                arguments[1].value = b""
            return code

        return call


def silent(device: str) -> tuple[Any, SimulatedBench]:
    bench = table()
    return Silent(PicoquantLibrary(bench, device, 10e6, serial="1050007")), bench


@pytest.mark.parametrize("device", FAMILIES)
@pytest.mark.parametrize("serial", ["auto", "1050007"])
def test_an_instrument_that_tells_its_serial_number_late_is_known_by_it(device: str, serial: str) -> None:
    library, bench = silent(device)
    settings = PicoquantSettings(model="picoquant", device=device, serial=serial)
    counter = open_picoquant(settings, bench.clock, library)
    assert counter.identity.serial == "1050007"
    counter.close()


def test_another_one_is_not_taken_for_it() -> None:
    library, bench = silent("multiharp150")
    settings = PicoquantSettings(model="picoquant", device="multiharp150", serial="1050008")
    with pytest.raises(DeviceNotFound, match="there is 1050007"):
        open_picoquant(settings, bench.clock, library)
