"""Every fault of rows G and A, committed by the simulator, and what the TriggerScope driver answers."""

import math
from collections.abc import Callable

import pytest

from nlos.drivers.errors import (
    CommandRejected,
    DeviceBusy,
    DeviceError,
    DeviceFault,
    DeviceLost,
    DeviceNotFound,
    DeviceReset,
    DeviceTimeout,
    LimitError,
    MirrorDisturbed,
    ProtocolError,
    WrongDevice,
)
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from nlos.drivers.simulated.triggerscope.firmware import TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.wiring import Wiring
from tests.drivers.later import AFTER_OPENING_S, later

ASIDE = MirrorAngles(0.1, -0.05)
ELSEWHERE = MirrorAngles(-0.2, 0.15)
Lab = Callable[..., tuple[SimulatedBench, TriggerScope]]


@pytest.fixture
def lab(dark_bench: Callable[..., SimulatedBench]) -> Lab:
    """lab(*faults, **settings): a bench with an opened TriggerScope; the clock stands where `after_s` faults begin."""

    def make(*faults: Fault, sd_card: bool = True, **settings: object) -> tuple[SimulatedBench, TriggerScope]:
        bench = dark_bench(*faults)
        unplug("faulty")
        wiring = Wiring(bench, shutter_pin=settings.get("shutter_pin"))
        url = plug("faulty", TriggerScopeFirmware(bench, wiring, sd_card=sd_card), bench, 0.001)
        mirror = TriggerScope.open(TriggerScopeSettings(model="triggerscope", port=url, **settings), bench.clock)
        bench.clock.advance_to(AFTER_OPENING_S)
        return bench, mirror

    return make


def assert_frozen_but_parks(bench: SimulatedBench, mirror: TriggerScope) -> None:
    """After an error in a move: no further motion, but the way to the centre stays open until the port is closed."""
    for motion in (lambda: mirror.begin_move(ASIDE), lambda: mirror.load([ASIDE]), lambda: mirror.move_to(ASIDE)):
        with pytest.raises(DeviceFault, match="not known any more"):
            motion()
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-4
    assert abs(bench.beam.y_rad) < 1e-4
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.begin_move(ASIDE)


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        (later("G1"), DeviceTimeout),
        (later("G2", delay_s=0.55), DeviceTimeout),
        (later("G2", delay_s=2.0), DeviceTimeout),
        (later("G3", delay_s=3.0), DeviceTimeout),
        (later("G4", kind="noise"), ProtocolError),
        (later("G4", kind="nul"), ProtocolError),
        (later("G4", kind="non_ascii"), ProtocolError),
        (later("G4", kind="overlong"), ProtocolError),
        (later("G5"), ProtocolError),
        (later("G6"), DeviceReset),
        (later("G7", chunk=0), DeviceTimeout),
        (later("G9"), DeviceTimeout),
        (later("A2"), CommandRejected),
        (later("A2", kind="unknown"), CommandRejected),
    ],
    ids=lambda value: value.name if isinstance(value, Fault) else value.__name__,
)
def test_a_fault_in_a_move_has_its_name_and_freezes_the_mirror(
    lab: Lab, fault: Fault, error: type[DeviceError]
) -> None:
    bench, mirror = lab(fault)
    began_s = bench.clock.now()
    with pytest.raises(error) as raised:
        mirror.move_to(ASIDE)
    assert raised.value.device == "triggerscope"
    assert bench.clock.now() - began_s <= 0.5 * 1.2
    assert_frozen_but_parks(bench, mirror)


@pytest.mark.parametrize("fault", [later("G3"), later("G7", chunk=1), later("G7", chunk=7, gap_s=0.01)])
def test_replies_in_pieces_are_no_fault(lab: Lab, fault: Fault) -> None:
    bench, mirror = lab(fault)
    mirror.move_to(ASIDE)
    assert bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=3e-5)


def test_a_late_reply_to_an_equal_command_is_not_taken_for_its_own(lab: Lab) -> None:
    """The shutter output closed, its reply late; opened; closed again: the old reply must not confirm the new close."""
    bench, mirror = lab(later("G2", delay_s=0.3), shutter_pin=9)
    mirror.set_shutter_line(False)
    mirror.set_shutter_line(True)
    assert bench.shutter_open
    mirror.set_shutter_line(False)
    assert not bench.shutter_open


@pytest.mark.parametrize("operation", ["read", "write", "in_waiting"])
def test_an_unplugged_controller_is_lost_and_can_be_closed_twice(lab: Lab, operation: str) -> None:
    _, mirror = lab(later("G8", place=operation))
    for act in (lambda: mirror.move_to(ASIDE), mirror.park, mirror.park):
        with pytest.raises(DeviceLost, match="went away"):
            act()
    mirror.close()
    mirror.close()


@pytest.mark.parametrize(
    ("kind", "error"), [("busy", DeviceBusy), ("permission", DeviceBusy), ("missing", DeviceNotFound)]
)
def test_a_port_that_cannot_be_opened_has_its_own_error(lab: Lab, kind: str, error: type[DeviceError]) -> None:
    with pytest.raises(error):
        lab(Fault(name="G10", parameters={"kind": kind}))


def test_a_wrong_device_on_the_port_is_refused_and_released(dark_bench: Callable[..., SimulatedBench]) -> None:
    bench = dark_bench()
    unplug("faulty")
    url = plug("faulty", TriggerScopeFirmware(bench, board=b"MR-E-2 FW 1.0"), bench)
    with pytest.raises(WrongDevice, match="MR-E-2"):
        TriggerScope.open(TriggerScopeSettings(model="triggerscope", port=url), bench.clock)
    assert not plugged("faulty").held


def test_a_banner_between_commands_is_a_restart_too(lab: Lab) -> None:
    bench, mirror = lab()
    cable = plugged("faulty")
    cable._reply(cable.firmware.reboot(), bench.clock.now())
    with pytest.raises(DeviceReset, match="restarted"):
        mirror.move_to(ASIDE)
    assert_frozen_but_parks(bench, mirror)


def test_no_two_commands_are_ever_on_their_way_together(lab: Lab) -> None:
    """A1: the simulator loses the second of two commands, so the driver must wait for each reply."""
    _, mirror = lab()
    firmware, heard = plugged("faulty").firmware, []
    receive = firmware.receive

    def listen(data: bytes, when_s: float) -> bytes:
        heard.append(data)
        return receive(data, when_s)

    firmware.receive = listen  # type: ignore[method-assign]
    mirror.move_to(ASIDE)
    mirror.load([ASIDE, ELSEWHERE] * 300)
    mirror.start()
    mirror.stop()
    mirror.park()
    assert len(heard) > 30
    assert all(data.count(b"\n") == 1 and data.endswith(b"\n") for data in heard)


def test_a_controller_without_banner_moves_nothing_and_is_not_trusted(lab: Lab) -> None:
    bench, mirror = lab(sd_card=False, shutter_pin=9)
    for act in (
        lambda: mirror.begin_move(ASIDE),
        lambda: mirror.load([ASIDE]),
        lambda: mirror.set_shutter_line(True),
    ):
        with pytest.raises(DeviceFault, match="SD card"):
            act()
    mirror.set_shutter_line(False)
    with mirror.trusted_for_trial():
        mirror.move_to(ASIDE)
    with pytest.raises(DeviceFault, match="SD card"):  # nobody has said that it moved
        mirror.begin_move(ASIDE)
    bench, mirror = lab(Fault(name="A3"), allow_unverified_dac=True)
    assert any("not verified" in warning for warning in mirror.warnings)
    mirror.move_to(ASIDE)
    assert bench.beam == MirrorAngles(0.0, 0.0)


def test_a_table_that_kept_other_counts_is_sent_once_more(lab: Lab) -> None:
    _, mirror = lab(later("A4"))
    mirror.load([ASIDE, ELSEWHERE])
    mirror.start()


def test_a_table_that_keeps_other_counts_twice_is_an_error(lab: Lab) -> None:
    bench, mirror = lab(Fault(name="A4", after_s=AFTER_OPENING_S, times=2))
    with pytest.raises(ProtocolError, match="twice"):
        mirror.load([ASIDE, ELSEWHERE])
    assert_frozen_but_parks(bench, mirror)


def test_too_long_a_sequence_sends_nothing(lab: Lab) -> None:
    _, mirror = lab()
    plugged("faulty").mangle = lambda direction, data: pytest.fail(f"{data!r} was sent")
    with pytest.raises(LimitError):
        mirror.load([ASIDE] * 1201)


@pytest.mark.parametrize(("kind", "steps"), [("missed", 9), ("extra", 11), ("none", 10)])
def test_markers_count_the_steps_that_were_really_made(lab: Lab, kind: str, steps: int) -> None:
    bench, mirror = lab(Fault(name="A6", skip=3, parameters={"kind": kind}))
    edges: list[str] = []
    for line in ("marker_1", "marker_2"):
        bench.wire(line, lambda when_s, line=line: edges.append(line))
    mirror.load([ASIDE] * 10)
    mirror.start()
    for _ in range(10):
        bench.clock.sleep(0.01)
        bench.edge("pixel_clock", bench.clock.now())
    mirror.stop()
    assert len(edges) == steps


def test_parked_without_an_answer_it_steps_no_further(lab: Lab) -> None:
    bench, mirror = lab()
    mirror.load([ASIDE, ELSEWHERE, ASIDE])
    mirror.start()
    bench.faults.add(Fault(name="G1", after_s=bench.clock.now(), times=10_000))
    with pytest.raises(DeviceTimeout):
        mirror.park()
    bench.clock.sleep(0.5)
    for _ in range(3):
        bench.edge("pixel_clock", bench.clock.now())
        bench.clock.sleep(0.1)
        assert math.hypot(bench.beam.x_rad, bench.beam.y_rad) < 1e-4


@pytest.mark.parametrize("skip", range(8))
def test_a_range_changed_behind_our_back_stops_the_mirror_until_it_is_parked(lab: Lab, skip: int) -> None:
    """In a move, before the upload, in its middle, as the mirror goes to the first position: no range is set, which
    would swing an axis out, before whoever has the shutter closes it and parks the mirror."""
    bench, mirror = lab(Fault(name="A7", after_s=AFTER_OPENING_S, skip=skip, parameters={"range": 3}))
    path = [ASIDE, ELSEWHERE, ASIDE]

    def scan() -> None:
        mirror.move_to(ELSEWHERE)
        mirror.load(path)
        mirror.start()

    with pytest.raises(MirrorDisturbed, match="changed the range"):
        scan()
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.move_to(ASIDE)
    mirror.park()
    assert abs(bench.beam.x_rad) < 1e-4
    assert abs(bench.beam.y_rad) < 1e-4
    scan()
    for angles in path:
        bench.edge("pixel_clock", bench.clock.now())
        bench.clock.sleep(0.02)
        assert bench.beam.x_rad == pytest.approx(angles.x_rad, abs=3e-5)
        assert bench.beam.y_rad == pytest.approx(angles.y_rad, abs=3e-5)
    mirror.stop()


@pytest.mark.parametrize("skip", range(20))  # of all commands of an opening
def test_a_range_changed_while_it_is_opened_is_set_again_in_the_dark(lab: Lab, skip: int) -> None:
    bench, mirror = lab(Fault(name="A7", skip=skip), shutter_pin=9)
    assert not bench.shutter_open
    assert math.hypot(bench.beam.x_rad, bench.beam.y_rad) < 1e-4
    mirror.move_to(ASIDE)
    assert bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=3e-5)
    said = [each for each in mirror.warnings if "changed the range of a DAC" in each]
    assert bool(said) == (skip > 2), "before, nothing is set yet"


def test_a_closing_shutter_gets_past_a_lost_reply_within_its_time(lab: Lab) -> None:
    bench, mirror = lab(Fault(name="G1", after_s=AFTER_OPENING_S, skip=1), shutter_pin=9)
    mirror.set_shutter_line(True)
    assert bench.shutter_open
    mirror.set_shutter_line(False)
    assert not bench.shutter_open


def test_a_closing_shutter_is_told_again_where_the_command_itself_was_lost(lab: Lab) -> None:
    bench, mirror = lab(shutter_pin=9)
    mirror.set_shutter_line(True)
    firmware, lost = plugged("faulty").firmware, [b"SDO1-0"]
    receive = firmware.receive
    firmware.receive = lambda data, when_s: b"" if lost and lost[0] in data and lost.pop() else receive(data, when_s)
    mirror.set_shutter_line(False)
    assert not lost
    assert not bench.shutter_open


@pytest.mark.parametrize("sent", range(7))  # of `SDO1-1` and its newline
def test_half_an_opening_of_the_shutter_is_never_completed(lab: Lab, sent: int) -> None:
    bench, mirror = lab(Fault(name="G9", after_s=AFTER_OPENING_S, parameters={"sent": sent}), shutter_pin=9)
    plugged("faulty").firmware.wiring.log = lambda when_s, what, number, value: pytest.fail(f"{what} {number} {value}")
    with pytest.raises(DeviceTimeout):
        mirror.set_shutter_line(True)
    mirror.set_shutter_line(False)
    assert not bench.shutter_open


def test_nothing_is_sent_while_armed_but_the_end(lab: Lab) -> None:
    _, mirror = lab()
    mirror.load([ASIDE, ELSEWHERE])
    mirror.start()
    for act in (lambda: mirror.move_to(ASIDE), lambda: mirror.load([ASIDE])):
        with pytest.raises(CommandRejected, match="armed"):
            act()
    mirror.stop()
    mirror.stop()
    mirror.move_to(ASIDE)


def test_the_limit_is_in_the_beams_angle(lab: Lab) -> None:
    _, mirror = lab(max_mechanical_deg=10.0)
    mirror.check(MirrorAngles(math.radians(19.9), 0.0))
    with pytest.raises(LimitError, match=r"outside \+-20.00 deg"):
        mirror.check(MirrorAngles(math.radians(20.1), 0.0))
