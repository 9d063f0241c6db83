"""The TriggerScope driver against written dialogues, and its codec by itself."""

import math
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from nlos.drivers.errors import CommandRejected, LimitError, WrongDevice
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.triggerscope import wire
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope, TriggerScopeSettings
from nlos.drivers.galvo.triggerscope.settings import AxisSettings
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.serial.port import plug, plugged, unplug

BANNER = b"ARC TRIGGERSCOPE 16 R4 Board 4B v.620-MM\r\n"


def echoed(*commands: bytes) -> list[tuple[bytes, bytes]]:
    return [(command + b"\n", b"!" + command + b"\r\n") for command in commands]


SPOIL = (b"99999999999\n", b"ERROR_UNKNOWN_COMMAND\r\n")
IDENTIFY = [SPOIL, (b"*\n", BANNER), (b"*\n", BANNER)]
DARK = echoed(b"SDO1-0", b"PDC1", b"SDO1-0", b"BDO1-0-0")
QUIET = echoed(b"SSL0", b"PAC1", b"PAC2", b"SDO0-0", b"PDC0", b"SDO0-0", b"BDO0-0-0")
RANGES = echoed(b"SAR1-4", b"SAR2-4")
UNBLANK = echoed(b"BAO1-0-0", b"BAO2-0-0")
CENTRE = echoed(b"SAO1-32767", b"SAO2-32767")
DISARM = echoed(b"PAS1-0-1", b"PAS2-0-1", b"PDS0-0-1", b"SDO0-0")
SET_UP = [*QUIET, *RANGES, *UNBLANK, *CENTRE]
OPENING = [*IDENTIFY, *SET_UP]
CLEAR = echoed(b"PAC1", b"PAC2", b"PDC0")


@pytest.fixture(params=[0, 1, 7, 512], ids=["whole", "byte-by-byte", "7", "512"])
def talk(
    request: pytest.FixtureRequest,
    dark_bench: Callable[..., SimulatedBench],
    transcript: Callable[..., object],
    chopped: Callable[..., object],
) -> Callable[..., TriggerScope]:
    """talk(*dialogue): an opened driver whose controller answers what is written."""
    devices = []

    def open_with(*dialogue: tuple[bytes, bytes], banner: bytes = BANNER, **settings: object) -> TriggerScope:
        bench = dark_bench()
        devices.append(transcript(dialogue, banner))
        unplug("written")
        url = plug("written", devices[-1], bench, latency_s=0.001)
        if request.param:
            plugged("written").mangle = chopped(request.param)
        return TriggerScope.open(TriggerScopeSettings(model="triggerscope", port=url, **settings), bench.clock)

    yield open_with
    assert all(device.finished for device in devices), "the driver did not say all that is written"


def test_it_opens_by_asking_who_answers_and_centring(talk: Callable[..., TriggerScope]) -> None:
    identity = talk(*OPENING).identity
    assert (identity.vendor, identity.product, identity.firmware) == ("ARC", "TriggerScope 16 R4 Board 4B", "v.620-MM")


def test_firmware_that_does_not_know_the_signal_leds_is_set_up_all_the_same(talk: Callable[..., TriggerScope]) -> None:
    """V.612-MM, which the vendor has owners of boards V4 load; a refusal of anything else is none of that."""
    unknown = (b"SSL0\n", b"ERROR_UNKNOWN_COMMAND\r\n")
    talk(*IDENTIFY, unknown, *SET_UP[1:])
    with pytest.raises(CommandRejected, match="PAC1"):
        talk(*IDENTIFY, unknown, (b"PAC1\n", b"ERROR_UNKNOWN_COMMAND\r\n"))


@pytest.mark.parametrize("reply", [b"!WAV%d-0-0-1-0\r\n", b"ERROR_UNKNOWN_COMMAND\r\n"], ids=["known", "unknown"])
def test_waves_are_forgotten_where_the_firmware_may_play_them(talk: Callable[..., TriggerScope], reply: bytes) -> None:
    banner = BANNER.replace(b"v.620", b"v.622")
    none = [(b"WAV%d-0-0-1-0\n" % dac, reply % dac if b"%d" in reply else reply) for dac in (1, 2)]
    talk(SPOIL, (b"*\n", banner), (b"*\n", banner), SET_UP[0], *none, *SET_UP[1:], banner=banner)


@pytest.mark.parametrize(
    "other",
    [
        b"ARC TRIGGERSCOPE 16 R3C v.605-MM",
        b"ARC TRIGGERSCOPE MINI v.100-MM",
        b"ARC TRIGGERSCOPE 16 R4 BOARD 4v.612F - Experimental Wave Function",
    ],
)
def test_a_triggerscope_with_other_firmware_is_told_as_that(talk: Callable[..., TriggerScope], other: bytes) -> None:
    """The port is right: it is a board V3, a Mini with 5 V and 12 bits, or one that plays waves."""
    said = (b"*\n", other + b"\r\n")
    with pytest.raises(WrongDevice, match=r"does not drive\. Load .* V4 or V4B"):
        talk(SPOIL, said, said, banner=b"")


def test_a_shutter_output_is_closed_before_anything_else(talk: Callable[..., TriggerScope]) -> None:
    mirror = talk(*IDENTIFY, *DARK, *SET_UP, *echoed(b"SDO1-4", b"SDO1-0"), shutter_pin=11)
    mirror.set_shutter_line(True)
    mirror.set_shutter_line(False)


def test_ranges_are_set_as_it_opens_and_never_as_it_parks(talk: Callable[..., TriggerScope]) -> None:
    """Each SAR puts -10 V on the other axis."""
    mirror = talk(*OPENING, SPOIL, (b"PAN1\n", b"!PAN1-1200\r\n"), *DISARM, *CENTRE)
    mirror.park()


def test_half_a_line_is_not_completed_and_the_identity_is_asked_twice(talk: Callable[..., TriggerScope]) -> None:
    refused = (SPOIL[0], b"!ERROR_SDO: Format: SDOn-s\r\n")
    assert talk(refused, *IDENTIFY[1:], *SET_UP, banner=b"").identity.vendor == "ARC"
    with pytest.raises(WrongDevice, match=r"then b'ARC TRIGGERSCOPE 16 R3C"):
        talk(refused, (b"*\n", BANNER), (b"*\n", BANNER.replace(b"R4", b"R3C")), banner=b"")


def test_a_move_is_two_codes(talk: Callable[..., TriggerScope]) -> None:
    mirror = talk(*OPENING, *echoed(b"SAO1-49152", b"SAO2-16384"))
    mirror.move_to(MirrorAngles(math.radians(20.0), math.radians(-20.0)))  # 10 deg mechanical: 5 V


def test_a_sequence_is_loaded_with_markers_started_and_stopped(talk: Callable[..., TriggerScope]) -> None:
    load = [
        (b"PAO1-0-49152-32768-16384\n", b"!PAO1-0-3-3\r\n"),
        (b"PAO2-0-32768-32768-32768\n", b"!PAO2-0-3-3\r\n"),
        (b"PDO0-0-5-2-1\n", b"!PDO0-0-3-3\r\n"),
    ]
    start = echoed(b"SAO1-49152", b"SAO2-32768", b"SDO0-0", b"PAS1-1-1", b"PAS2-1-1", b"PDS0-1-1")
    mirror = talk(*OPENING, *CLEAR, *load, *start, *DISARM)
    mirror.load([MirrorAngles(math.radians(x_deg), 0.0) for x_deg in (20.0, 0.0, -20.0)])
    mirror.start()
    mirror.stop()


def test_a_sequence_whose_count_disagrees_is_cleared_and_sent_once_more(talk: Callable[..., TriggerScope]) -> None:
    load = [(b"PAO1-0-32768\n", b"!PAO1-0-1-1\r\n"), (b"PAO2-0-32768\n", b"!PAO2-0-1-1\r\n")]
    wrong = (b"PAO1-0-32768\n", b"!PAO1-0-0-0\r\n")
    mirror = talk(*OPENING, *CLEAR, wrong, *CLEAR, *load, (b"PDO0-0-5\n", b"!PDO0-0-1-1\r\n"))
    mirror.load([MirrorAngles(0.0, 0.0)])


def test_another_device_on_the_port_is_refused(talk: Callable[..., TriggerScope]) -> None:
    with pytest.raises(WrongDevice, match=r"says b'GRBL 1.1'.*Correct `port`"):
        talk((SPOIL[0], b"ERROR_1\r\n"), (b"*\n", b"GRBL 1.1\r\n"), (b"*\n", b"GRBL 1.1\r\n"), banner=b"")


@pytest.mark.parametrize("name", ["PAO", "PDO"])
@given(values=st.lists(st.integers(0, 255), min_size=1, max_size=wire.STATES))
@example(values=[k % 256 for k in range(wire.STATES)])  # drawn lists are short
def test_uploaded_lines_hold_every_value_once_and_fit_the_controllers_buffers(name: str, values: list[int]) -> None:
    lines = list(wire.load_states(9, values) if name == "PAO" else wire.load_masks(1, values))
    parsed: list[int] = []
    for line, reply in lines:
        numbers = [int(number) for number in line[3:-1].split(b"-")]
        assert numbers[1] == len(parsed)
        parsed += numbers[2:]
        assert len(numbers) - 2 <= 99
        assert len(reply) < 20
    assert parsed == values


def test_what_overruns_the_controllers_memory_is_refused_before_anything_is_sent(
    talk: Callable[..., TriggerScope],
) -> None:
    mirror = talk(*OPENING)
    with pytest.raises(LimitError, match="1201 positions"):
        mirror.load([MirrorAngles(0.0, 0.0)] * 1201)
    with pytest.raises(LimitError, match="Load 1 to 1200"):
        mirror.load([])
    with pytest.raises(CommandRejected, match="no sequence"):
        mirror.start()
    with pytest.raises(ValueError, match="1 to 9"):
        list(wire.load_states(10, [0]))
    with pytest.raises(ValueError, match="room for 1200"):
        list(wire.load_states(1, [0] * 1201))


def test_positions_beyond_the_head_are_refused_before_anything_is_sent(talk: Callable[..., TriggerScope]) -> None:
    mirror = talk(*OPENING, x=AxisSettings(dac=1, volts_per_degree=0.6))
    with pytest.raises(
        LimitError, match=r"mirror y = -40.10 deg optical is outside \+-40.00 deg optical. Shrink the wall"
    ):
        mirror.move_to(MirrorAngles(0.0, math.radians(-40.1)))
    with pytest.raises(LimitError, match=r"mirror x = \+34.00 deg optical needs \+10.200 V"):
        mirror.load([MirrorAngles(math.radians(34.0), 0.0)])
    for bad in (math.nan, math.inf):
        with pytest.raises(LimitError):
            mirror.check(MirrorAngles(bad, 0.0))
    last_v = 10.0 - wire.SPAN_V / wire.CODES  # 16 bits hold no code for +10 V itself
    assert wire.code_for(math.radians(2 * last_v), 1.0, 0.0) == wire.CODES - 1
    assert wire.code_for(math.radians(-20.0), 1.0, 0.0) == 0
    with pytest.raises(ValueError, match=r"\+10.000 V"):
        wire.code_for(math.radians(20.0), 1.0, 0.0)


@given(
    angle_deg=st.floats(-30, 30),
    volts_per_degree=st.floats(0.1, 0.6),
    sign=st.sampled_from([1, -1]),
    offset=st.floats(-0.5, 0.5),
)
def test_codes_stand_for_their_angles_within_half_a_step(
    angle_deg: float, volts_per_degree: float, sign: int, offset: float
) -> None:
    code = wire.code_for(math.radians(angle_deg), sign * volts_per_degree, offset)
    back_deg = math.degrees(wire.angle_for(code, sign * volts_per_degree, offset))
    assert abs(back_deg - angle_deg) <= 2.0 * wire.SPAN_V / wire.CODES / 2.0 / volts_per_degree * 1.001


@given(st.integers(1, 1200))
def test_markers_alternate_so_that_every_step_is_one_edge(count: int) -> None:
    masks = wire.marker_masks(count)
    assert [mask & 3 for mask in masks] == [1 + index % 2 for index in range(count)]
    assert [mask >> 2 for mask in masks] == [1] + [0] * (count - 1)


@pytest.mark.parametrize(
    "wrong", [{"x": {"dac": 2}}, {"x": {"dac": 10}}, {"y": {"dac": 2, "volts_per_degree": 0.0}}, {"shutter_pin": 3}]
)
def test_impossible_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        TriggerScopeSettings.model_validate({"model": "triggerscope", "port": "COM3", **wrong})
