"""What leaves a serial line out of step, and that the next command is answered by its own reply all the same."""

import threading

import pytest

from nlos.drivers.errors import DeviceTimeout
from nlos.drivers.simulated.serial.port import plugged
from tests.drivers.link.test_serial_line import Bench, Repeater, line_to_repeater


def test_what_came_along_with_a_reply_answers_nothing(dark_bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both in one read: the port has nothing more to say when the next command is sent."""
    line, more = line_to_repeater(dark_bench()), [b"STALE\r\n"]
    monkeypatch.setattr(
        Repeater, "receive", lambda self, data, when_s: data.strip().upper() + b"\r\n" + (more.pop() if more else b"")
    )
    assert [line.exchange(command) for command in (b"one\n", b"two\n", b"three\n")] == [b"ONE", b"TWO", b"THREE"]


def test_an_exchange_that_is_cut_short_leaves_the_line_out_of_step(dark_bench: Bench) -> None:
    def cut(buffer: bytearray) -> bytes:
        raise KeyboardInterrupt

    line = line_to_repeater(dark_bench())
    with pytest.raises(KeyboardInterrupt):
        line.exchange(b"one\n", take=cut)
    assert not line.in_step
    assert line.exchange(b"two\n") == b"TWO"
    assert line.in_step


def test_half_a_command_is_said_until_the_line_is_in_step_again(dark_bench: Bench) -> None:
    line = line_to_repeater(dark_bench())
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(line._port, "write", lambda data: len(data) - 1)
        with pytest.raises(DeviceTimeout, match="only 3 of 4 bytes could be sent"):
            line.exchange(b"one\n")
    assert line.half_sent
    assert line.exchange(b"two\n") == b"TWO"
    assert not line.half_sent


def test_a_line_that_did_not_come_in_time_may_come_yet(dark_bench: Bench) -> None:
    line = line_to_repeater(dark_bench())
    with pytest.raises(DeviceTimeout, match="did not come in time"):
        line.receive(lambda reply: reply == b"DONE")
    assert not line.in_step


def test_a_proof_that_fails_is_none(dark_bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line := line_to_repeater(dark_bench()), "_resynchronise", lambda line, stale: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        line.resynchronise()
    assert not line.in_step


def test_a_reply_that_comes_before_an_interjected_commands_is_kept(dark_bench: Bench) -> None:
    """Later than it is waited for: the command that cannot wait has been sent by then."""
    bench = dark_bench()
    line = line_to_repeater(bench, latency_s=0.02)
    fill, done = line._fill, []

    def fill_interrupted(timeout_s: float) -> int:
        if not done:
            done.append("")
            cable._reply(b"ONE\r\n", bench.clock.now() + 0.06)
            line.interject(b"now\n", b"NOW")
        return fill(timeout_s)

    cable = plugged("repeater")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(line, "_fill", fill_interrupted)
        patched.setattr(Repeater, "receive", lambda self, data, when_s: b"NOW\r\n" if b"now" in data else b"")
        assert line.exchange(b"one\n") == b"ONE"


def test_a_command_that_cannot_wait_is_sent_over_a_line_that_is_busy(dark_bench: Bench) -> None:
    """As when another thread hangs within an exchange: the light is shut all the same, though nothing confirms it."""
    sent: list[bytes] = []
    line = line_to_repeater(dark_bench(), wire_log=lambda device, way, data: sent.append(data) if way == ">" else None)
    held, let_go = threading.Event(), threading.Event()

    def hold() -> None:
        with line._lock:
            held.set()
            let_go.wait(60.0)

    other = threading.Thread(target=hold)
    other.start()
    try:
        held.wait(60.0)
        with pytest.raises(DeviceTimeout, match="was sent over a busy line and not confirmed"):
            line.interject(b"now\n", b"NOW", 0.01)
    finally:
        let_go.set()
        other.join()
    assert sent == [b"now\n"]


def test_what_was_thrown_away_for_an_interjected_command_leaves_the_line_out_of_step(dark_bench: Bench) -> None:
    bench = dark_bench()
    line = line_to_repeater(bench)
    plugged("repeater")._reply(b"OLD\r\n", bench.clock.now())
    bench.clock.sleep(0.01)
    line.interject(b"now\n", b"NOW")
    assert not line.in_step
