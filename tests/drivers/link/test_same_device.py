"""Adapters that come back under another name, and two whose names are swapped: nothing is said to the wrong one."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from nlos.configs.load import load
from nlos.drivers import presence
from nlos.drivers.bench import open_bench
from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.errors import DeviceLost, DeviceNotFound, WrongDevice
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope import controller
from nlos.drivers.link import same_device, serial_line
from nlos.drivers.link.same_device import PortInfo, port_at, port_of, remember
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial import port as cables
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from tests.acquisition.witnessed_bench import bench_file, witnessed

FTDI = 0x0403
MIRROR, STAGE = "A50285BI", "A7035PBX"


class Stage:
    """Another instrument behind the same USB chip: it moves by whatever number it is sent."""

    def __init__(self) -> None:
        self.heard = b""

    def opened(self) -> bytes:
        return b""

    def receive(self, data: bytes, when_s: float) -> bytes:
        self.heard += data
        return b"?\r\n"

    def reboot(self) -> bytes:
        return b""


def adapters(**serials: str) -> list[PortInfo]:
    return [PortInfo(f"sim://{name}", "FT232R USB UART", serial, FTDI) for name, serial in serials.items()]


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[PortInfo]]:
    """What the operating system lists; to be changed in place."""
    listed = adapters(triggerscope=MIRROR, stage=STAGE)
    monkeypatch.setattr(same_device, "_found_at", {})
    for module in (serial_line, controller):
        monkeypatch.setattr(module, "available_ports", lambda: list(listed))
    yield listed
    for name in ("moved", "stage"):
        unplug(name)


def test_an_adapter_is_found_again_by_its_serial_number(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(same_device, "_found_at", {})
    before, cheap = adapters(usb0=MIRROR, usb1=STAGE), adapters(usb0="", usb1="")
    assert port_of("it", "sim://usb0", before) == "sim://usb0"  # nothing is known yet
    remember("sim://usb0", cheap)
    assert port_of("it", "sim://usb0", before) == "sim://usb0"  # adapters without a number cannot be told apart
    remember("sim://usb0", before)
    assert port_of("it", "sim://usb0", before) == "sim://usb0"
    assert port_of("it", "sim://usb0", adapters(usb2=MIRROR)) == "sim://usb2"
    assert port_of("it", "sim://usb0", adapters(usb0=STAGE, usb1=MIRROR)) == "sim://usb1"
    assert port_of("it", "sim://usb0", []) == "sim://usb0"
    for other in (STAGE, ""):
        with pytest.raises(WrongDevice, match=rf"another adapter is at sim://usb0.*than before \({MIRROR}\)"):
            port_of("it", "sim://usb0", adapters(usb0=other))


def test_adapters_without_a_serial_number_are_told_apart_by_their_sockets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(same_device, "_found_at", {})

    def cheap(**sockets: str) -> list[PortInfo]:
        return [PortInfo(f"sim://{name}", "USB Serial", "", 0x1A86, socket) for name, socket in sockets.items()]

    remember("sim://usb0", cheap(usb0="1-1", usb1="1-2"))
    assert port_of("it", "sim://usb0", cheap(usb0="1-1", usb1="1-2")) == "sim://usb0"
    assert port_of("it", "sim://usb0", cheap(usb0="1-2", usb1="1-1")) == "sim://usb1"  # their names were swapped
    assert port_of("it", "sim://usb0", cheap(usb2="1-1")) == "sim://usb2"
    assert port_of("it", "sim://usb0", cheap(usb0="1-3")) == "sim://usb0"  # in another socket, perhaps
    with pytest.raises(WrongDevice, match=r"another adapter is at sim://usb0.*than before \(at 1-1\)"):
        port_of("it", "sim://usb0", adapters(usb0=STAGE))


def test_a_link_is_followed_to_its_port(tmp_path: Path) -> None:
    (tmp_path / "ttyUSB1").touch()
    (link := tmp_path / "usb-FTDI_A50285BI-if00").symlink_to(tmp_path / "ttyUSB1")
    listed = [PortInfo(str(tmp_path / "ttyUSB1"), "FT232R USB UART", MIRROR, FTDI)]
    assert port_at(str(link), listed) == listed[0]


def test_a_shutter_whose_controller_comes_back_under_another_name_is_closed_there(
    tmp_path: Path, ports: list[PortInfo], caplog: pytest.LogCaptureFixture
) -> None:
    """In the middle of a scan; another instrument has its name by then, and hears nothing."""
    settings, stage = load("bench", str(bench_file(tmp_path, "S1, TTL shutter")), BenchSettings).settings, Stage()
    name = settings.mirror.address.removeprefix("sim://")
    ports[:] = adapters(**{name: MIRROR})
    with pytest.raises(DeviceLost), open_bench(settings) as bench:  # noqa: PT012
        bench.shutter.open()
        assert bench.simulated is not None
        there, here = plugged(name), bench.simulated
        here.faults.add(Fault(name="G8"))
        ports[:] = adapters(**{name: STAGE, "moved": MIRROR})
        cables._cables["moved"] = there.plugged_anew()
        try:
            bench.mirror.move_to(MirrorAngles(0.01, 0.01))
        finally:
            plug(name, stage, SimulatedBench(here.light, here.clock))
    assert [each for each in witnessed(tmp_path) if each.startswith("shutter")][-1] == "shutter closed"
    assert "answers again" in caplog.text
    assert stage.heard == b""


def test_between_two_scans_swapped_adapters_are_told_apart_before_a_byte_is_sent(ports: list[PortInfo]) -> None:
    settings = load("bench", "simulated", BenchSettings).settings
    with open_bench(settings):
        pass
    ports[:] = adapters(triggerscope=STAGE)  # the mirror's own is not plugged in
    sent: list[bytes] = []
    with (
        pytest.raises(WrongDevice, match=f"another adapter.*{STAGE}"),
        open_bench(
            settings, wire_log=lambda device, way, data: sent.append(data) if device == "triggerscope" else None
        ),
    ):
        pass
    assert sent == []
    ports[:] = adapters(triggerscope=STAGE, moved=MIRROR)
    with pytest.raises(DeviceNotFound, match="no port sim://moved"), open_bench(settings):
        pass  # it is looked for where its adapter is: there nothing answers on this bench


def test_devices_says_whose_port_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As the doctor does who then asks it."""
    (port := tmp_path / "ttyUSB0").touch()
    rule = 'SUBSYSTEM=="tty", ATTRS{idVendor}=="16c0", SYMLINK+="triggerscope"'
    for vendor_id, said in ((FTDI, "it is FT232R of USB vendor 0403, where 16c0 is usual"), (0x16C0, "there; `nlos")):
        listed = [PortInfo(str(port), "FT232R", STAGE, vendor_id)]
        monkeypatch.setattr(presence, "available_ports", lambda listed=listed: listed)
        seen = presence.port_presence(str(port), rule)
        assert seen.found
        assert said in seen.what
