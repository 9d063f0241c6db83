"""What every mirror that a bench file may name does, each on its simulated controller, or on the bench of `--bench`."""

import itertools
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

import pytest
from pydantic import TypeAdapter

from nlos.drivers.device_settings import ADDRESS_KEYS
from nlos.drivers.errors import DeviceError, DeviceFault, DeviceLost, DeviceReset, DeviceTimeout, LimitError
from nlos.drivers.galvo.known_mirrors import MIRRORS, MirrorSettings, open_mirror
from nlos.drivers.galvo.mirror import GalvoMirror, MeasuresPosition, MirrorAngles
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.instruments import far_end
from nlos.drivers.simulated.serial.cable import SerialCable
from nlos.drivers.simulated.serial.port import plugged, unplug
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable

SETTINGS: TypeAdapter[MirrorSettings] = TypeAdapter(MirrorSettings)
RESOLUTION_RAD = {"helios": 2e-4}  # 12 bits over 80 degrees
AFTER_OPENING_S = 1.0
PATH = [MirrorAngles(0.1 * math.sin(0.7 * i), 0.1 * math.cos(0.4 * i)) for i in range(12)]


MODELS = sorted(MIRRORS)
READ_BACK_RAD = math.radians(0.6)
"""What a controller's own sensor is accurate to, optical."""


def simulated_address(model: str) -> dict[str, str]:
    """By the key of its cable, which for a mirror of another package may be a vendor's library, too."""
    cable = MIRRORS[model].settings.cable
    return {ADDRESS_KEYS[cable]: "sim://every" if cable == "serial" else "simulated"}


@dataclass
class Lab:
    bench: Any
    """A simulated table, or what a real one has of it."""
    mirror: GalvoMirror
    sent: list[Any]
    real: bool = False

    def points_at(self, angles: MirrorAngles) -> bool:
        if not self.real:
            beam, within_rad = self.bench.beam, RESOLUTION_RAD.get(self.mirror.identity.model, 5e-5)
        elif isinstance(self.mirror, MeasuresPosition):
            beam, within_rad = self.mirror.measured(), READ_BACK_RAD
        else:
            pytest.skip(f"{self.mirror.identity.product} does not measure where it points")
        return math.hypot(beam.x_rad - angles.x_rad, beam.y_rad - angles.y_rad) < within_rad

    @property
    def cable(self) -> SerialCable:
        if self.real:
            pytest.skip("cable: only a simulated one can be cut and listened to")
        if MIRRORS[self.mirror.identity.model].settings.cable != "serial":
            pytest.skip("a serial line's bytes are listened to here; USB has tests of its own")
        return plugged("every")

    @contextmanager
    def silent(self) -> Iterator[None]:
        before = len(self.sent)
        yield
        assert self.sent[before:] == []


@pytest.fixture
def lab(
    request: pytest.FixtureRequest, dark_bench: Callable[..., SimulatedBench], named_bench: Any
) -> Iterator[Callable[..., Lab]]:
    """lab(*faults): a bench with the mirror of this model opened and centred."""
    if named_bench is not None:
        yield (
            lambda *faults: (
                pytest.skip("faults are provoked on simulated benches")
                if faults
                else Lab(named_bench.table, named_bench.bench.mirror, named_bench.sent, real=True)
            )
        )
        return

    def make(*faults: Fault) -> Lab:
        bench = dark_bench(*faults)
        serial = MIRRORS[request.param].settings.cable == "serial"
        if faults and not serial:
            pytest.skip("faults of a serial line; USB has tests of its own")
        settings = SETTINGS.validate_python({"model": request.param, **simulated_address(request.param)})
        plugged_ins.close()
        table = SimulatedTable(bench, SimulationSettings(serial_latency_ms=1.0), 10e6)
        backend = far_end(MIRRORS[request.param], settings, table, plugged_ins)
        sent: list[bytes] = []
        log = lambda _, way, data: sent.append(data) if way == ">" else None  # noqa: E731
        mirror = open_mirror(settings, bench.clock, log, backend)
        bench.clock.advance_to(AFTER_OPENING_S)
        return Lab(bench, mirror, sent)

    with ExitStack() as plugged_ins:
        yield make


@pytest.mark.parametrize("model", MODELS)
def test_angles_sent_stay_within_each_sides_limit(model: str, dark_bench: Callable[..., SimulatedBench]) -> None:
    bench = dark_bench()
    allowed = {"left_deg": -3.0, "right_deg": 5.0, "bottom_deg": -2.0, "top_deg": 7.0}
    block = {"model": model, **simulated_address(model), "allowed_deg": allowed}
    settings = SETTINGS.validate_python(block)
    with ExitStack() as stack:
        table = SimulatedTable(bench, SimulationSettings(), 10e6)
        mirror = open_mirror(settings, bench.clock, None, far_end(MIRRORS[model], settings, table, stack))
        stack.callback(mirror.close)
        for x_deg, y_deg in ((-3.0, 0.0), (5.0, 0.0), (0.0, -2.0), (0.0, 7.0), (4.9, 6.9)):
            mirror.move_to(MirrorAngles(math.radians(x_deg), math.radians(y_deg)))
        before = bench.beam
        for x_deg, y_deg in ((-3.1, 0.0), (5.1, 0.0), (0.0, -2.1), (0.0, 7.1), (math.nan, 0.0)):
            outside = MirrorAngles(math.radians(x_deg), math.radians(y_deg))
            for send in (mirror.check, mirror.move_to):
                with pytest.raises(LimitError, match="allowed_deg"):
                    send(outside)
            if mirror.max_sequence:
                with pytest.raises(LimitError, match="allowed_deg"):
                    mirror.load([outside])
        assert bench.beam == before


def test_it_says_who_it_is(lab: Callable[..., Lab]) -> None:
    identity = lab().mirror.identity
    assert identity.model in MIRRORS
    assert identity.vendor
    assert identity.product
    assert identity.firmware


def test_it_is_centred_when_opened(lab: Callable[..., Lab]) -> None:
    assert lab().points_at(MirrorAngles(0.0, 0.0))


def test_the_beam_is_there_when_a_move_returns(lab: Callable[..., Lab]) -> None:
    there = lab()
    for angles in PATH:
        there.mirror.move_to(angles)
        assert there.points_at(angles)


def test_the_beam_is_still_on_its_way_while_the_mirror_settles(lab: Callable[..., Lab]) -> None:
    there = lab()
    if there.real:
        pytest.skip("nothing here sees a beam on its way; `nlos doctor --thorough` does, by its light")
    there.mirror.begin_move(MirrorAngles(0.6, 0.0))
    assert not there.points_at(MirrorAngles(0.6, 0.0))
    there.mirror.wait_settled()
    assert there.points_at(MirrorAngles(0.6, 0.0))


def test_a_move_that_cuts_another_short_is_waited_for_from_where_that_began(lab: Callable[..., Lab]) -> None:
    there = lab()
    far, near = MirrorAngles(-0.5, 0.0), MirrorAngles(0.3, 0.0)
    there.mirror.move_to(far)
    for step in (0.0, 1e-3, 2e-3):
        there.mirror.begin_move(MirrorAngles(near.x_rad + step, near.y_rad))
    there.mirror.wait_settled()
    assert there.points_at(MirrorAngles(near.x_rad + step, near.y_rad))


def test_settling_takes_about_as_long_as_expected(lab: Callable[..., Lab]) -> None:
    there = lab()
    for place in PATH:  # the first time so far out, some look where the mirror is
        there.mirror.move_to(place)
    for start, end in itertools.pairwise(PATH):
        there.mirror.move_to(start)
        there.mirror.begin_move(end)
        began_s = there.bench.clock.now()
        there.mirror.wait_settled()
        expected_s = there.mirror.settle_s(start, end)
        assert expected_s * 0.5 < there.bench.clock.now() - began_s <= expected_s + 0.005


@pytest.mark.parametrize(
    "angles",
    [MirrorAngles(1.0, 0.0), MirrorAngles(0.0, -1.0), MirrorAngles(math.nan, 0.0), MirrorAngles(0.0, math.inf)],
)
def test_what_it_cannot_reach_is_refused_and_nothing_is_sent(lab: Callable[..., Lab], angles: MirrorAngles) -> None:
    there = lab()
    acts = (there.mirror.check, there.mirror.begin_move, there.mirror.move_to, lambda a: there.mirror.load([a]))
    with there.silent():
        for act in acts:
            with pytest.raises(LimitError):
                act(angles)


def test_checking_sends_nothing(lab: Callable[..., Lab]) -> None:
    there = lab()
    with there.silent():
        there.mirror.check(MirrorAngles(0.3, 0.3))
        assert there.mirror.settle_s(PATH[0], PATH[1]) > 0.0
        assert there.mirror.settle_s(PATH[0], PATH[0]) == 0.0


def test_parked_is_centred(lab: Callable[..., Lab]) -> None:
    there = lab()
    there.mirror.move_to(PATH[3])
    there.mirror.park()
    assert there.points_at(MirrorAngles(0.0, 0.0))


def test_it_steps_through_a_sequence_or_says_that_it_cannot(lab: Callable[..., Lab]) -> None:
    there = lab()
    if there.mirror.max_sequence == 0:
        with pytest.raises(DeviceError, match="cannot step by itself"):
            there.mirror.load(PATH)
        with pytest.raises(DeviceError, match="cannot step by itself"):
            there.mirror.start()
        there.mirror.stop()
        return
    edge = there.bench.edge
    for _ in range(2):
        there.mirror.load(PATH)
        there.mirror.start()
        for angles in PATH:
            edge("pixel_clock", there.bench.clock.now())
            there.bench.clock.sleep(0.01)
            assert there.points_at(angles)
        there.mirror.stop()
    there.mirror.move_to(PATH[5])
    assert there.points_at(PATH[5])


@pytest.mark.parametrize("fault", ["G1", "G4", "G5", "G9"])
def test_after_an_error_in_a_move_it_does_not_move_again(lab: Callable[..., Lab], fault: str) -> None:
    there = lab(Fault(name=fault, after_s=AFTER_OPENING_S))
    with pytest.raises(DeviceError):
        there.mirror.move_to(PATH[1])
    for _ in range(2):
        with pytest.raises(DeviceFault, match="not known any more"):
            there.mirror.move_to(PATH[2])


@pytest.mark.parametrize("delay_s", [0.6, 1.0, 2.0])
@pytest.mark.parametrize("where", ["in a move", "on the way to the centre"])
def test_a_reply_that_is_seconds_late_does_not_keep_it_from_the_centre(
    lab: Callable[..., Lab], where: str, delay_s: float
) -> None:
    there = lab()
    assert there.cable.plugged
    there.mirror.move_to(PATH[1])
    there.bench.faults.add(Fault(name="G2", parameters={"delay_s": delay_s}))
    if where == "in a move":
        with pytest.raises(DeviceTimeout):
            there.mirror.move_to(PATH[2])
    there.mirror.park()
    assert there.points_at(MirrorAngles(0.0, 0.0))


def test_a_refusal_does_not_keep_it_from_the_centre(lab: Callable[..., Lab]) -> None:
    there = lab()
    there.mirror.move_to(PATH[1])
    there.bench.faults.add(Fault(name="A2", times=2), Fault(name="B1", times=2, parameters={"reply": "NO"}))
    there.mirror.park()
    assert there.points_at(MirrorAngles(0.0, 0.0))


def test_a_controller_that_hears_but_does_not_answer_is_sent_to_its_centre(lab: Callable[..., Lab]) -> None:
    there = lab()
    there.mirror.move_to(PATH[1])
    there.cable.mangle = lambda way, data: [(0.0, data)] if way == ">" else []
    began_s = there.bench.clock.now()
    with pytest.raises(DeviceTimeout):
        there.mirror.park()
    assert there.bench.clock.now() - began_s < 10.0
    there.mirror.close()
    assert there.points_at(MirrorAngles(0.0, 0.0))


def test_looking_sends_nothing_and_sees_a_restart_and_a_pulled_cable(lab: Callable[..., Lab]) -> None:
    there = lab()
    cable = there.cable
    there.mirror.move_to(PATH[1])
    sent: list[str] = []
    cable.mangle = lambda way, data: [(0.0, data)] if way == "<" else sent.append(data) or [(0.0, data)]
    there.mirror.look()
    cable.say(b"# hello\r\n")
    there.mirror.look()
    there.mirror.move_to(PATH[2])
    sent.clear()
    cable.say(cable.firmware.reboot())
    with pytest.raises(DeviceReset):
        there.mirror.look()
    with pytest.raises(DeviceFault, match="not known any more"):
        there.mirror.move_to(PATH[1])
    unplug("every")
    with pytest.raises(DeviceLost):
        there.mirror.look()
    assert sent == []


def test_pulled_out_it_is_lost_and_closes_all_the_same(lab: Callable[..., Lab]) -> None:
    there = lab()
    assert there.cable.held
    unplug("every")
    with pytest.raises(DeviceLost):
        there.mirror.move_to(PATH[1])
    with pytest.raises(DeviceLost):
        there.mirror.park()
    there.mirror.close()
    there.mirror.close()


def test_closing_releases_the_port(lab: Callable[..., Lab]) -> None:
    there = lab()
    assert there.cable.held
    there.mirror.close()
    there.mirror.close()
    assert not there.cable.held
