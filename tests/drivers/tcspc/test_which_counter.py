"""Several counters of a kind on one computer, and vendors' libraries that are not what they were taken for."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from nlos.drivers.clock import VirtualClock
from nlos.drivers.errors import DeviceBusy, DeviceNotFound, WrongDevice
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.picoquant.library import PicoquantLibrary
from nlos.drivers.tcspc.counter import HistogramAxis
from nlos.drivers.tcspc.picoquant import model as picoquant_model
from nlos.drivers.tcspc.picoquant.counter import open_picoquant
from nlos.drivers.tcspc.picoquant.families import PicoquantSettings
from nlos.drivers.tcspc.picoquant.model import PICOQUANT
from nlos.drivers.tcspc.timetagger import model as timetagger_model
from nlos.drivers.tcspc.timetagger.model import TIMETAGGER
from nlos.drivers.tcspc.timetagger.settings import TimeTaggerSettings
from nlos.drivers.tcspc.timetagger.tagger import Tagger


class Shelf:
    """One library with several instruments; what it says of calls in `other` is not what was asked."""

    def __init__(self, bench: SimulatedBench, *serials: str, **other: float) -> None:
        self.all = [PicoquantLibrary(bench, "multiharp150", 10e6, serial=each) for each in serials]
        self.open: set[int] = set()
        self.busy: set[int] = set()
        """Other programs have these open."""
        self._other = other

    def __getattr__(self, name: str) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            if name in ("MH_GetLibraryVersion", "MH_GetErrorString"):
                return int(getattr(self.all[0], name)(*arguments))
            index, *rest = arguments
            if index >= len(self.all):
                return -1
            if index in self.busy and name == "MH_OpenDevice":
                return -2
            code = int(getattr(self.all[index], name)(0, *rest))
            if name == "MH_OpenDevice":
                self.open.add(index)
            if name == "MH_CloseDevice":
                self.open.discard(index)
            if name in self._other:
                rest[-1]._obj.value = self._other[name]
            return code

        return call


def block(**more: Any) -> PicoquantSettings:
    return PicoquantSettings(model="picoquant", device="multiharp150", library="simulated", **more)


def test_the_multiharp_that_is_named_is_opened_and_no_other_is_left_open(
    dark_bench: Callable[..., SimulatedBench],
) -> None:
    for order in (("1050001", "1050002"), ("1050002", "1050001")):  # as they may be numbered after the next plug
        shelf = Shelf(bench := dark_bench(), *order)
        counter = open_picoquant(block(serial="1050002"), bench.clock, shelf)
        assert counter.identity.serial == "1050002"
        assert shelf.open == {order.index("1050002")}
        counter.close()
        assert not shelf.open


def test_of_two_multiharps_none_is_chosen_unless_one_is_named(dark_bench: Callable[..., SimulatedBench]) -> None:
    shelf = Shelf(bench := dark_bench(), "1050001", "1050002")
    with pytest.raises(DeviceNotFound, match=r"2 of MultiHarp 150 answer: 1050001, 1050002\. Name one"):
        open_picoquant(block(), bench.clock, shelf)
    with pytest.raises(DeviceNotFound, match=r"with serial number 7 answers \(there is 1050001, 1050002\)"):
        open_picoquant(block(serial="7"), bench.clock, shelf)
    assert not shelf.open


def test_where_one_of_two_multiharps_is_in_use_the_other_is_not_taken_for_it(
    dark_bench: Callable[..., SimulatedBench],
) -> None:
    """Whether the vendor's program holds the one that is meant, nobody can tell."""
    shelf = Shelf(bench := dark_bench(), "1050001", "1050002")
    shelf.busy = {0}
    for serial in ("auto", "1050001"):
        with pytest.raises(DeviceBusy, match=r"1050002 answers, another does not: .*BUSY.*Close .* Or name one"):
            open_picoquant(block(serial=serial), bench.clock, shelf)
        assert not shelf.open
    assert open_picoquant(block(serial="1050002"), bench.clock, shelf).identity.serial == "1050002"


@pytest.mark.parametrize(
    ("other", "what"),
    [({"MH_GetResolution": 10.0}, "bins of 10 ps where bins of 40 ps"),
     ({"MH_SetHistoLen": 65536}, "65536 bins where histograms of 4096 bins")],
)  # fmt: skip
def test_a_library_that_counts_otherwise_is_refused_before_it_writes_beyond_what_it_is_given(
    dark_bench: Callable[..., SimulatedBench], other: dict[str, float], what: str
) -> None:
    counter = open_picoquant(block(), (bench := dark_bench()).clock, Shelf(bench, "1050001", **other))
    with pytest.raises(WrongDevice, match=what):
        counter.configure(HistogramAxis(512, 40e-12))


def test_a_library_of_another_version_is_no_counter_that_is_there(
    dark_bench: Callable[..., SimulatedBench], monkeypatch: pytest.MonkeyPatch
) -> None:
    """`nlos devices` says what opening it would."""
    library = PicoquantLibrary(dark_bench(), "multiharp150", 10e6, version="2.0")
    monkeypatch.setattr(picoquant_model, "load_library", lambda *_: library)
    seen = PICOQUANT.look_for(block())
    assert not seen.found
    assert "version '2.0'" in seen.what
    with pytest.raises(WrongDevice) as opened:
        open_picoquant(block(), VirtualClock(), library)
    assert (opened.value.what, opened.value.remedy) == (seen.what, seen.remedy)


def test_of_two_time_taggers_none_is_chosen_unless_one_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    package = SimpleNamespace(scanTimeTagger=lambda: ["1729000ABC", "1729000XYZ"], createTimeTagger=made.append)
    monkeypatch.setattr(timetagger_model, "load_package", lambda device: package)
    inputs = {"model": "timetagger", "sync": {"channel": 1}, "detector": {"channel": 2}}
    auto, named = (TimeTaggerSettings.model_validate({**inputs, "serial": each}) for each in ("auto", "1729000XYZ"))
    with pytest.raises(DeviceNotFound, match="2 Time Taggers answer: 1729000ABC, 1729000XYZ"):
        Tagger(auto, VirtualClock(), package)
    assert not TIMETAGGER.look_for(auto).found
    Tagger(named, VirtualClock(), package)
    assert TIMETAGGER.look_for(named).found
    assert made == ["1729000XYZ"]
