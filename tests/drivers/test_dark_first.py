"""Whatever light a program that was killed left on: it goes out before anything else is tried, whatever fails then."""

import hashlib
from pathlib import Path
from typing import Any

import pytest

from nlos.configs.load import load
from nlos.drivers import bench as bench_module
from nlos.drivers import light_out, partial_bench
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceError, DeviceFault, DeviceTimeout, LimitError, ProtocolError
from nlos.drivers.file_word import own_word
from nlos.drivers.light_out import make_dark
from nlos.drivers.partial_bench import open_partial_bench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.tcspc.tcspc488.settings import Tcspc488Settings
from nlos.drivers.trip_latch import TripLatch

Sent = list[tuple[str, bytes]]
DARK, CLOSED = b"SDO1-0\n", b"OUTP:SHUT CLOS"


def settings(name: str, *faults: Fault) -> BenchSettings:
    read = load("bench", name, BenchSettings).settings
    assert read.simulation is not None
    return read.model_copy(update={"simulation": read.simulation.model_copy(update={"faults": tuple(faults)})})


def kept(sent: Sent) -> Any:
    return lambda device, way, data: sent.append((device, data)) if way == ">" else None


ERRORS = [
    DeviceTimeout("picoquant", "nothing answers."),
    UnicodeDecodeError("ascii", b"\xb5", 0, 1, "a version of another language"),
    SystemExit(143),
    KeyboardInterrupt(),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda each: type(each).__name__)
def test_a_counter_that_does_not_open_leaves_no_light_that_the_mirror_drives(
    monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    sent: Sent = []

    def fails(*_: Any) -> Any:
        assert ("triggerscope", DARK) in sent
        raise error

    for module in (bench_module, partial_bench):
        monkeypatch.setattr(module, "open_counter", fails)
    with pytest.raises(type(error)), open_bench(settings("multiharp"), wire_log=kept(sent)):
        pass
    sent.clear()
    if isinstance(error, DeviceError):
        with open_partial_bench(settings("multiharp"), {"mirror", "counter"}, wire_log=kept(sent)) as left:
            assert left.mirror is not None
            assert set(left.absent) == {"counter"}
    else:
        with (
            pytest.raises(type(error)),
            open_partial_bench(settings("multiharp"), {"mirror", "counter"}, wire_log=kept(sent)),
        ):
            pass


def test_a_counter_closes_its_shutter_before_it_is_told_what_it_may_refuse(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: Sent = []
    make_dark(settings("simulated"), kept(sent))
    closed = next(k for k, (_, data) in enumerate(sent) if CLOSED in data)
    assert closed < next(k for k, (_, data) in enumerate(sent) if b"INP" in data or b"ABOR" in data)
    sent.clear()

    def refused(_: Tcspc488Settings) -> dict[str, str]:
        return {"INP1:LEV": "out of all ranges"}

    monkeypatch.setattr("nlos.drivers.tcspc.tcspc488.instrument.input_commands", refused)
    with pytest.raises(DeviceError, match=r"NOT CONFIRMED CLOSED.*Switch the laser off by hand"):
        make_dark(settings("simulated"), kept(sent))
    assert any(CLOSED in data for _, data in sent)


@pytest.mark.parametrize(
    ("fault", "error"),
    [(Fault(name="G1", times=10_000), DeviceTimeout), (Fault(name="G4", times=10_000), ProtocolError)],
)
def test_a_controller_that_is_not_understood_is_told_to_close_all_the_same(fault: Fault, error: type) -> None:
    sent: Sent = []
    with pytest.raises(error, match=r"NOT CONFIRMED CLOSED.*Switch the laser off by hand"):
        make_dark(settings("multiharp", fault), kept(sent))
    assert ("triggerscope", DARK) in sent


def test_a_contact_that_says_open_is_not_said_to_be_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Tcspc488Firmware, "_shutter_state", lambda *_: b"CLOS,OPEN")
    with pytest.raises(DeviceFault, match=r"NOT CONFIRMED CLOSED.*contact says OPEN.*Switch the laser off by hand"):
        make_dark(settings("simulated"))


def test_a_bench_without_a_shutter_says_only_that(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(light_out, "_close", None)
    bare = settings("simulated")
    bare = bare.model_copy(update={"shutter": bare.shutter.model_copy(update={"model": "none"})})
    with pytest.raises(LimitError, match="has none") as said:
        make_dark(bare)
    assert "CONFIRMED" not in str(said.value)


def test_a_port_of_another_name_does_not_forget_a_trip(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    here = settings("multiharp")
    here = here.model_copy(update={"mirror": here.mirror.model_copy(update={"port": "/dev/ttyACM0"})})
    TripLatch.of_bench(here).trip("too bright")
    moved = here.model_copy(update={"mirror": here.mirror.model_copy(update={"port": "/dev/serial/by-id/usb-ARC"})})
    assert TripLatch.of_bench(moved).standing() == "too bright"
    assert TripLatch.of_bench(here.model_copy(update={"name": "other"})).standing() is None
    monkeypatch.setenv("NLOS_STATE", "/dev/null/x")
    with pytest.raises(LimitError, match=r"no light is allowed.*NLOS_STATE"):
        TripLatch.of_bench(here).standing()


ALIKE = ("bench-1", "bench 1", "Bench 1", "実験台", "光学台", "", " ", "a" * 70, "a" * 71, "v1.2", "v1,2")


def test_no_two_benches_share_a_log_whatever_they_are_called(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    benches = [settings("multiharp").model_copy(update={"name": name}) for name in ALIKE]
    assert len({TripLatch.of_bench(bench).path for bench in benches}) == len(ALIKE)
    assert own_word("bench-1") == "bench-1"
    TripLatch.of_bench(benches[4]).trip("too bright")
    assert TripLatch.of_bench(benches[3]).standing() is None


def test_a_trip_that_an_earlier_version_wrote_down_stands_until_it_is_cleared(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """It called two benches' logs the same: the other one's trip is not cleared with one's own."""
    monkeypatch.setenv("NLOS_STATE", str(tmp_path))
    spaced, dashed = (settings("multiharp").model_copy(update={"name": name}) for name in ("bench 1", "bench-1"))
    addresses = "\n".join((dashed.mirror.address, dashed.counter.model, dashed.shutter.model))
    place = hashlib.sha256(addresses.encode()).hexdigest()[:8]
    TripLatch(tmp_path / "trips" / f"bench-1-{place}.log").trip("too bright")
    assert TripLatch.of_bench(dashed).standing() == TripLatch.of_bench(spaced).standing() == "too bright"
    TripLatch.of_bench(spaced).clear("Ada")
    assert TripLatch.of_bench(spaced).standing() is None
    assert TripLatch.of_bench(dashed).standing() == "too bright"
