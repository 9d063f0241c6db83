"""The simulated `tcspc488` as its profile describes it: commands, errors, status and the libusb-like backend below."""

import array
import errno
from collections.abc import Callable

import pytest
import usb.core
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.scpi_parser import ErrorQueue, ScpiFault, split_units
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.simulated.usb.backend import SimulatedUsb


@pytest.fixture
def firmware(dark_bench: Callable[..., SimulatedBench]) -> Tcspc488Firmware:
    return Tcspc488Firmware(dark_bench())


def errors(firmware: Tcspc488Firmware, message: bytes) -> list[int]:
    firmware.execute(message + b"\n", 1.0)
    codes = []
    while (code := int(firmware.execute(b"SYST:ERR?\n", 1.0).split(b",")[0])) != 0:
        codes.append(code)
    return codes


@pytest.mark.parametrize(("message", "codes"), [
    (b"HIST:BINS 512", []), (b"hist:bins 512", []), (b"HISTogram:BINS 512", []), (b":HIST:BINS 64;BWID 64", []),
    (b"HIST:BINS", [-109]), (b"HIST:BINS many", [-102]), (b"HIST:BINS 63", [-222]), (b"HIST:BINS 512.5", [-222]),
    (b"HIST:BINGO 5", [-113]), (b"\xff\xfe", [-102]), (b"HIST:BWID 33", [-222]), (b"INP:SYNC:DIV 3", [-222]),
    (b"ACQ:DWEL:LIST #19abc", [-102]), (b"ACQ:DWEL:LIST #13abc", [-222]), (b"ACQ:DWEL:LIST 5", [-102]),
    (b"ACQ:STOP:WIND 5", [-109]), (b"ACQ:STOP:WIND 9,9", [-222]), (b"ACQ:DATA? 0,1", [-230]), (b"ACQ:DATA? 0", [-109]),
    (b"TTAG:DATA? 5", [-221]), (b"ACQ:POIN 5;:ACQ:NUMB:LIST #1800001111;:INIT", [-221]),
    (b"INIT;:INIT", [-213]), (b"INIT;:HIST:BINS 512;:PROT:RATE 5", [-221]), (b"SYST:WDOG 0.01", [-222]),
    (b"SYST:WDOG x", [-102]), (b"OUTP:SHUT AJAR", [-222]), (b";".join([b"X"] * 20), [-113] * 15 + [-350]),
    (b"HIST:BINS 5;:HIST:OFFS 7", [-222]), (b"INP:SYNC:LEV 0;:INP:RATE?", [-221]),
])  # fmt: skip
def test_each_message_has_its_errors(firmware: Tcspc488Firmware, message: bytes, codes: list[int]) -> None:
    assert errors(firmware, message) == codes


def test_an_error_does_not_cancel_the_units_behind_it(firmware: Tcspc488Firmware) -> None:
    answer = firmware.execute(b"HIST:BINS 5;:HIST:BWID?;:SYST:ERR?\n", 1.0)
    assert answer == b'32;-222,"Data out of range"\n'


def test_status_byte_and_service_request_follow_completion(firmware: Tcspc488Firmware) -> None:
    firmware.execute(b"*SRE 136;*ESE 255;:ACQ:DWEL 1000;:INIT\n", 1.0)
    firmware.advance(1.0005)
    assert firmware.status_byte() == 0
    assert not firmware.take_service_request()
    assert firmware.next_event_s() == pytest.approx(1.001)
    firmware.advance(1.001)
    assert firmware.status_byte() == 128 | 64
    assert firmware.take_service_request()
    assert not firmware.take_service_request()
    firmware.execute(b"BOGUS\n", 1.0)
    assert firmware.status_byte() & (4 | 32) == 4 | 32
    firmware.execute(b"*CLS\n", 1.0)
    assert firmware.status_byte() == 0


def test_identity_and_capacity(firmware: Tcspc488Firmware) -> None:
    assert firmware.execute(b"*IDN?\n", 1.0) == b"NLOS,TCSPC-488,SIM0001,1.0.0\n"
    assert firmware.execute(b"SYST:CAPS?\n", 1.0) == b"4,65536,4096,65536,1.0.0\n"


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=60))
def test_any_bytes_are_answered_or_refused(firmware: Tcspc488Firmware, message: bytes) -> None:
    assert isinstance(firmware.execute(message, 1.0), bytes)
    try:
        units = split_units(message)
    except ScpiFault:
        return
    assert sum(len(unit) for unit in units) <= len(message)


def test_the_error_queue_ends_in_queue_overflow() -> None:
    queue = ErrorQueue()
    for _ in range(30):
        queue.push(-113)
    told = [queue.pop() for _ in range(17)]
    assert told[0].startswith(b"-113")
    assert told[15].startswith(b"-350")
    assert told[16] == b'0,"No error"'


@pytest.mark.parametrize(("name", "parameters", "code", "number"), [
    ("U11", {"place": "write"}, -4, errno.ENODEV), ("U11", {"place": "write", "error": "io"}, -1, errno.EIO),
    ("U3", {"place": "out"}, -9, errno.EPIPE), ("U17", {"what": "access"}, -3, errno.EACCES),
    ("U17", {"what": "busy"}, -6, errno.EBUSY),
])  # fmt: skip
def test_errors_are_built_as_libusb_builds_them(
    dark_bench: Callable[..., SimulatedBench], name: str, parameters: dict[str, object], code: int, number: int
) -> None:
    bench = dark_bench(Fault(name=name, parameters=parameters))
    device = usb.core.find(backend=SimulatedUsb([Tcspc488Firmware(bench)], bench.clock), idVendor=0x1209)
    with pytest.raises(usb.core.USBError) as caught:
        device.write(0x01, bytes(12))
    assert (caught.value.backend_error_code, caught.value.errno) == (code, number)


def test_a_read_that_times_out_takes_its_time_and_says_so_as_libusb_does(
    dark_bench: Callable[..., SimulatedBench],
) -> None:
    bench = dark_bench()
    device = usb.core.find(backend=SimulatedUsb([Tcspc488Firmware(bench)], bench.clock), idVendor=0x1209)
    for endpoint in (0x82, 0x83):
        start_s = bench.clock.now()
        with pytest.raises(usb.core.USBTimeoutError) as caught:
            device.read(endpoint, array.array("B", bytes(512)), 250)
        assert (caught.value.backend_error_code, caught.value.errno) == (-7, errno.ETIMEDOUT)
        assert bench.clock.now() - start_s == pytest.approx(0.25)
    assert (device.manufacturer, device.product, device.serial_number) == ("NLOS", "TCSPC-488", "SIM0001")
