"""A driver of somebody else's package is held to the contract: its mistakes harm neither light nor recordings."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pytest

from nlos.configs.load import load
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.clock import SystemClock
from nlos.drivers.device_model import DeviceModel, ShutterOutput
from nlos.drivers.errors import DeviceFault, DeviceLost
from nlos.drivers.galvo.block import MirrorBlock
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.galvo.mirror import GalvoMirror
from nlos.drivers.plug_in_device import Contract, held
from nlos.drivers.plug_ins import with_plug_ins
from nlos.drivers.presence import Presence
from nlos.drivers.tcspc.counter import (
    CounterStatus,
    CountRates,
    Histogram,
    HistogramAxis,
    HistogramCounter,
    HistogramFlag,
)
from nlos.drivers.tcspc.handed_over import answers_misfit
from nlos.drivers.tcspc.known_counters import COUNTERS

AXIS = HistogramAxis(8, 1e-11)
READ = Histogram(np.ones(8, np.uint32), 1e-11, 0.0, 1e-3, 10000, 8, HistogramFlag.NONE, 0.0)

OF_EVERY_INSTANCE = ("__dict__", "__weakref__")


class OwnError(Exception):
    """An error of the package's own."""


def nothing(*given: object, **named: object) -> None:
    pass


def device(protocol: type, **methods: Callable[..., Any]) -> Any:
    """Has every method of the contract, and does nothing but `methods`."""
    names: dict[str, object] = {
        name: None if isinstance(promised, property) else staticmethod(nothing)
        for name, promised in vars(protocol).items()
        if not name.startswith("_")
    }
    return type("AcmeDevice", (), names | {name: staticmethod(method) for name, method in methods.items()})()


def opened(protocol: type, **methods: Callable[..., Any]) -> Any:
    model: DeviceModel[Any] = replace(next(iter(MIRRORS.values())), open=lambda *given: device(protocol, **methods))
    contract = Contract(protocol, answers_misfit) if protocol is HistogramCounter else Contract(protocol)
    return held(model, contract, "acme-optics").open(None, SystemClock(), None, None)


def raises(error: Exception) -> Callable[..., Any]:
    def method(*given: object, **named: object) -> None:
        raise error

    return method


def test_whatever_it_raises_is_a_device_error_that_names_package_and_line() -> None:
    mirror = opened(GalvoMirror, move_to=raises(OwnError("E17.")), park=raises(DeviceLost("acme", "gone.")))
    with pytest.raises(DeviceFault, match=rf"OwnError at {__file__}:\d+: E17\. Update acme-optics"):
        mirror.move_to(None)
    with pytest.raises(DeviceLost, match=r"^acme: gone\."):
        mirror.park()


def test_what_we_raise_while_it_waits_passes_through_it() -> None:
    ours = type("LightOff", (Exception,), {"__module__": "nlos.acquisition.scanning.light_watch"})
    counter = opened(HistogramCounter, wait_points=raises(ours()))
    with pytest.raises(ours):
        counter.wait_points(1, timeout_s=1.0)


def test_what_it_lacks_is_said_before_there_is_light_and_it_is_closed() -> None:
    closed: list[bool] = []
    made = device(GalvoMirror, close=lambda: closed.append(True), max_sequence=lambda: 0)
    del type(made).look, type(made).stop
    model: DeviceModel[Any] = replace(next(iter(MIRRORS.values())), open=lambda *given: made)
    lacking = r"AcmeDevice lacks max_sequence \(a property\), stop \(a method\), look \(a method\), which"
    with pytest.raises(DeviceFault, match=lacking):
        held(model, Contract(GalvoMirror), "acme-optics").open(None, SystemClock(), None, None)
    assert closed


def test_a_call_that_it_does_not_take_is_its_fault() -> None:
    model: DeviceModel[Any] = replace(
        next(iter(MIRRORS.values())),
        open=lambda settings: None,  # type: ignore[arg-type, return-value]
        look_for=lambda settings: 1 / 0,  # type: ignore[arg-type, return-value]
        shutters={"acme": ShutterOutput(lambda device: object())},  # type: ignore[arg-type, return-value]
    )
    theirs = held(model, Contract(GalvoMirror), "acme-optics")
    with pytest.raises(DeviceFault, match="takes 1 positional argument but 4 were given"):
        theirs.open(None, SystemClock(), None, None)
    assert not theirs.look_for(None).found
    assert "ZeroDivisionError" in theirs.look_for(None).what
    with pytest.raises(DeviceFault, match=r"object lacks on_counter \(a property\), open \(a method\), close"):
        theirs.shutters["acme"].of(None)


@pytest.mark.parametrize(
    ("read", "why"),
    [
        (None, "NoneType, no list, where 1 were asked for"),
        ([], "a list of 0, where 1 were asked for"),
        ([READ.counts], "ndarray, no Histogram"),
        ([replace(READ, counts=READ.counts * 1.5)], r"counts are float64 \(8,\), must be whole numbers \(8,\)"),
        ([replace(READ, counts=READ.counts[:4])], r"counts are uint32 \(4,\)"),
        ([replace(READ, counts=READ.counts.astype(int) - 2)], "counts from -1 to -1, must be 0 to 4294967295"),
        ([replace(READ, counts=READ.counts.astype(np.uint64) << 33)], "counts from 8589934592"),
        ([replace(READ, bin_width_s=10.0)], "bin_width_s is 10, configured were 1e-11 s"),
        ([replace(READ, live_time_s=np.nan)], "live_time_s is nan, must be a number from 0"),
        ([replace(READ, live_time_s=0.0)], "live_time_s is 0, .*no flag says that the point was lost"),
        ([replace(READ, flags=0)], "flags are int, must be HistogramFlag"),  # type: ignore[arg-type]
    ],
)
def test_histograms_that_cannot_be_counts_are_never_recorded(read: Any, why: str) -> None:
    counter = opened(HistogramCounter, configure=lambda axis, stop=None: None, read=lambda first, count: read)
    counter.configure(AXIS, None)
    with pytest.raises(DeviceFault, match=f"its driver's answer to read: {why}"):
        counter.read(0, 1)


def test_a_point_that_is_said_to_be_lost_has_no_live_time() -> None:
    lost = replace(READ, live_time_s=0.0, flags=HistogramFlag.DATA_LOST)
    counter = opened(HistogramCounter, configure=lambda axis, stop=None: None, read=lambda first, count: [lost])
    counter.configure(AXIS, None)
    assert counter.read(0, 1) == [lost]


@pytest.mark.parametrize(
    "closed",
    [
        {"__slots__": ("_at",)},
        {"__setattr__": raises(AttributeError("cannot assign to field"))},
        {"__setattr__": raises(ValueError("it has no such field"))},  # as pydantic's
    ],
)
def test_a_class_with_slots_or_one_that_is_frozen_is_held_too(closed: dict[str, object]) -> None:
    names = {name: each for name, each in vars(type(device(GalvoMirror))).items() if name not in OF_EVERY_INSTANCE}
    kind: Any = type("AcmeMirror", (), names | closed | {"move_to": raises(OwnError("E17."))})
    assert hasattr(kind(), "__dict__") == ("__slots__" not in closed)
    model: DeviceModel[Any] = replace(next(iter(MIRRORS.values())), open=lambda *given: kind())
    mirror = held(model, Contract(GalvoMirror), "acme-optics").open(None, SystemClock(), None, None)
    assert isinstance(mirror, kind)  # its shutter may ask for it
    with pytest.raises(DeviceFault, match=r"OwnError at .*: E17\."):
        mirror.move_to(None)
    with pytest.raises(DeviceFault, match="answer to settle_s: None, no number"):
        mirror.settle_s(None, None)


def test_what_takes_no_other_methods_is_refused_before_there_is_light() -> None:
    names = {name: each for name, each in vars(type(device(GalvoMirror))).items() if name not in OF_EVERY_INSTANCE}
    final = {"__slots__": (), "__init_subclass__": classmethod(raises(TypeError("it is final")))}
    made = type("AcmeMirror", (), names | final)()
    model: DeviceModel[Any] = replace(next(iter(MIRRORS.values())), open=lambda *given: made)
    with pytest.raises(DeviceFault, match=r"AcmeMirror takes no other methods .* class written in Python is needed"):
        held(model, Contract(GalvoMirror), "acme-optics").open(None, SystemClock(), None, None)


def test_one_array_for_several_points_is_never_recorded() -> None:
    counter = opened(HistogramCounter, configure=lambda axis, stop=None: None, read=lambda first, count: [READ] * count)
    counter.configure(AXIS, None)
    counter.read(0, 1)
    with pytest.raises(DeviceFault, match="answer to read: one array for several points"):
        counter.read(0, 3)


def test_answers_of_another_kind_are_refused_and_good_ones_pass() -> None:
    status, rates = CounterStatus(True, 1, 0, None), CountRates(1e7, 100.0)
    answers: dict[str, Any] = {"wait_points": status, "rates": rates, "configure": None, "read": [READ]}
    counter = opened(HistogramCounter, **{name: lambda *given, a=name, **named: answers[a] for name in answers})
    counter.configure(AXIS)
    assert (counter.wait_points(1, timeout_s=1.0), counter.rates(), counter.read(0, 1)) == (status, rates, [READ])
    answers |= {"wait_points": None, "rates": CountRates(1e7, float("nan"))}
    with pytest.raises(DeviceFault, match="wait_points: NoneType, no CounterStatus"):
        counter.wait_points(1, timeout_s=1.0)
    with pytest.raises(DeviceFault, match="rates: detector_hz is nan, must be a number from 0"):
        counter.rates()
    mirror = opened(GalvoMirror, settle_s=lambda start, end: None)
    with pytest.raises(DeviceFault, match="settle_s: None, no number"):
        mirror.settle_s(None, None)


class Block(MirrorBlock):
    cable: ClassVar = "serial"
    model: Literal["acme"]
    port: str


class NoAddress(MirrorBlock):
    cable: ClassVar = "serial"
    model: Literal["acme"]


class NoWord(MirrorBlock):
    cable: ClassVar = "serial"
    port: str


class Ethernet(MirrorBlock):
    cable: ClassVar = "ethernet"  # type: ignore[assignment]
    model: Literal["acme"]
    port: str


GOOD: DeviceModel[Any] = DeviceModel(Block, lambda *given: None, lambda *given: None, lambda s: Presence(True, ""))
NO_ADDRESS, NO_WORD = replace(GOOD, settings=NoAddress), replace(GOOD, settings=NoWord)
ETHERNET = replace(GOOD, settings=Ethernet)
NO_OUTPUT = replace(GOOD, shutters={"acme_out": print})  # type: ignore[dict-item]
TAKEN = replace(GOOD, shutters={"none": ShutterOutput(print)})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("class Own(Exception): pass\nraise Own('no licence')", "Own: no licence"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("1 / 0", "ZeroDivisionError"),
        ("from tests.drivers.test_plug_in_device import NO_ADDRESS as MIRROR", "NoAddress has no key `port`"),
        ("from tests.drivers.test_plug_in_device import NO_WORD as MIRROR", "NoWord needs `model: Literal"),
        ("from tests.drivers.test_plug_in_device import ETHERNET as MIRROR", "Ethernet needs `cable: ClassVar"),
        ("from tests.drivers.test_plug_in_device import NO_OUTPUT as MIRROR", "acme_out is not an nlos.*ShutterOutput"),
        ("from tests.drivers.test_plug_in_device import TAKEN as MIRROR", "a shutter none already exists"),
        ("print('{}')\nfrom tests.drivers.test_plug_in_device import GOOD as MIRROR", ""),
    ],
)
def test_a_package_that_cannot_be_used_takes_no_other_bench_with_it(
    text: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"acme_{abs(hash(text))}"
    (tmp_path / f"{name}.py").write_text(text, "utf-8")
    about = tmp_path / "acme-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n", "utf-8")
    (about / "entry_points.txt").write_text(f"[nlos.trial]\nacme = {name}:MIRROR\n", "utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    said: list[str] = []
    monkeypatch.setattr("nlos.drivers.plug_ins._log.warning", lambda form, *words: said.append(form % words))
    models = with_plug_ins("nlos.trial", MirrorBlock, Contract(GalvoMirror), MIRRORS.values())
    assert all(re.search(f"nlos.trial acme of acme cannot be used: .*{why}", line) for line in said)
    assert len(said) == bool(why)
    assert set(models) - set(MIRRORS) == (set() if why else {"acme"})
    assert capsys.readouterr().out == ""


def test_a_shutter_word_that_both_instruments_claim_opens_no_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    told = load("bench", "simulated", BenchSettings).settings
    counter, mirror, word = COUNTERS[told.counter.model], MIRRORS[told.mirror.model], told.shutter.model
    output = (counter.shutters | mirror.shutters)[word]
    monkeypatch.setitem(COUNTERS, counter.name, replace(counter, shutters={word: output}))
    monkeypatch.setitem(MIRRORS, mirror.name, replace(mirror, shutters={word: output}))
    with pytest.raises(ValueError, match=f"shutter {word} is an output of counter .* and of mirror .*: nobody knows"):
        BenchSettings.model_validate_json(told.model_dump_json())
