"""The simulated TriggerScope has every trap of the real one."""

import math
from collections.abc import Callable

import pytest

from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.servo import ServoSettings
from nlos.drivers.simulated.triggerscope.firmware import TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.wiring import Wiring

BANNER = b"ARC TRIGGERSCOPE 16 R4 Board 4B v.620-MM\r\n"
FULL_SCALE_RAD = 2.0 * math.radians(20.0)


@pytest.fixture
def bench(dark_bench: Callable[..., SimulatedBench]) -> SimulatedBench:
    return dark_bench()


@pytest.fixture
def say(bench: SimulatedBench) -> Callable[[bytes], bytes]:
    firmware = TriggerScopeFirmware(bench, Wiring(bench))
    return lambda data: firmware.receive(data, bench.clock.now())


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (b"*\n", BANNER),
        (b"SAR3-5\n", b"!SAR3-5\r\n"),
        (b"SAO16-65535\n", b"!SAO16-65535\r\n"),
        (b"PAN2\n", b"!PAN2-1200\r\n"),
        (b"PAC2\n", b"!PAC2\r\n"),
        (b"PAO2-10-1-2-3\n", b"!PAO2-10-3-13\r\n"),
        (b"PAS2-1-1\n", b"!PAS2-1-1\r\n"),
        (b"BAO2-0-1\n", b"!BAO2-0-1\r\n"),
        (b"BAD2-500\n", b"!BAD2-500\r\n"),
        (b"BDO1-0-1\n", b"!BDO1-0-1\r\n"),
        (b"CLEAR_ALL\n", b"!CLEAR_ALL\r\n"),
        (b"CLEAR_DAC 3\n", b"!CLEAR_DAC,3\r\n"),
        (b"SDO1-255\n", b"!SDO1-255\r\n"),
        (b"PDN0\n", b"!PDN0-1200\r\n"),
        (b"PDO0-0-1-2\n", b"!PDO0-0-2-2\r\n"),
        (b"PDC0\n", b"!PDC0\r\n"),
        (b"PDS0-0-1\n", b"!PDS0-0-1\r\n"),
        (b"SSL0\n", b"!SSL0\r\n"),
    ],
)
def test_commands_are_echoed_behind_an_exclamation_mark(
    say: Callable[[bytes], bytes], command: bytes, reply: bytes
) -> None:
    assert say(command) == reply


@pytest.mark.parametrize("command", [b"sao1-100\n", b"*\r\n", b"?\r\n", b"\n", b"\0*\n"])
def test_what_it_does_not_know_has_no_exclamation_mark(say: Callable[[bytes], bytes], command: bytes) -> None:
    assert say(command) == b"ERROR_UNKNOWN_COMMAND\r\n"


@pytest.mark.parametrize("command", [b"SAO1-65536\n", b"SAR1-6\n", b"SAO17-0\n", b"SAO1\n", b"PAO1-0\n", b"SDO0-256\n"])
def test_bad_arguments_are_errors_with_the_commands_name(say: Callable[[bytes], bytes], command: bytes) -> None:
    assert say(command).startswith(b"!ERROR_" + command[:3] + b":")


def test_the_help_ends_with_an_empty_line(say: Callable[[bytes], bytes]) -> None:
    assert say(b"?\n").endswith(b"\r\n\r\n")


def test_of_two_commands_in_one_packet_the_second_is_lost(bench: SimulatedBench, say: Callable[[bytes], bytes]) -> None:
    say(b"SAR1-4\n")
    say(b"SAR2-4\n")
    assert say(b"SAO1-49152\nSAO2-49152\n") == b"!SAO1-49152\r\n"
    assert bench.beam.x_rad == pytest.approx(FULL_SCALE_RAD / 2)
    assert bench.beam.y_rad == pytest.approx(0.0, abs=1e-4)


def test_a_command_may_come_in_pieces(say: Callable[[bytes], bytes]) -> None:
    assert [say(piece) for piece in (b"SA", b"O1-", b"7", b"\n")] == [b"", b"", b"", b"!SAO1-7\r\n"]


def test_setting_a_range_centres_its_output_and_throws_every_other_to_code_0(
    bench: SimulatedBench, say: Callable[[bytes], bytes]
) -> None:
    say(b"SAR1-4\n")
    say(b"SAO1-65535\n")
    assert bench.beam.x_rad == pytest.approx(FULL_SCALE_RAD, rel=1e-4)
    say(b"SAR1-4\n")
    assert bench.beam.x_rad == pytest.approx(0.0, abs=1e-4)
    say(b"SAR2-4\n")
    assert bench.beam.x_rad == pytest.approx(-FULL_SCALE_RAD)
    assert bench.beam.y_rad == pytest.approx(0.0, abs=1e-4)
    say(b"BAO1-0-0\n")  # shows again what SAR had noted as its value
    assert bench.beam.x_rad == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (b"SAO1-007 and more\n", b"!SAO1-7\r\n"),
        (b"SAO257-5\n", b"!ERROR_SAO: "),  # no separator behind one or two digits
        (b"SDO256-7\n", b"!SDO0-6\r\n"),  # 256 is 0 in 8 bits, and the value begins at the sixth character
        (b"SDO\n", b"!SDO0-0\r\n"),
        (b"SAR1,4\n", b"!SAR1-4\r\n"),
        (b"PAO1--5--6-\n", b"!PAO1-0-2-2\r\n"),
        (b"PAO1-5\n", b"!ERROR_PAO: "),
        (b"PDSxx1x1\n", b"!PDS0-1-1\r\n"),
        (b"PDS1-1-1 \n", b"!ERROR_PDS: "),  # a length that it does not expect
        (b"PAS1-1-1*\n", b"!PAS1-1-1\r\n"),
        (b"BAL99-1\n", b"!ERROR_BAD: "),  # the name in this text is the firmware's own mistake
        (b"BAD1--1\n", b"!BAD1-4294967295\r\n"),
        (b"SSL256\n", b"!SSL0\r\n"),
        (b"SA\0O1-5\n", b"ERROR_UNKNOWN_COMMAND\r\n"),
    ],
)
def test_malformed_lines_are_answered_as_the_firmware_answers_them(
    say: Callable[[bytes], bytes], command: bytes, reply: bytes
) -> None:
    assert say(command).startswith(reply)


def test_a_cleared_table_slams_the_mirror_to_full_scale(bench: SimulatedBench, say: Callable[[bytes], bytes]) -> None:
    for command in (b"SAR1-4\n", b"PAO1-0-40000-50000\n", b"PAC1\n", b"PAS1-1-1\n"):
        say(command)
    assert bench.beam.x_rad == pytest.approx(0.0, abs=1e-4)
    bench.edge("pixel_clock", bench.clock.now())
    assert bench.beam.x_rad == pytest.approx(-FULL_SCALE_RAD)


def test_stepping_starts_at_the_first_edge_and_wraps(bench: SimulatedBench, say: Callable[[bytes], bytes]) -> None:
    for command in (b"SAR1-4\n", b"PAO1-0-40000-50000-60000\n", b"PAS1-1-1\n"):
        say(command)
    seen = []
    for _ in range(4):
        bench.edge("pixel_clock", bench.clock.now())
        seen.append(round((bench.beam.x_rad / FULL_SCALE_RAD + 1.0) * 32768))
    assert seen == [40000, 50000, 60000, 40000]


def test_falling_edges_apply_the_first_state_at_once(bench: SimulatedBench, say: Callable[[bytes], bytes]) -> None:
    for command in (b"SAR1-4\n", b"PAO1-0-65535-0\n", b"PAS1-1-0\n"):
        say(command)
    assert bench.beam.x_rad == pytest.approx(FULL_SCALE_RAD, rel=1e-4)


@pytest.mark.parametrize(
    ("command", "reply"),
    [
        (b"PAO1-1199-1-2\n", b"!PAO1-1199-2-1201\r\n"),
        (b"PDO1-1199-1-2\n", b"!PDO1-1199-2-1201\r\n"),
        (b"PAO16-1100-" + b"-".join([b"1"] * 100) + b"\n", b"!PAO16-1100-100-1200\r\n"),
    ],
    ids=["table", "masks", "reply buffer"],
)
def test_overrunning_its_memory_is_confirmed_and_ends_it(
    say: Callable[[bytes], bytes], command: bytes, reply: bytes
) -> None:
    assert say(command) == reply
    assert say(b"*\n") == b""


def test_a_table_without_length_is_stepped_through_to_its_end_and_beyond(
    bench: SimulatedBench, say: Callable[[bytes], bytes]
) -> None:
    for command in (b"SAR1-4\n", b"PAO1-0-40000-50000\n", b"PAC1\n", b"PAS1-1-1\n"):
        say(command)
    for _ in range(1200):
        bench.edge("pixel_clock", bench.clock.now())
    assert bench.beam.x_rad == pytest.approx(-FULL_SCALE_RAD)
    bench.edge("pixel_clock", bench.clock.now())  # memory that is not the table's: the worst is assumed
    assert bench.beam.x_rad == pytest.approx(FULL_SCALE_RAD, rel=1e-4)


def test_what_a_program_leaves_outlives_its_port(bench: SimulatedBench) -> None:
    firmware = TriggerScopeFirmware(bench, Wiring(bench, shutter_pin=9))
    assert firmware.opened() == b"done.\r\n" + BANNER
    for command in (b"PDO1-0-1-0\n", b"PDS1-1-1\n", b"PAO1-0"):
        firmware.receive(command, 0.0)
    assert firmware.opened() == b""
    bench.edge("pixel_clock", 0.0)
    assert bench.shutter_open
    assert firmware.receive(b"*\n", 0.0).startswith(b"!ERROR_PAO:")
    assert firmware.receive(b"*\n", 0.0) == BANNER


@pytest.mark.parametrize(("inverse", "levels"), [(0, [False, True, False]), (1, [True, False, True])])
def test_blanked_outputs_follow_the_level_of_the_trigger_input(
    bench: SimulatedBench, inverse: int, levels: list[bool]
) -> None:
    firmware = TriggerScopeFirmware(bench, Wiring(bench, shutter_pin=9))
    for command in (b"SDO1-1\n", b"BDO1-1-%d\n" % inverse):
        firmware.receive(command, 0.0)
    seen = [bench.shutter_open]
    bench.edge("pixel_clock", 0.0, width_s=0.01)
    seen.append(bench.shutter_open)
    bench.clock.sleep(0.02)
    assert [*seen, bench.shutter_open] == levels


def test_a_pulse_shorter_than_its_loop_is_not_seen(bench: SimulatedBench, say: Callable[[bytes], bytes]) -> None:
    for command in (b"PDO0-0-1-2\n", b"PDS0-1-1\n"):
        say(command)
    steps: list[float] = []
    bench.wire("marker_1", steps.append)
    bench.edge("pixel_clock", 1.0, width_s=5e-6)
    assert steps == []
    bench.edge("pixel_clock", 2.0, width_s=20e-6)
    assert steps == [2.0]


def test_without_sd_card_every_command_is_confirmed_and_nothing_moves(bench: SimulatedBench) -> None:
    firmware = TriggerScopeFirmware(bench, sd_card=False)
    assert firmware.opened() == b""
    assert firmware.receive(b"SAR1-4\n", 0.0) == b"!SAR1-4\r\n"
    assert firmware.receive(b"SAO1-0\n", 0.0) == b"!SAO1-0\r\n"
    assert bench.beam.x_rad == 0.0


def test_analogue_blanking_is_full_scale_on_a_mirror(bench: SimulatedBench, say: Callable[[bytes], bytes]) -> None:
    say(b"SAR1-4\n")
    say(b"BAO1-1-0\n")
    assert bench.beam.x_rad == pytest.approx(-FULL_SCALE_RAD)


def test_the_beam_is_on_its_way_until_the_head_has_settled(bench: SimulatedBench) -> None:
    firmware = TriggerScopeFirmware(bench, Wiring(bench, servo=ServoSettings()))
    firmware.receive(b"SAR1-4\n", 0.0)
    bench.clock.sleep(1.0)
    start_rad = bench.beam.x_rad
    firmware.receive(b"SAO1-65535\n", bench.clock.now())
    assert bench.beam_at(1.0).x_rad == start_rad
    assert start_rad < bench.beam_at(1.003).x_rad < FULL_SCALE_RAD * 0.99
    assert bench.beam_at(1.0077).x_rad == pytest.approx(FULL_SCALE_RAD, rel=1e-4)


def test_a_pin_drives_the_shutter(bench: SimulatedBench) -> None:
    firmware = TriggerScopeFirmware(bench, Wiring(bench, shutter_pin=9))
    firmware.receive(b"SDO1-1\n", 0.0)
    assert bench.shutter_open
    firmware.receive(b"SDO1-0\n", 0.0)
    assert not bench.shutter_open
    firmware.receive(b"SDO1-1\n", 0.0)
    firmware.reboot()
    assert not bench.shutter_open
