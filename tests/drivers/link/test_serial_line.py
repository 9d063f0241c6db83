"""What a serial line answers, whatever the cable does to the bytes."""

import socket
import threading
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from serial import SerialException, serial_for_url
from serial.rfc2217 import PortManager

from nlos.drivers.clock import SystemClock
from nlos.drivers.errors import DeviceBusy, DeviceLost, DeviceNotFound, DeviceTimeout, ProtocolError
from nlos.drivers.link.serial_line import SerialLine, available_ports
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plug, plugged, unplug

Bench = Callable[..., SimulatedBench]
TIMEOUT_S = 0.5


class Repeater:
    """Says every command again in capitals."""

    def opened(self) -> bytes:
        return b""

    def reboot(self) -> bytes:
        return b"I AM NEW\r\n"

    def receive(self, data: bytes, when_s: float) -> bytes:
        return data.strip().upper() + b"\r\n"


def prove(line: SerialLine, stale: bytes) -> None:
    line.write(b"who\n")
    line.receive(lambda reply: reply == b"WHO")


def line_to_repeater(bench: SimulatedBench, latency_s: float = 0.001, wire_log: object = None) -> SerialLine:
    unplug("repeater")
    url = plug("repeater", Repeater(), bench, latency_s)
    return SerialLine.open(
        "repeater",
        url,
        bench.clock,
        baud=9600,
        timeout_s=TIMEOUT_S,
        resynchronise=prove,
        wire_log=wire_log,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize("size", [1, 7, 512])
def test_a_reply_in_pieces_is_put_together(dark_bench: Bench, chopped: Callable[..., object], size: int) -> None:
    line = line_to_repeater(dark_bench())
    plugged("repeater").mangle = chopped(size)  # type: ignore[assignment]
    assert line.exchange(b"a rather long command\n") == b"A RATHER LONG COMMAND"
    assert line.exchange(b"b\n") == b"B"


def test_no_reply_is_a_timeout_at_the_deadline(dark_bench: Bench) -> None:
    bench = dark_bench(Fault(name="G1"))
    line = line_to_repeater(bench)
    with pytest.raises(DeviceTimeout, match=r"repeater: b'one\\n' was not answered in time"):
        line.exchange(b"one\n")
    assert bench.clock.now() == pytest.approx(TIMEOUT_S, rel=0.2)
    assert line.exchange(b"two\n") == b"TWO"


@pytest.mark.parametrize("delay_s", [0.5, 0.52, 0.6, 1.0])
def test_a_late_reply_is_never_the_next_commands(dark_bench: Bench, delay_s: float) -> None:
    line = line_to_repeater(dark_bench(Fault(name="G2", parameters={"delay_s": delay_s})))
    with pytest.raises(DeviceTimeout):
        line.exchange(b"one\n")
    assert line.exchange(b"two\n") == b"TWO"
    assert line.exchange(b"three\n") == b"THREE"


def test_a_reply_that_stops_half_way_is_a_timeout_that_shows_the_half(dark_bench: Bench) -> None:
    line = line_to_repeater(dark_bench(Fault(name="G3", parameters={"at": 2, "delay_s": 9.0})))
    with pytest.raises(DeviceTimeout, match=r"only b'ON' came"):
        line.exchange(b"one\n")


@pytest.mark.parametrize("kind", ["noise", "nul", "non_ascii", "overlong"])
def test_garbage_is_a_protocol_error_and_the_next_command_is_answered(dark_bench: Bench, kind: str) -> None:
    line = line_to_repeater(dark_bench(Fault(name="G4", parameters={"kind": kind})))
    with pytest.raises(ProtocolError):
        line.exchange(b"one\n")
    assert line.exchange(b"two\n") == b"TWO"


def test_an_overlong_reply_is_not_collected_for_ever(dark_bench: Bench) -> None:
    received: list[int] = []
    bench = dark_bench(Fault(name="G4", parameters={"kind": "overlong"}))
    line = line_to_repeater(bench, wire_log=lambda device, way, data: received.append(len(data)))
    with pytest.raises(ProtocolError, match="more than 256 bytes without an end"):
        line.exchange(b"one\n")
    assert sum(received) < 10_000


@pytest.mark.parametrize("operation", ["read", "write", "in_waiting", "configure"])
def test_an_unplugged_cable_is_lost_whichever_call_notices(dark_bench: Bench, operation: str) -> None:
    line = line_to_repeater(dark_bench(Fault(name="G8", parameters={"place": operation})))
    for _ in range(2):
        with pytest.raises(DeviceLost, match="went away"):
            line.exchange(b"two\n")
    line.close()
    line.close()


def test_a_closed_line_says_so(dark_bench: Bench) -> None:
    line = line_to_repeater(dark_bench())
    line.close()
    with pytest.raises(DeviceLost, match="closed"):
        line.exchange(b"one\n")


def test_a_stalled_write_is_a_timeout(dark_bench: Bench) -> None:
    line = line_to_repeater(dark_bench(Fault(name="G9")))
    with pytest.raises(DeviceTimeout, match="could not be sent"):
        line.exchange(b"one\n")
    assert line.exchange(b"two\n") == b"TWO"


@pytest.mark.parametrize(
    ("kind", "error", "text"),
    [
        ("busy", DeviceBusy, "another program holds sim://repeater"),
        ("permission", DeviceBusy, "may not open sim://repeater.*dialout"),
        ("missing", DeviceNotFound, "no port sim://repeater.*Ports of this computer"),
    ],
)
def test_a_port_that_does_not_open_says_what_to_do(
    dark_bench: Bench, kind: str, error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        line_to_repeater(dark_bench(Fault(name="G10", parameters={"kind": kind})))


@pytest.mark.parametrize("url", ["/dev/no-such-port", "sim://nobody", "unheard://of"])
def test_a_port_that_does_not_exist_is_not_found(url: str) -> None:
    with pytest.raises(DeviceNotFound, match="Ports of this computer"):
        SerialLine.open("galvo", url, SystemClock(), baud=9600, timeout_s=0.1, resynchronise=prove)


@pytest.mark.filterwarnings("ignore:set:DeprecationWarning")  # pyserial's own thread
def test_a_port_without_a_write_deadline_is_refused_by_name() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def share_a_port() -> None:
            connection, _ = server.accept()
            with connection, serial_for_url("loop://") as shared:
                manager = PortManager(shared, SimpleNamespace(write=connection.sendall))
                while data := connection.recv(1024):
                    list(manager.filter(data))

        sharing = threading.Thread(target=share_a_port, daemon=True)
        sharing.start()
        url = f"rfc2217://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(DeviceNotFound, match=r"rfc2217://.* cannot be used.*no deadline.*raw TCP.*socket://"):
            SerialLine.open("galvo", url, SystemClock(), baud=9600, timeout_s=1.0, resynchronise=prove)
        sharing.join(10.0)


def test_words_nobody_asked_for_are_thrown_away_before_the_next_command(dark_bench: Bench) -> None:
    bench = dark_bench()
    line = line_to_repeater(bench)
    assert line.exchange(b"one\n") == b"ONE"
    plugged("repeater")._reply(b"ONE\r\nnoise\xff", bench.clock.now())
    assert line.exchange(b"two\n") == b"TWO"


def test_every_byte_is_in_the_wire_log(dark_bench: Bench) -> None:
    log: list[tuple[str, str, bytes]] = []
    line = line_to_repeater(dark_bench(), wire_log=lambda *entry: log.append(entry))
    line.exchange(b"one\n")
    assert log[0] == ("repeater", ">", b"one\n")
    assert b"".join(data for _, way, data in log if way == "<") == b"ONE\r\n"


def test_an_interjected_command_lets_the_one_in_flight_keep_its_reply(dark_bench: Bench) -> None:
    """As from a signal handler: in the middle of an exchange another command is sent and confirmed."""
    line = line_to_repeater(dark_bench(), latency_s=0.02)
    done: list[str] = []

    def interrupt(device: str, way: str, data: bytes) -> None:
        if way == ">" and data == b"one\n":
            interrupted.append(True)

    interrupted: list[bool] = []
    fill = line._fill

    def fill_interrupted(timeout_s: float) -> int:
        if interrupted and not done:
            done.append("")
            line.interject(b"now\n", b"NOW")
        return fill(timeout_s)

    line._wire_log = interrupt
    line._fill = fill_interrupted  # type: ignore[method-assign]
    assert line.exchange(b"one\n") == b"ONE"
    assert done


def test_an_interjected_command_that_is_not_confirmed_is_a_timeout(dark_bench: Bench) -> None:
    bench = dark_bench(Fault(name="G1"))
    line = line_to_repeater(bench)
    with pytest.raises(DeviceTimeout, match="not confirmed"):
        line.interject(b"now\n", b"NOW")
    assert bench.clock.now() <= 0.11


def test_an_old_reply_does_not_confirm_an_interjected_command(dark_bench: Bench) -> None:
    bench = dark_bench(Fault(name="G1"))
    line = line_to_repeater(bench)
    plugged("repeater")._reply(b"NOW\r\n", bench.clock.now())
    with pytest.raises(DeviceTimeout, match="not confirmed"):
        line.interject(b"now\n", b"NOW")


def test_a_device_that_never_stops_talking_is_a_timeout(dark_bench: Bench, chopped: Callable[..., object]) -> None:
    bench = dark_bench()
    line = line_to_repeater(bench)
    cable = plugged("repeater")
    cable.mangle = chopped(6, gap_s=0.005)  # type: ignore[assignment]
    for act in (
        lambda: line.receive(lambda reply: reply == b"WHO"),
        lambda: line.interject(b"now\n", b"NOW"),
        lambda: line.exchange(b"one\n"),
    ):
        cable._reply(b"BLAH\r\n" * 400, bench.clock.now())
        began_s = bench.clock.now()
        with pytest.raises(DeviceTimeout):
            act()
        assert bench.clock.now() - began_s < 3 * TIMEOUT_S


def test_this_computers_ports_can_be_listed() -> None:
    assert all(port.port for port in available_ports())


def test_unplugging_nothing_is_fine() -> None:
    unplug("nobody")


def test_bytes_that_a_signal_handler_took_from_a_read_are_no_lost_cable(dark_bench: Bench) -> None:
    """pyserial is told that bytes are there, a signal handler's own exchange takes them, and then it reads none."""
    line = line_to_repeater(dark_bench())
    port, told = line._port, "device reports readiness to read but returned no data"

    class Interrupted:
        done = False

        def __getattr__(self, name: str) -> object:
            return getattr(port, name)

        def __setattr__(self, name: str, value: object) -> None:
            setattr(type(self) if name == "done" else port, name, value)

        def read(self, size: int) -> bytes:
            if not self.done:
                self.done = True
                line.interject(b"now\n", b"NOW")
                raise SerialException(told)
            return bytes(port.read(size))

    line._port = Interrupted()
    assert line.exchange(b"one\n") == b"ONE"
    assert line.exchange(b"two\n") == b"TWO"

    def gone(size: int) -> bytes:
        raise SerialException(told)

    line._port.read = gone
    with pytest.raises(DeviceLost, match="went away"):
        line.exchange(b"three\n")


def test_lines_without_cr_are_told_from_silence(dark_bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Repeater, "receive", lambda self, data, when_s: data.strip().upper() + b"\n")
    with pytest.raises(DeviceTimeout, match="end without CR"):
        line_to_repeater(dark_bench()).transact(b"one\n")
