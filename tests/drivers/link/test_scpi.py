"""SCPI answers: blocks, error reports and what is done about them."""

from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nlos.drivers.errors import CommandRejected, DataCorrupt, DeviceTimeout, ProtocolError
from nlos.drivers.link.scpi import ErrorsReported, Scpi, ScpiError, decode_block, encode_block, split_error

GOOD = b'0,"No error"\n'


class Dialogue:
    """A link that follows a written dialogue."""

    def __init__(self, *lines: tuple[bytes, bytes | Exception]) -> None:
        self.lines = list(lines)

    def ask(self, message: bytes, timeout_s: float, expected: int = 4096) -> bytes:
        command, answer = self.lines.pop(0)
        assert message == command
        if isinstance(answer, Exception):
            raise answer
        return answer

    def clear(self) -> None:
        pass


def scpi(*lines: tuple[bytes, bytes | Exception]) -> Scpi:
    return Scpi("counter", Dialogue(*lines), 1.0)


@given(st.binary(max_size=2000), st.binary(max_size=5), st.binary(max_size=5))
def test_a_block_comes_back_from_wherever_it_stands(payload: bytes, before: bytes, after: bytes) -> None:
    block, end = decode_block(before + encode_block(payload) + after, len(before))
    assert bytes(block) == payload
    assert end == len(before) + len(encode_block(payload))


@pytest.mark.parametrize("wrong", [b"", b"#", b"#0abc", b"#x4abcd", b"#14abc", b"#2 4abcd", b"4abcd", b"#9123"])
def test_what_is_no_definite_block_is_refused(wrong: bytes) -> None:
    with pytest.raises(ValueError, match="block"):
        decode_block(wrong)


@given(st.binary(max_size=60))
def test_any_bytes_for_a_block_are_read_or_refused(answer: bytes) -> None:
    try:
        block, end = decode_block(answer)
    except ValueError:
        return
    assert answer[:end].endswith(bytes(block))


def test_the_error_report_is_split_off_even_when_its_text_holds_semicolons() -> None:
    assert split_error(b"7;8;" + GOOD) == (b"7;8", None)
    assert split_error(GOOD) == (b"", None)
    assert split_error(b'7;-222,"Data; out of ""range"""\n') == (b"7", ScpiError(-222, 'Data; out of "range"'))
    for wrong in (b"", b"7\n", b'70,"No error"\n', b"7;-222\n"):
        with pytest.raises(ValueError, match="error"):
            split_error(wrong)


def test_every_command_is_followed_by_a_look_at_the_error_queue() -> None:
    scpi((b"HIST:BINS 512;:ACQ:POIN 3;:SYST:ERR?\n", GOOD)).command(b"HIST:BINS 512", b"ACQ:POIN 3")


def test_a_refused_command_raises_with_every_error_that_waits() -> None:
    errors = [b'-222,"Data out of range"\n', b'-350,"Queue overflow"\n', GOOD]
    lines = [(b"HIST:BINS 1;:SYST:ERR?\n", errors[0]), *((b"SYST:ERR?\n", each) for each in errors[1:])]
    with pytest.raises(CommandRejected, match="-222 Data out of range, -350 Queue overflow") as caught:
        scpi(*lines).command(b"HIST:BINS 1")
    assert isinstance(caught.value, ErrorsReported)
    assert [error.code for error in caught.value.errors] == [-222, -350]


@pytest.mark.parametrize("damaged", [b'0,"No ', b"", DeviceTimeout("counter", "nothing came.")])
def test_a_damaged_report_of_an_error_is_asked_for_again_and_twice_damaged_named(damaged: bytes | Exception) -> None:
    ask = b"SYST:ERR?\n"
    lines = [(ask, damaged), (ask, b'-222,"Data out of range"\n'), (ask, GOOD)]
    assert scpi(*lines).drain_errors() == (ScpiError(-222, "Data out of range"),)
    with pytest.raises((ProtocolError, DeviceTimeout)):
        scpi(*[(ask, damaged)] * 2).drain_errors()


def test_an_error_queue_without_end_is_a_protocol_error() -> None:
    with pytest.raises(ProtocolError, match="does not end"):
        scpi(*[(b"SYST:ERR?\n", b'-200,"Execution error"\n')] * 20).drain_errors()


def test_a_lost_answer_is_asked_for_once_more_unless_that_would_do_harm() -> None:
    lost = DeviceTimeout("counter", "nothing came.")
    message = b"A?;:SYST:ERR?\n"
    assert scpi((message, lost), (message, b"7;" + GOOD)).query(b"A?") == ["7"]
    with pytest.raises(DeviceTimeout):
        scpi((message, lost), (message, lost)).query(b"A?")
    with pytest.raises(DeviceTimeout):
        scpi((b"INIT;:SYST:ERR?\n", lost)).command(b"INIT", retry=False)


@pytest.mark.parametrize(("answer", "units"), [(b"7;" + GOOD, 2), (b"7;8;" + GOOD, 1), (GOOD, 1)])
def test_an_answer_that_does_not_fit_the_question_is_a_protocol_error(answer: bytes, units: int) -> None:
    questions: Sequence[bytes] = [b"A?"] * units
    with pytest.raises(ProtocolError, match="does not answer"):
        scpi((b";:".join(questions) + b";:SYST:ERR?\n", answer)).query(*questions)


def test_a_block_is_handed_over_with_the_text_before_it_and_the_error_behind_it() -> None:
    message = b"S?;:D?;:SYST:ERR?\n"
    answer = scpi((message, b"RUN,3;#3004\n;#;;7;" + GOOD)).query_block(b"S?", b"D?", expected=4)
    assert (answer.before, bytes(answer.block or b""), answer.after, answer.error) == (b"RUN,3", b"\n;#;", b"7", None)
    answer = scpi((message, b'RUN,3;-230,"Data corrupt or stale"\n')).query_block(b"S?", b"D?", expected=4)
    assert (answer.before, answer.block, answer.after) == (b"RUN,3", None, b"")
    assert answer.error == ScpiError(-230, "Data corrupt or stale")
    for wrong in (
        b"RUN,3;#3009abcd;" + GOOD,
        b"RUN,3;#14abcde;" + GOOD,
        b"RUN,3;#0abcd;" + GOOD,
        b"RUN,3#14abcd;" + GOOD,
    ):
        with pytest.raises(DataCorrupt):
            scpi((message, wrong), (message, wrong)).query_block(b"S?", b"D?", expected=4)
