"""The Optotune driver: its codec, its dialogue, and every fault of rows G and B with the driver's answer."""

import math
import struct
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from nlos.drivers.errors import (
    CommandRejected,
    DeviceError,
    DeviceFault,
    DeviceReset,
    DeviceTimeout,
    LimitError,
    ProtocolError,
    SettleTimeout,
    WrongDevice,
)
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.optotune import wire
from nlos.drivers.galvo.optotune.mirror import Optotune, OptotuneSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.optotune import pro_mode
from nlos.drivers.simulated.optotune.firmware import OptotuneFirmware
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from tests.drivers.later import AFTER_OPENING_S, later

ASIDE = MirrorAngles(0.1, -0.05)
Lab = Callable[..., tuple[SimulatedBench, Optotune]]


@pytest.fixture
def lab(dark_bench: Callable[..., SimulatedBench]) -> Lab:
    """lab(*faults, **settings): a bench with an opened mirror; the clock stands where `after_s` faults begin."""

    def make(
        *faults: Fault, pro_mode: bool = False, model: bytes = b"MR-E-3", chop: object = None, **settings: object
    ) -> tuple[SimulatedBench, Optotune]:
        bench = dark_bench(*faults)
        unplug("steered")
        url = plug("steered", OptotuneFirmware(bench, left_in_pro_mode=pro_mode, model=model), bench, 0.001)
        plugged("steered").mangle = chop
        mirror = Optotune.open(OptotuneSettings(model="optotune", port=url, **settings), bench.clock)
        bench.clock.advance_to(AFTER_OPENING_S)
        return bench, mirror

    return make


@pytest.mark.parametrize("size", [1, 7, 512])
def test_replies_in_pieces_change_nothing(lab: Lab, chopped: Callable[..., object], size: int) -> None:
    bench, mirror = lab(chop=chopped(size))
    mirror.move_to(ASIDE)
    assert bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=1e-5)
    assert mirror.measured().x_rad == pytest.approx(ASIDE.x_rad, abs=1e-5)
    assert mirror.identity.product == "MR-E-3"


def test_a_written_dialogue(dark_bench: Callable[..., SimulatedBench], transcript: Callable[..., object]) -> None:
    ask_centre, centre = (
        b"~\0\x13\x06\0\x02\x23\x02\x23\x03\0\0~",
        wire.encode_frame(0x13, b"\0\2" + bytes(8), crc=True),
    )
    opening = [
        (b"START\r\n", b"OK\r\n"),
        (b"GETID\r\n", b"MR-E-2\r\n"),
        *2 * [(b"GETID\r\n", b"MR-E-2\r\n"), (b"GETVERSION\r\n", b"1.0\r\n"), (b"GETSN\r\n", b"ABC\r\n")],
        (b"STATUS\r\n", b"00000000\r\n"),
        (b"XY=0.000000;0.000000\r\n", b"OK\r\n"),
        (b"STATUS\r\n", b"00000010\r\n"),
        (b"STATUS\r\n", b"00000000\r\n"),
        (b"STATUS\r\n", b"00000000\r\n"),
        (b"GOPRO\r\n", b"OK\r\n"),
        (ask_centre, centre),
        (b"~\0\x06\x02\0\0\0\0~", wire.encode_frame(0x06, crc=True)),
        (b"START\r\n", b"NO\r\n"),
        (b"START\r\n", b"OK\r\n"),
        (b"GETID\r\n", b"MR-E-2\r\n"),
    ]
    device = transcript([*opening, (b"XY=0.305407;0.000000\r\n", b"OK\r\n")])
    bench = dark_bench()
    unplug("written")
    mirror = Optotune.open(OptotuneSettings(model="optotune", port=plug("written", device, bench)), bench.clock)
    mirror.begin_move(MirrorAngles(math.radians(20.0), 0.0))
    assert device.finished
    assert (mirror.identity.serial, mirror.identity.firmware) == ("ABC", "1.0")


PUBLISHED = {  # frames as the vendor's SDK makes and reads them
    "one register asked for": (wire.get_registers(0x5001), "7E 00 11 02 50 01 00 00 7E"),
    "its reply, 0.0": (wire.encode_frame(wire.GET_VALUE, bytes(4), crc=True), "7E 00 11 04 00 00 00 00 F2 81 7E"),
    "two registers asked for": (wire.get_registers(0x3B00, 0x3B01), "7E 00 13 06 00 02 3B 00 3B 01 00 00 7E"),
    "back to Simple mode": (wire.to_simple(), "7E 00 06 02 00 00 00 00 7E"),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_frames_are_the_published_ones(name: str) -> None:
    frame, published = PUBLISHED[name]
    assert frame == bytes.fromhex(published)


def test_the_published_reply_is_read_and_no_other_checksum_is() -> None:
    reply = bytes.fromhex(PUBLISHED["its reply, 0.0"][1])
    assert wire.decode_frame(reply) == (wire.GET_VALUE, bytes(4))
    with pytest.raises(ValueError, match="its CRC is 0000"):
        wire.decode_frame(bytes.fromhex("7E 00 11 04 00 00 00 00 00 00 7E"))


def test_the_checksum_is_crc_16_arc() -> None:
    assert wire.crc_16(b"123456789") == 0xBB3D  # the check value of every catalogue of CRCs
    assert pro_mode.checksum(b"123456789") == b"\x3d\xbb"


@pytest.mark.parametrize("name", [name for name in PUBLISHED if name != "its reply, 0.0"])
def test_the_simulated_controller_answers_the_published_requests(
    dark_bench: Callable[..., SimulatedBench], name: str
) -> None:
    firmware = OptotuneFirmware(dark_bench())
    assert firmware.receive(b"START\r\nGOPRO\r\n", 0.0) == b"OK\r\nOK\r\n"
    answer = firmware.receive(bytes.fromhex(PUBLISHED[name][1]), 0.0)
    expected = {
        "one register asked for": PUBLISHED["its reply, 0.0"][0],
        "two registers asked for": wire.encode_frame(0x13, b"\0\2" + bytes(8), crc=True),
        "back to Simple mode": wire.encode_frame(0x06, crc=True),
    }
    assert answer == expected[name]
    simple = firmware.receive(b"START\r\n", 0.0)
    assert simple == (b"NO\r\n" if name == "back to Simple mode" else b"")  # Pro mode knows no lines


@pytest.mark.parametrize(
    "request_",
    [
        "7E 00 06 01 00 00 00 7E",  # one byte is no comm mode
        "7E 00 11 04 3B 00 3B 01 00 00 7E",  # GET_VALUE takes one register
        "7E 00 13 06 00 03 3B 00 3B 01 00 00 7E",  # another count
        "7E 00 11 02 23 02 00 00 7E",  # a register of the MR-E-2
    ],
)
def test_the_simulated_controller_refuses_what_the_vendors_would(
    dark_bench: Callable[..., SimulatedBench], request_: str
) -> None:
    firmware = OptotuneFirmware(dark_bench())
    firmware.receive(b"GOPRO\r\n", 0.0)
    request = bytes.fromhex(request_)
    command, _ = wire.decode_frame(firmware.receive(request, 0.0))
    assert command == request[2] | wire.REFUSED


def test_after_goprocrc_a_request_without_checksum_is_not_answered(dark_bench: Callable[..., SimulatedBench]) -> None:
    firmware = OptotuneFirmware(dark_bench())
    firmware.receive(b"GOPROCRC\r\n", 0.0)
    assert firmware.receive(wire.get_registers(0x5001), 0.0) == b""
    asked = wire.encode_frame(wire.GET_VALUE, b"\x50\x01", crc=True)
    assert firmware.receive(asked, 0.0) == PUBLISHED["its reply, 0.0"][0]


@pytest.mark.parametrize("controller", ["MR-E-2", "MR-E-3"])
def test_either_controller_is_opened_moved_and_read_back(lab: Lab, controller: str) -> None:
    bench, mirror = lab(model=controller.encode(), controller=controller, readback=True)
    assert mirror.identity.product == controller
    for angles in (ASIDE, MirrorAngles(-0.3, 0.2), MirrorAngles(0.0, 0.0)):
        mirror.move_to(angles)
        assert bench.beam.x_rad == pytest.approx(angles.x_rad, abs=1e-5)
        measured = mirror.measured()
        assert (measured.x_rad, measured.y_rad) == pytest.approx((angles.x_rad, angles.y_rad), abs=1e-5)
    assert not mirror.warnings


def test_a_controller_that_names_itself_otherwise_the_second_time_is_not_believed(
    dark_bench: Callable[..., SimulatedBench], transcript: Callable[..., object]
) -> None:
    named = [(b"GETID\r\n", b"MR-E-2\r\n"), (b"GETVERSION\r\n", b"1.0\r\n"), (b"GETSN\r\n", b"ABC\r\n")]
    device = transcript([(b"START\r\n", b"OK\r\n"), (b"GETID\r\n", b"MR-E-3\r\n"), *2 * named])
    bench = dark_bench()
    unplug("wavering")
    url = plug("wavering", device, bench)
    with pytest.raises(ProtocolError, match="identified itself as MR-E-3, then as b'MR-E-2'"):
        Optotune.open(OptotuneSettings(model="optotune", port=url), bench.clock)


@pytest.mark.parametrize("controller", ["MR-E-2", "MR-E-3"])
def test_another_controller_than_the_bench_file_names_is_refused(lab: Lab, controller: str) -> None:
    other = b"MR-E-3" if controller == "MR-E-2" else b"MR-E-2"
    with pytest.raises(WrongDevice, match=f"names an {controller}"):
        lab(model=other, controller=controller)
    assert not plugged("steered").held


@pytest.mark.parametrize("controller", ["auto", "MR-E-2", "MR-E-3"])
def test_the_simulated_controller_is_the_one_that_the_bench_file_names(
    dark_bench: Callable[..., SimulatedBench], controller: str
) -> None:
    bench = dark_bench()
    settings = OptotuneSettings(model="optotune", port="sim://named", controller=controller)
    unplug("named")
    plug("named", OptotuneFirmware.matching(bench, settings), bench)
    mirror = Optotune.open(settings, bench.clock)
    assert mirror.identity.product == ("MR-E-3" if controller == "auto" else controller)


@given(st.binary(max_size=200))
def test_frames_come_back_whatever_they_hold(payload: bytes) -> None:
    frame = wire.encode_frame(0x11, payload, crc=True)
    assert frame.count(b"~") == 2
    buffer = bytearray(frame + b"rest")
    taken = wire.take_frame(buffer)
    assert taken == frame
    assert wire.decode_frame(taken) == (0x11, payload)
    assert buffer == b"rest"
    assert pro_mode.pack(0x11, payload) == frame


@given(st.binary(max_size=40), st.data())
def test_a_changed_bit_in_a_frame_is_never_read(payload: bytes, data: st.DataObject) -> None:
    frame = bytearray(wire.encode_frame(0x11, payload, crc=True))
    at = data.draw(st.integers(1, len(frame) - 2))
    frame[at] ^= 1 << data.draw(st.integers(0, 7))
    with pytest.raises(ValueError, match="damaged"):
        wire.decode_frame(bytes(frame))


@given(st.binary(max_size=40), st.data())
def test_a_frame_that_lost_its_tail_is_never_read(payload: bytes, data: st.DataObject) -> None:
    frame = wire.encode_frame(0x11, payload, crc=True)
    cut = data.draw(st.integers(1, len(frame) - 2))
    with pytest.raises(ValueError, match="damaged"):
        wire.decode_frame(frame[:cut] + b"~")


@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6))
def test_coordinates_are_proportional_to_the_wall(x_rad: float, y_rad: float) -> None:
    x, y = wire.coordinates(MirrorAngles(x_rad, y_rad))
    wall_x, wall_y = math.tan(x_rad) / math.cos(y_rad), math.tan(y_rad)  # of a two-mirror scanner, 1 m away
    assert x * math.tan(math.radians(50)) == pytest.approx(wall_x, abs=1e-6)
    assert y * math.tan(math.radians(50)) == pytest.approx(wall_y, abs=1e-6)
    back = wire.angles_at(x, y)
    assert back.x_rad == pytest.approx(x_rad, abs=2e-6)
    assert back.y_rad == pytest.approx(y_rad, abs=2e-6)


def test_the_limit_is_a_circle_and_nothing_is_trimmed(lab: Lab) -> None:
    bench, mirror = lab()
    mirror.move_to(MirrorAngles(math.radians(49.9), 0.0))
    assert math.degrees(bench.beam.x_rad) == pytest.approx(49.9, abs=1e-3)
    for corner in (MirrorAngles(math.radians(45), math.radians(45)), MirrorAngles(0.0, math.radians(-50.1))):
        with pytest.raises(LimitError, match=r"outside the circle of 50.00 deg optical. Shrink the wall"):
            mirror.move_to(corner)
    mirror.move_to(ASIDE)


@pytest.mark.parametrize("faults", [[], [Fault(name="B5", parameters={"place": "stuck"})]])
def test_it_comes_back_from_a_pro_mode_that_somebody_left_on(lab: Lab, faults: list[Fault]) -> None:
    bench, mirror = lab(*faults, pro_mode=not faults)
    mirror.move_to(ASIDE)
    assert bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=1e-5)


def test_another_device_is_refused_and_released(lab: Lab) -> None:
    with pytest.raises(WrongDevice, match="GALIL"):
        lab(model=b"GALIL DMC")
    assert not plugged("steered").held


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (later("G1"), DeviceTimeout),
        (later("G2", delay_s=0.55), DeviceTimeout),
        (later("G3", delay_s=1.0), DeviceTimeout),
        (later("G4", kind="noise"), ProtocolError),
        (later("G4", kind="nul"), ProtocolError),
        (later("G4", kind="overlong"), ProtocolError),
        (later("G5"), ProtocolError),
        (later("G6"), DeviceReset),
        (later("G9"), DeviceTimeout),
        (later("B1", reply="NO"), CommandRejected),
        (later("B1", reply="ERROR"), CommandRejected),
    ],
    ids=lambda value: value.name if isinstance(value, Fault) else value.__name__,
)
def test_a_fault_in_a_move_has_its_name_freezes_the_mirror_and_leaves_the_way_to_the_centre(
    lab: Lab, fault: Fault, error: type[DeviceError]
) -> None:
    bench, mirror = lab(fault)
    began_s = bench.clock.now()
    with pytest.raises(error):
        mirror.begin_move(ASIDE)
    assert bench.clock.now() - began_s <= 0.5 * 1.2
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.begin_move(ASIDE)
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-6


def test_a_late_reply_to_a_move_never_answers_the_status_query(lab: Lab) -> None:
    bench, mirror = lab(later("G2", delay_s=0.5005))
    with pytest.raises(DeviceTimeout):
        mirror.begin_move(ASIDE)
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-6


@pytest.mark.parametrize("reply", ["OL", "OU"])
def test_a_trimmed_position_is_an_error_that_says_where_the_mirror_is(lab: Lab, reply: str) -> None:
    _, mirror = lab(later("B1", reply=reply))
    with pytest.raises(CommandRejected, match=r"trimmed, the mirror points elsewhere. It is at x = \+2.8[67] deg"):
        mirror.begin_move(ASIDE)
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.begin_move(ASIDE)


def test_a_centre_that_was_trimmed_is_an_error_too_and_stays_one_until_it_is_acknowledged(lab: Lab) -> None:
    bench, mirror = lab()
    mirror.move_to(ASIDE)
    bench.faults.add(Fault(name="B1", parameters={"reply": "OL"}))
    with pytest.raises(DeviceFault, match="input trimmed"):
        mirror.park()


def test_a_mirror_that_never_settles_is_frozen_where_it_is(lab: Lab) -> None:
    bench, mirror = lab(later("B2"))
    with pytest.raises(SettleTimeout, match=r"STATUS 0x00000010, board faults \(0x1007\) 0x00000020"):
        mirror.move_to(ASIDE)
    for act in (lambda: mirror.move_to(ASIDE), mirror.park):
        with pytest.raises(DeviceFault, match="not known any more"):
            act()
    assert bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=1e-5)


def test_stable_counts_only_twice_in_a_row(lab: Lab) -> None:
    seen: list[bytes] = []
    _, mirror = lab(later("B3"))
    firmware = plugged("steered").firmware
    receive = firmware.receive

    def listen(data: bytes, when_s: float) -> bytes:
        answer = receive(data, when_s)
        if data == b"STATUS\r\n":
            seen.append(answer)
        return answer

    firmware.receive = listen  # type: ignore[method-assign]
    mirror.move_to(ASIDE)
    stable = [answer == b"00000000\r\n" for answer in seen]
    assert stable[-4:] == [True, False, True, True]


@pytest.mark.parametrize("bit", [0, 1, 2, 3, 5, 6, 7])
@pytest.mark.parametrize("latched_only", [False, True])
def test_fault_bits_stop_it_until_somebody_acknowledges(lab: Lab, bit: int, latched_only: bool) -> None:
    _, mirror = lab(later("B4", bit=bit, latched_only=latched_only))
    with pytest.raises(DeviceFault, match=r"reports .*STATUS 0x0000"):
        mirror.move_to(ASIDE)
    for act in (lambda: mirror.move_to(ASIDE), mirror.park):
        with pytest.raises(DeviceFault):
            act()
    if not latched_only:
        with pytest.raises(DeviceFault, match="still reports"):
            mirror.acknowledge()
    elif bit != 3:
        mirror.acknowledge()


def test_a_fault_found_on_opening_forbids_moves_and_can_be_acknowledged(lab: Lab) -> None:
    bench, mirror = lab(later("B4", bit=1, latched_only=True))
    with pytest.raises(DeviceFault):
        mirror.move_to(ASIDE)
    mirror.close()
    settings = OptotuneSettings(model="optotune", port="sim://steered")
    mirror = Optotune.open(settings, bench.clock)
    assert any("was proxy too hot" in warning for warning in mirror.warnings)
    with pytest.raises(DeviceFault, match="was proxy too hot"):
        mirror.begin_move(ASIDE)
    mirror.acknowledge()
    mirror.close()
    Optotune.open(settings, bench.clock).move_to(ASIDE)


@pytest.mark.parametrize("place", ["truncated", "damaged"])
def test_a_frame_that_is_cut_short_or_damaged_is_asked_for_again(lab: Lab, place: str) -> None:
    bench, mirror = lab(later("B5", place=place))
    mirror.move_to(ASIDE)
    assert mirror.measured().x_rad == pytest.approx(ASIDE.x_rad, abs=1e-5)
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-6


@pytest.mark.parametrize(
    ("place", "error"), [("refused", CommandRejected), ("truncated", ProtocolError), ("damaged", ProtocolError)]
)
def test_a_refused_or_twice_damaged_frame_fails_loudly_and_simple_mode_comes_back(
    lab: Lab, place: str, error: type[DeviceError]
) -> None:
    times = 1 if place == "refused" else 3  # the second is the answer to the way back to Simple mode
    bench, mirror = lab(*[later("B5", place=place)] * times)
    with pytest.raises(error):
        mirror.measured()
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-6


@pytest.mark.parametrize("unasked", [b"OK\r\n", b"00000000\r\n", b"NO\r\n", b"OU\r\n"])
@pytest.mark.parametrize("act", ["begin_move", "wait_settled", "measured"])
def test_an_answer_to_a_command_that_nobody_sent_is_never_taken_for_one_that_was(
    lab: Lab, unasked: bytes, act: str
) -> None:
    bench, mirror = lab()
    mirror.move_to(ASIDE)
    port = plugged("steered")
    port.say(unasked)
    bench.clock.sleep(0.1)
    with pytest.raises(ProtocolError, match="answered a command that nobody sent"):
        mirror.begin_move(ASIDE) if act == "begin_move" else getattr(mirror, act)()
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.begin_move(ASIDE)
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-6


def test_words_that_are_no_answer_are_thrown_away(lab: Lab) -> None:
    bench, mirror = lab()
    plugged("steered").say(b"\x00# hello\r\n")
    bench.clock.sleep(0.1)
    mirror.move_to(ASIDE)
    assert bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=1e-5)


def test_a_mirror_away_from_where_it_was_sent_is_reported_or_stopped(lab: Lab) -> None:
    _, mirror = lab(later("B6", off_by=0.01), readback=True)
    mirror.move_to(ASIDE)
    assert any("was sent to x = +5.73 deg" in warning for warning in mirror.warnings)
    _, mirror = lab(later("B6", off_by=0.2), readback=True)
    with pytest.raises(DeviceFault, match=r"was sent to .* and is at"):
        mirror.move_to(ASIDE)
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.move_to(ASIDE)


def test_the_warning_comes_before_the_limit() -> None:
    with pytest.raises(ValidationError, match="warn_error_deg"):
        OptotuneSettings(model="optotune", port="COM3", warn_error_deg=2.0)


@pytest.mark.parametrize(
    ("x", "y", "is_one"), [(0.7, -0.7, True), (1.15, 0.0, True), (1.3, 0.0, False), (9.0, 9.0, False)]
)
def test_a_sensor_that_sees_the_mirror_off_the_disc_is_not_believed(x: float, y: float, is_one: bool) -> None:
    payload = b"\0\2" + struct.pack(">2f", x, y)
    if is_one:
        assert wire.decode_position(payload) == pytest.approx((x, y))
    else:
        with pytest.raises(ValueError, match="off the unit disc"):
            wire.decode_position(payload)


STILL_MS = ((0.0, False), (14.7, True), (15.6, False), (16.4, True), (17.3, False), (17.7, True), (18.9, False),
            (19.9, True))  # fmt: skip
"""A mirror that rings: from when on after a move it calls itself stable. Of a real one the first time and the last are
known, and that there were three in between; when those were is made up."""


@pytest.mark.parametrize("exchange_ms", [0.05, 0.2, 0.5, 1.0, 3.0])
def test_a_mirror_that_rings_is_not_settled_while_it_calls_itself_stable_now_and_then(
    lab: Lab, exchange_ms: float
) -> None:
    bench, mirror = lab()
    firmware = plugged("steered").firmware
    receive, sent_s = firmware.receive, [0.0]

    def ring(data: bytes, when_s: float) -> bytes:
        bench.clock.sleep(exchange_ms * 1e-3)
        if data != b"STATUS\r\n":
            return receive(data, when_s)
        after_ms = (bench.clock.now() - sent_s[0]) * 1e3
        still = next(is_still for from_ms, is_still in reversed(STILL_MS) if after_ms >= from_ms)
        return b"00000000\r\n" if still else b"00000010\r\n"

    firmware.receive = ring  # type: ignore[method-assign]
    for start_ms in range(0, 30, 3):
        mirror.begin_move(ASIDE)
        sent_s[0] = bench.clock.now() - start_ms * 1e-4
        mirror.wait_settled()
        assert bench.clock.now() - sent_s[0] >= 19.9e-3


@pytest.mark.parametrize(
    ("line", "status"),
    [(b"0x0", 0), (b"0x10", 0x10), (b"0x00000010", 0x10), (b"00000010", 0x10), (b"10", None), (b"0x", None),
     (b"0x123456789", None), (b"OK", None)],
)  # fmt: skip
def test_the_status_may_be_written_with_a_prefix_and_then_without_leading_zeros(
    line: bytes, status: int | None
) -> None:
    assert wire.decode_status(line) == status


@pytest.mark.parametrize("at", [b"START", b"GETID"])
@pytest.mark.parametrize("unasked", [b"OK\r\n", b"OU\r\n"])
def test_it_is_as_much_an_answer_where_it_comes_while_noise_is_looked_into(lab: Lab, at: bytes, unasked: bytes) -> None:
    """Of another program's move, which this one would take for its own."""
    bench, mirror = lab()
    mirror.move_to(ASIDE)
    cable = plugged("steered")
    receive, waiting = cable.firmware.receive, [unasked]

    def heard(data: bytes, when_s: float) -> bytes:
        reply = receive(data, when_s)
        return waiting.pop() + reply if waiting and data.startswith(at) else reply

    cable.firmware.receive = heard  # type: ignore[method-assign]
    cable._reply(b"#\r\n", bench.clock.now())
    bench.clock.sleep(0.01)
    with pytest.raises(ProtocolError, match="answered a command that nobody sent"):
        mirror.move_to(MirrorAngles(0.0, 0.1))
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.move_to(ASIDE)
