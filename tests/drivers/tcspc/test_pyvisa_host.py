"""pyvisa-py, written by others, as the host of the simulated `tcspc488`: both read USBTMC the same way."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
import pyvisa
import usb.backend.libusb1

NAME = "USB0::0x1209::0x0001::SIM0001::0::INSTR"


@pytest.fixture
def host(rig: Callable, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., tuple[Any, Any]]]:
    """host(packet_bytes): the rig, its own driver closed, and pyvisa-py's session with the same instrument."""
    opened = []

    def make(packet_bytes: int = 512) -> tuple[Any, Any]:
        this = rig(packet_bytes=packet_bytes)
        this.counter.close()
        # The backend that pyusb takes when nobody names one, also on a machine without libusb.
        monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda find_library=None: this.usb)
        manager = pyvisa.ResourceManager("@py")
        instrument = manager.open_resource(NAME, read_termination="\n", write_termination="\n")
        opened.extend([instrument, manager])
        return this, instrument

    yield make
    for each in opened:
        each.close()


def test_it_lists_and_identifies_the_instrument(host: Callable) -> None:
    _, instrument = host()
    assert instrument.query("*IDN?") == "NLOS,TCSPC-488,SIM0001,1.0.0"
    assert instrument.query("SYST:ERR?") == '0,"No error"'
    assert instrument.query("SYSTem:ERRor:NEXT?;:ACQuire:STATus?") == '0,"No error";IDLE,0,4096,0,0'


@pytest.mark.parametrize("packet_bytes", [64, 512, 1024])
@pytest.mark.parametrize(("values", "points", "size"), [(122, 1234, 499), (122, 12345, 500), (123, 12, 501)])
def test_blocks_around_a_full_packet_arrive_whole(
    host: Callable, packet_bytes: int, values: int, points: int, size: int
) -> None:
    _, instrument = host(packet_bytes)
    sent = list(range(1000, 1000 + values))
    instrument.write_binary_values("ACQ:NUMB:LIST ", sent, datatype="I")
    instrument.write(f"ACQ:POIN {points}")
    instrument.write("ACQ:NUMB:LIST?;:ACQ:POIN?")
    answer = instrument.read_raw()
    assert len(answer) == size
    assert answer.endswith(f";{points}\n".encode())
    np.testing.assert_array_equal(np.frombuffer(answer[5 : 5 + 4 * values], "<u4"), sent)
    assert instrument.query_binary_values("ACQ:NUMB:LIST?", datatype="I") == sent
    assert instrument.query("SYST:ERR?") == '0,"No error"'


def test_it_triggers_and_reads_records(host: Callable) -> None:
    this, instrument = host()
    instrument.write("ACQ:POIN 2;:ACQ:DWEL 1000;:ACQ:TRIG:SOUR BUS;:INIT")
    for _ in range(2):
        instrument.write("*TRG")
        this.bench.clock.sleep(0.002)
    assert instrument.query("ACQ:STAT?") == "DONE,2,4094,0,0"
    records = instrument.query_binary_values("ACQ:DATA? 0,2", datatype="B", container=bytes)
    assert len(records) == 2 * (32 + 4 * 512 + 4)
    assert records[:4] == b"TC48"


def test_its_device_clear_forgets_an_unread_answer(host: Callable) -> None:
    from pyvisa_py.protocols.usbtmc import Request, UsbTmcStatus

    this, instrument = host()
    instrument.write("*IDN?")
    device = instrument.visalib.sessions[instrument.session].interface.usb_dev
    assert device.ctrl_transfer(0xA1, Request.initiate_clear, 0, 0, 1)[0] == UsbTmcStatus.success
    assert device.ctrl_transfer(0xA1, Request.check_clear_status, 0, 0, 2)[0] == UsbTmcStatus.success
    device.clear_halt(0x01)
    assert instrument.query("ACQ:STAT?") == "IDLE,0,4096,0,0"
    assert instrument.query("SYST:ERR?") == '0,"No error"'
    assert this.bench.clock.now() < 10


def test_an_unread_answer_is_interrupted_by_the_next_question(host: Callable) -> None:
    _, instrument = host()
    instrument.write("*IDN?")
    assert instrument.query("ACQ:STAT?") == "IDLE,0,4096,0,0"
    assert instrument.query("SYST:ERR?") == '-410,"Query INTERRUPTED"'


def test_reading_without_a_question_times_out_and_the_next_one_is_answered(host: Callable) -> None:
    _, instrument = host()
    with pytest.raises(pyvisa.VisaIOError):
        instrument.read()
    assert instrument.query("SYST:ERR?") == '-420,"Query UNTERMINATED"'
    assert instrument.query("*IDN?") == "NLOS,TCSPC-488,SIM0001,1.0.0"
