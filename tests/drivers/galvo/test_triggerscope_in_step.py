"""What comes from a TriggerScope unasked: what it means, whenever it arrives, and what is noise."""

from collections.abc import Callable

import pytest

from nlos.drivers.errors import DeviceError, DeviceFault, DeviceReset, DeviceTimeout, MirrorDisturbed, ProtocolError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from nlos.drivers.simulated.triggerscope.firmware import TriggerScopeFirmware
from nlos.drivers.simulated.triggerscope.wiring import Wiring

ASIDE, ELSEWHERE = MirrorAngles(0.1, -0.05), MirrorAngles(-0.2, 0.15)
BANNER = b"ARC TRIGGERSCOPE 16 R4 Board 4B v.620-MM\r\n"
OTHERS, RANGE, NOISE = b"!SAO1-40000\r\n", b"!SAR1-3\r\n", b"\x00\xfe#\r\n"
"""Another program moved the mirror; it changed a range; nothing that the controller says."""
MEANS = [
    (OTHERS, ProtocolError, "answered a command that nobody sent"),
    (RANGE, MirrorDisturbed, "changed the range"),
    (BANNER, DeviceReset, "restarted"),
    (OTHERS + RANGE, MirrorDisturbed, "changed the range"),
    (OTHERS + BANNER, DeviceReset, "restarted"),
]


class Rig:
    """A controller on its cable; `unasked` comes before its answer to the n-th `at` from now on, once; `lost` so many
    answers to its question for a length do not come."""

    def __init__(self, bench: SimulatedBench, **settings: int) -> None:
        self.bench = bench
        firmware = TriggerScopeFirmware(bench, Wiring(bench, **settings))
        unplug("in_step")
        url = plug("in_step", firmware, bench, 0.001)
        self.mirror = TriggerScope.open(TriggerScopeSettings(model="triggerscope", port=url, **settings), bench.clock)
        self._receive, firmware.receive = firmware.receive, self._heard
        self.at, self.unasked, self.lost, self.heard = b"", b"", 0, []

    def arrives(self, data: bytes) -> None:
        plugged("in_step")._reply(data, self.bench.clock.now())
        self.bench.clock.sleep(0.01)

    def _heard(self, data: bytes, when_s: float) -> bytes:
        self.heard.append(data)
        reply = self._receive(data, when_s)
        if data.startswith(b"PAN") and self.lost:
            self.lost -= 1
            return b""
        if self.at and data.startswith(self.at):
            reply, self.unasked, self.at = self.unasked + reply, b"", b""
        return reply


@pytest.fixture
def rig(dark_bench: Callable[..., SimulatedBench]) -> Rig:
    return Rig(dark_bench())


def assert_frozen(rig: Rig) -> None:
    with pytest.raises(DeviceFault, match="not known any more"):
        rig.mirror.move_to(ELSEWHERE)


@pytest.mark.parametrize(("data", "error", "what"), MEANS)
def test_an_answer_that_nobody_waited_for_freezes_the_mirror(
    rig: Rig, data: bytes, error: type[DeviceError], what: str
) -> None:
    rig.mirror.move_to(ASIDE)
    rig.arrives(data)
    with pytest.raises(error, match=what):
        rig.mirror.move_to(ELSEWHERE)
    assert not any(each.startswith(b"SAO") for each in rig.heard[-2:])  # the move itself was not begun
    assert_frozen(rig)


@pytest.mark.parametrize("at", [b"9999", b"PAN"])
@pytest.mark.parametrize(("data", "error", "what"), MEANS[:4])
def test_it_is_as_much_an_answer_where_it_comes_while_that_is_looked_into(
    rig: Rig, data: bytes, error: type[DeviceError], what: str, at: bytes
) -> None:
    rig.arrives(NOISE)
    rig.at, rig.unasked = at, data
    with pytest.raises(error, match=what):
        rig.mirror.move_to(ASIDE)
    assert_frozen(rig)


def test_it_is_as_much_an_answer_where_nothing_answers_what_spoils_half_a_line(rig: Rig) -> None:
    rig.arrives(OTHERS)
    firmware = plugged("in_step").firmware
    receive = firmware.receive
    firmware.receive = lambda data, when_s: b"" if data.startswith(b"9999") else receive(data, when_s)
    with pytest.raises(ProtocolError, match="answered a command that nobody sent"):
        rig.mirror.move_to(ASIDE)
    assert_frozen(rig)


def test_noise_in_step_means_nothing_and_the_mirror_goes_where_it_is_told(rig: Rig) -> None:
    rig.arrives(NOISE)
    rig.mirror.move_to(ASIDE)
    assert rig.bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=3e-5)
    assert [each for each in rig.heard if each[:3] in (b"999", b"PAN")] == [b"99999999999\n", b"PAN1\n"]


def test_an_answer_that_is_lost_once_is_asked_for_again_and_twice_is_a_timeout(rig: Rig) -> None:
    rig.arrives(NOISE)
    rig.lost = 1
    rig.mirror.move_to(ASIDE)
    assert rig.bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=3e-5)
    rig.arrives(NOISE)
    rig.lost = 2
    began_s = rig.bench.clock.now()
    with pytest.raises(DeviceTimeout):
        rig.mirror.move_to(ELSEWHERE)
    assert rig.bench.clock.now() - began_s < 1.5  # of a timeout of 0.5 s, with the quiet that is waited for
    assert rig.bench.beam.x_rad == pytest.approx(ASIDE.x_rad, abs=3e-5)


def test_what_is_left_of_a_command_that_timed_out_is_no_answer_of_others(rig: Rig) -> None:
    """Its own reply, late, after which nothing is outstanding: the way to the centre is open."""
    firmware = plugged("in_step").firmware
    receive = firmware.receive
    firmware.receive = lambda data, when_s: b"" if data.startswith(b"SAO") else receive(data, when_s)
    with pytest.raises(DeviceTimeout):
        rig.mirror.move_to(ASIDE)
    firmware.receive = receive
    rig.arrives(b"!SAO1-42000\r\n")
    rig.mirror.park()
    assert abs(rig.bench.beam.x_rad) < 1e-4
    assert rig.heard.count(b"SAR1-4\n") == 0  # ranges stand: setting them swings the other axis out


@pytest.mark.parametrize("late_s", [0.0, 0.0002])
def test_a_restart_as_the_shutter_is_closed_is_no_less_noticed(
    dark_bench: Callable[..., SimulatedBench], late_s: float
) -> None:
    """Its start-up text was thrown away before the command to close, or behind it, and the mirror moved on with the
    ranges that the controller starts with."""
    rig = Rig(dark_bench(), shutter_pin=9)
    rig.mirror.set_shutter_line(True)
    cable = plugged("in_step")
    cable._reply(cable.firmware.reboot(), rig.bench.clock.now() + late_s)
    rig.mirror.set_shutter_line(False)
    with pytest.raises(DeviceReset):
        rig.mirror.move_to(ASIDE)
    assert not any(each.startswith(b"SAO") for each in rig.heard)
    rig.mirror.park()
    assert abs(rig.bench.beam.x_rad) < 1e-4


def test_answers_that_come_seconds_late_are_no_restart(dark_bench: Callable[..., SimulatedBench]) -> None:
    """Those to its own questions who it is were taken for the start-up text."""
    rig = Rig(dark_bench(Fault(name="G2", after_s=1.5, parameters={"delay_s": 2.0})), shutter_pin=9)
    rig.mirror.set_shutter_line(True)
    rig.bench.clock.sleep(1.5)
    said = []
    for _ in range(5):
        try:
            rig.mirror.set_shutter_line(False)
        except DeviceError as error:
            said.append(type(error))
    assert set(said) == {DeviceTimeout}
    assert len(said) < 5
    assert not rig.bench.shutter_open
    rig.mirror.park()
    assert rig.heard.count(b"SAR1-4\n") == 0
