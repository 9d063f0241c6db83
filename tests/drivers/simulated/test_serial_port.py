"""A sim:// port behaves as pyserial's own ports do, in the bench's time."""

import errno
import sys
import threading
import time
from collections.abc import Callable

import pytest
import serial

import nlos.drivers.link.serial_line  # noqa: F401 - tells pyserial where sim:// is
from nlos.drivers.errors import DeviceBusy
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.cable import SerialCable
from nlos.drivers.simulated.serial.port import plug, plugged, plugged_in, unplug

Bench = Callable[..., SimulatedBench]


class Echo:
    """Sends every byte back."""

    def opened(self) -> bytes:
        return b""

    def reboot(self) -> bytes:
        return b"hello"

    def receive(self, data: bytes, when_s: float) -> bytes:
        return data


def port_to_echo(bench: SimulatedBench, latency_s: float = 0.25, **settings: object) -> serial.SerialBase:
    unplug("echo")
    return serial.serial_for_url(plug("echo", Echo(), bench, latency_s), **settings)


def test_a_read_waits_for_bytes_on_their_way_and_costs_bench_time_only(dark_bench: Bench) -> None:
    bench, began = dark_bench(), time.monotonic()
    with port_to_echo(bench, latency_s=100.0, timeout=1000.0) as port:
        port.write(b"abc")
        assert port.read(3) == b"abc"
    assert bench.clock.now() == pytest.approx(100.0)
    assert time.monotonic() - began < 50.0


def test_a_read_returns_what_there_is_when_its_timeout_passes(dark_bench: Bench) -> None:
    bench = dark_bench()
    with port_to_echo(bench, timeout=0.5) as port:
        port.write(b"abc")
        assert port.read(10) == b"abc"
        assert bench.clock.now() == pytest.approx(0.5)


def test_a_read_without_patience_returns_only_what_has_arrived(dark_bench: Bench) -> None:
    bench = dark_bench()
    with port_to_echo(bench, timeout=0) as port:
        port.write(b"abc")
        assert port.read(3) == b""
        bench.clock.sleep(0.3)
        assert port.in_waiting == 3
        assert (port.read(2), port.read(2)) == (b"ab", b"c")


def test_a_pause_between_bytes_ends_a_read(dark_bench: Bench, chopped: Callable[..., object]) -> None:
    bench = dark_bench()
    with port_to_echo(bench, timeout=60.0, inter_byte_timeout=0.01) as port:
        plugged("echo").mangle = chopped(2, gap_s=1.0)
        port.write(b"abc")
        assert port.read(3) == b"ab"


def test_lines_are_read_by_pyserial_itself(dark_bench: Bench) -> None:
    with port_to_echo(dark_bench(), timeout=1.0) as port:
        port.write(b"one\ntwo\n")
        assert port.readline() == b"one\n"
        assert port.read_until(b"\n") == b"two\n"


def test_emptying_the_input_keeps_what_is_still_on_its_way(dark_bench: Bench) -> None:
    bench = dark_bench()
    with port_to_echo(bench, timeout=1.0) as port:
        port.write(b"old")
        bench.clock.sleep(0.3)
        port.write(b"new")
        port.reset_input_buffer()
        assert port.read(3) == b"new"


def test_one_host_at_a_time(dark_bench: Bench) -> None:
    bench = dark_bench()
    with port_to_echo(bench) as port, pytest.raises(serial.SerialException) as refused:
        serial.serial_for_url("sim://echo", exclusive=True)
    assert refused.value.errno == errno.EAGAIN
    with port_to_echo(bench) as port, pytest.raises(DeviceBusy, match="in use"):
        plug("echo", Echo(), bench)
    assert not port.is_open
    serial.serial_for_url("sim://echo").close()


def test_who_comes_between_plugging_in_and_opening_neither_gets_the_name_nor_pulls_the_cable(
    dark_bench: Bench,
) -> None:
    """As threads do that open one bench at once: the first one's scan ended with a port that went away."""
    bench, in_turn = dark_bench(), pytest.raises(DeviceBusy, match="in use")
    with plugged_in("shared", Echo(), bench, 0.0):
        with in_turn, plugged_in("shared", Echo(), dark_bench(), 0.0):
            pass
        with serial.serial_for_url("sim://shared", timeout=1.0) as port:
            port.write(b"mine")
            assert port.read(4) == b"mine"
    with plugged_in("shared", Echo(), bench, 0.0):
        assert plugged("shared").plugged


def test_nothing_plugged_in_is_a_missing_port() -> None:
    with pytest.raises(serial.SerialException) as missing:
        serial.serial_for_url("sim://nobody")
    assert missing.value.errno == errno.ENOENT


@pytest.mark.parametrize(
    ("use", "error"),
    [
        (lambda port: port.read(1), serial.SerialException),
        (lambda port: port.write(b"x"), serial.SerialException),
        (lambda port: port.in_waiting, OSError),
        (lambda port: setattr(port, "timeout", 3.0), serial.SerialException),
        (lambda port: port.flush(), Exception),
    ],
)
def test_an_unplugged_port_raises_what_a_real_one_does(
    dark_bench: Bench, use: Callable[[serial.SerialBase], object], error: type[Exception]
) -> None:
    port = port_to_echo(dark_bench(), timeout=1.0)
    unplug("echo")
    with pytest.raises(error):
        use(port)
    port.close()
    port.close()
    with pytest.raises(serial.PortNotOpenError):
        port.read(1)


def test_flushing_an_unplugged_port_is_no_oserror_on_posix(dark_bench: Bench) -> None:
    termios = pytest.importorskip("termios", reason="Windows has no termios")
    port = port_to_echo(dark_bench())
    unplug("echo")
    with pytest.raises(termios.error) as gone:
        port.flush()
    assert not isinstance(gone.value, OSError)


def test_a_port_that_takes_nothing_times_out(dark_bench: Bench) -> None:
    bench = dark_bench(Fault(name="G9"))
    with port_to_echo(bench, write_timeout=0.4) as port:
        with pytest.raises(serial.SerialTimeoutException):
            port.write(b"abc")
        assert bench.clock.now() == pytest.approx(0.4)
        assert port.write(b"abc") == 3


def test_bytes_are_counted_while_another_thread_makes_more_come(dark_bench: Bench) -> None:
    """As the thread does that closes the light of a program that hangs; none is lost, none counted twice."""
    cable, times, usual_s = SerialCable("echo", Echo(), dark_bench()), 3000, sys.getswitchinterval()

    def speak() -> None:
        for _ in range(times):
            cable.send(b"ab")
            cable.deliver()

    speaker = threading.Thread(target=speak)
    sys.setswitchinterval(1e-6)
    try:
        speaker.start()
        seen = [cable.arrived() for _ in range(times)]
        speaker.join(60)
    finally:
        sys.setswitchinterval(usual_s)
    assert seen == sorted(seen)
    assert cable.arrived() == 2 * times
    assert cable.take(2 * times) == b"ab" * times
