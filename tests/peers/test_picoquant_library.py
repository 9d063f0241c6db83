"""The vendor's own libraries (MHLib 4, HHLib 3) without an instrument: names, texts, and what each refuses."""

import ctypes
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.clock import VirtualClock
from nlos.drivers.errors import DeviceNotFound
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.instruments import light_of
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.tcspc.counter import HistogramAxis, PointGates
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import FAMILIES, PicoquantSettings
from nlos.drivers.tcspc.picoquant.library import VendorLibrary

LIBRARIES = {"multiharp150": "libmhlib.so", "hydraharp400": "libhhlib.so"}
CODES = [0, -1, -2, -10, -11, -16, -17, -18, -20, -22, -23, -28, -36, -37]
pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the packaged libraries are for Linux")


@pytest.fixture(params=LIBRARIES)
def device(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def library(device: str, foreign_python: Callable[..., Path]) -> Any:
    where = "import snAPI; print(list(snAPI.__path__)[0])"
    folder = subprocess.run([foreign_python("snAPI"), "-c", where], capture_output=True, text=True, check=True).stdout
    return ctypes.CDLL(str(Path(folder.strip()) / LIBRARIES[device]))


class Listener:
    """Passes calls on to the stand-in and keeps them."""

    def __init__(self, functions: PicoquantLibrary) -> None:
        self._functions = functions
        self.calls: list[tuple[str, tuple[Any, ...]]] = []

    def __getattr__(self, name: str) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            self.calls.append((name, arguments))
            return int(getattr(self._functions, name)(*arguments))

        return call


def calls_of_a_scan(device: str) -> list[tuple[str, tuple[Any, ...]]]:
    """Every call that the adapter makes for three points in each mode, with the arguments as ctypes gets them."""
    calls = []
    for mode in ("histogram", "t3"):
        bench = SimulatedBench(light_of(load("bench", "multiharp", BenchSettings).settings))
        functions = Listener(PicoquantLibrary(bench, device, 10e6))
        counter = open_picoquant(PicoquantSettings(model="picoquant", device=device, mode=mode), bench.clock, functions)
        counter.configure(HistogramAxis(512, 80e-12 if device == "multiharp150" else 32e-12))
        counter.arm(PointGates([2e-3] * 3, [0, 1, 2]))
        for point in range(3):
            counter.trigger()
            counter.wait_points(point + 1, 1.0)
        if counter.has_pixel_clock:
            functions.MH_SetTriggerOutput(0, 20_000)
        counter.rates()
        counter.close()
        calls += functions.calls
    return calls


def test_its_version_is_one_that_the_adapter_takes(device: str, library: Any) -> None:
    adapter = VendorLibrary("picoquant", FAMILIES[device], library, VirtualClock())
    assert adapter.text("GetLibraryVersion", 64) == {"multiharp150": "4.0", "hydraharp400": "3.0"}[device]


def test_its_error_texts_are_those_of_the_stand_in(device: str, library: Any) -> None:
    stand_in = PicoquantLibrary(
        SimulatedBench(light_of(load("bench", "multiharp", BenchSettings).settings)), device, 10e6
    )
    for code in CODES:
        texts = [
            VendorLibrary("picoquant", FAMILIES[device], functions, VirtualClock()).text("GetErrorString", 64, code)
            for functions in (library, stand_in)
        ]
        assert texts[0] == texts[1]


def test_it_has_every_call_and_refuses_it_as_the_stand_in_does_without_an_instrument(device: str, library: Any) -> None:
    calls = calls_of_a_scan(device)
    assert len({name for name, _ in calls}) > 20
    stand_in = PicoquantLibrary(
        SimulatedBench(light_of(load("bench", "multiharp", BenchSettings).settings)), device, 10e6
    )
    for name, arguments in calls:
        if name.endswith("_OpenDevice"):
            continue
        assert getattr(library, name)(*arguments) == getattr(stand_in, name)(*arguments), name


def test_no_instrument_is_said_in_words(device: str, library: Any) -> None:
    with pytest.raises(DeviceNotFound, match=f"no {FAMILIES[device].product} answers"):
        open_picoquant(PicoquantSettings(model="picoquant", device=device), VirtualClock(), library)
