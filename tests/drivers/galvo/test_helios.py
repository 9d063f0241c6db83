"""A Helios laser DAC: its bytes, what it must never be sent, and what its firmware skips in silence."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from nlos.drivers.errors import DeviceBusy, DeviceFault, DeviceLost, DeviceNotFound, DeviceReset
from nlos.drivers.galvo.helios import wire
from nlos.drivers.galvo.helios.mirror import Helios
from nlos.drivers.galvo.helios.model import HELIOS
from nlos.drivers.galvo.helios.settings import HeliosSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.helios.firmware import HeliosFirmware
from nlos.drivers.simulated.usb.pipes import SimulatedPipes

CENTRE = MirrorAngles(0.0, 0.0)
ASIDE = MirrorAngles(0.2, -0.1)


@dataclass
class Rig:
    """Bench, DAC, cable and driver."""

    bench: SimulatedBench
    firmware: HeliosFirmware
    cable: SimulatedPipes
    settings: HeliosSettings
    sent: list[bytes] = field(default_factory=list)

    def open(self) -> Helios:
        log = lambda _, way, data: self.sent.append(data) if way == ">" else None  # noqa: E731
        mirror = HELIOS.open(self.settings, self.bench.clock, self.cable, log)
        assert isinstance(mirror, Helios)
        return mirror

    def points_at(self, angles: MirrorAngles) -> bool:
        beam = self.bench.beam
        return math.hypot(beam.x_rad - angles.x_rad, beam.y_rad - angles.y_rad) < 4e-4


@pytest.fixture
def rig(dark_bench: Callable[..., SimulatedBench]) -> Callable[..., Rig]:
    def make(**settings: object) -> Rig:
        bench = dark_bench()
        chosen = HeliosSettings(model="helios", usb="simulated", **settings)
        firmware = HeliosFirmware(bench, chosen)
        return Rig(bench, firmware, SimulatedPipes(firmware, bench, 0.00025), chosen)

    return make


def test_a_frame_is_the_bytes_that_the_sdk_makes() -> None:
    samples = [wire.Codes(0xABC, 0x123), wire.Codes(0x800, 0xFFF, bytes((255, 0, 168, 1)))]
    frame = wire.encode_frame(samples, 10_000, wire.START_AT_ONCE | wire.ONCE)
    assert frame == bytes.fromhex("abc123 00000000 800fff ff00a801 1027 0200 03")


def test_what_the_dac_would_skip_in_silence_is_never_made() -> None:
    for count in (45, 109, 45 + 64 * 20):  # with the five bytes behind them they fill whole packets
        with pytest.raises(ValueError, match="whole packets"):
            wire.encode_frame([wire.Codes(0, 0)] * count, 1000, 0)
    one = [wire.Codes(0, 0)]
    for points, rate in (([], 1000), (one * 4096, 1000), (one, 6), (one, 65536)):
        with pytest.raises(ValueError, match="a second"):
            wire.encode_frame(points, rate, 0)
    with pytest.raises(ValueError, match="12 bits"):
        wire.encode_frame([wire.Codes(0x1000, 0)], 1000, 0)


@pytest.mark.parametrize("code", sorted(set(range(256)) - {1, 2, 3, 4, 5}))
def test_no_other_command_can_be_made_least_of_all_the_one_that_erases(code: int) -> None:
    with pytest.raises(ValueError, match="never sent"):
        wire.encode_command(code)


def test_from_open_to_close_its_shutter_pin_is_low_its_colours_dark_and_its_firmware_alive(
    rig: Callable[..., Rig],
) -> None:
    this = rig()
    this.firmware.shutter_pin = True  # left by another program
    mirror = this.open()
    assert not this.firmware.shutter_pin
    mirror.move_to(ASIDE)
    assert this.points_at(ASIDE)
    mirror.park()
    mirror.close()
    assert not this.firmware.shutter_pin
    assert not this.firmware.erased
    assert set(this.firmware.commands) <= {1, 2, 3, 4, 5}
    frames = [data for data in this.sent if len(data) > 2]
    assert frames
    assert all(frame[3:7] == bytes(4) for frame in frames)
    assert HELIOS.shutters == {}


def test_a_mirror_left_aside_by_a_killed_program_is_centred_as_the_next_one_opens(rig: Callable[..., Rig]) -> None:
    this = rig()
    this.open().move_to(ASIDE)
    this.cable.close_device(object())  # what the system does for a killed program
    this.bench.clock.sleep(0.5)
    assert this.points_at(CENTRE)
    this.open()
    assert this.points_at(CENTRE)


def test_nothing_that_another_program_left_unread_is_taken_for_an_answer(rig: Callable[..., Rig]) -> None:
    this = rig()
    this.cable._answers.extend([b"\x83\x00", b"\x84\x01\x02\x03\x04"])
    mirror = this.open()
    assert mirror.identity.firmware == "6"
    mirror.look()
    this.cable._answers.append(b"\x83\x01")
    with pytest.raises(DeviceReset, match="without being asked"):
        mirror.look()
    with pytest.raises(DeviceFault, match="not known any more"):
        mirror.move_to(ASIDE)


def test_inverted_axes_turn_the_other_way(rig: Callable[..., Rig]) -> None:
    this = rig(invert_x=True)
    this.open().move_to(ASIDE)
    assert this.points_at(MirrorAngles(-ASIDE.x_rad, ASIDE.y_rad))


def test_pulled_out_it_is_lost_and_the_dac_centres_itself(rig: Callable[..., Rig]) -> None:
    this = rig()
    mirror = this.open()
    mirror.move_to(ASIDE)
    this.cable.unplug()
    for act in (mirror.look, mirror.park):
        with pytest.raises(DeviceLost):
            act()
    mirror.close()
    mirror.close()
    this.bench.clock.sleep(0.5)
    assert this.points_at(CENTRE)
    with pytest.raises(DeviceNotFound):
        this.open()


def test_a_second_program_is_refused(rig: Callable[..., Rig]) -> None:
    this = rig()
    this.open()
    with pytest.raises(DeviceBusy):
        this.open()


@pytest.mark.parametrize("samples_per_s", [7, 1000, 20_000, 65_535])
def test_a_sample_lasts_a_processor_cycle_longer_than_its_rate_says(samples_per_s: int) -> None:
    """The timer of the firmware counts from its compare value down to 0, both included."""
    cycles = wire.sample_s(samples_per_s) * wire._CPU_HZ
    assert cycles == pytest.approx(round(cycles), abs=1e-6)
    assert round(cycles) == wire._CPU_HZ // samples_per_s + 1
    assert wire.sample_s(samples_per_s) > 1 / samples_per_s
