"""What is asked for a bench file: in which order, with which default, and what an answer may be."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import radians, tan

from nlos.configs.describe import describe
from nlos.drivers.device_settings import DeviceSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.tcspc.block import CounterBlock, Pulse
from nlos.drivers.tcspc.known_counters import COUNTERS
from nlos.new_bench.attenuators import needs_attenuator
from nlos.new_bench.detection import Detected, devices_of

Answers = Mapping[str, str]
YES_OR_NO = ("yes", "no")
_USUAL_REACH_DEG = 10.0
"""Mechanical, of a mirror whose settings do not say it in these words."""


@dataclass(frozen=True)
class Question:
    """One question. `choices` empty: a number (`number`) or any text. `default` None: a person has to know."""

    key: str
    text: str
    default: str | None = None
    choices: tuple[str, ...] = ()
    number: tuple[float, float] | None = None
    real: bool = False
    """Whether it is an address, where only that of a real instrument will do."""

    def refusal(self, answer: str) -> str:
        """Why this is no answer; empty where it is one."""
        if self.choices:
            return "" if answer in self.choices else f"{answer!r} is not one of {', '.join(self.choices)}"
        if self.number is not None:
            low, high = self.number
            try:
                return "" if low <= float(answer) <= high else f"{answer} is not within {low:g} to {high:g}"
            except ValueError:
                return f"{answer!r} is not a number"
        if self.real and (answer == "simulated" or answer.startswith("sim:")):
            return (
                f"{answer!r} is a simulated instrument: `nlos new bench --simulated` makes such a table, without asking"
            )
        return "" if answer.strip() else "an answer is needed"


Asking = Callable[[Answers], Question | None]


def questions(found: Detected, simulated: bool) -> "list[Asking]":
    """Each takes the answers so far; None: there is nothing to ask."""
    mirrors, counters = tuple(MIRRORS), tuple(COUNTERS)
    first_mirror = (*found.mirrors, *mirrors)[0]
    first_counter = (*found.counters, *counters)[0]

    def mirror_of(said: Answers) -> type[DeviceSettings]:
        return MIRRORS[said["mirror"]].settings

    def counter_of(said: Answers) -> type[CounterBlock]:
        settings = COUNTERS[said["counter"]].settings
        assert issubclass(settings, CounterBlock)
        return settings

    def port(said: Answers) -> Question | None:
        if mirror_of(said).cable != "serial" or simulated:
            return None
        seen = f"there: {', '.join(found.ports)}" if found.ports else "none is plugged in"
        return Question("port", f"its serial port ({seen})", (*found.ports, "/dev/ttyACM0")[0], real=True)

    def volts(said: Answers) -> Question | None:
        if "volts_per_degree" not in keys_of_axis(mirror_of(said)):
            return None
        text = "volts of the galvo driver per degree that a mirror turns (mechanical)"
        return Question("volts_per_degree", text, "0.5", number=(0.01, 10))

    def reach(said: Answers) -> Question | None:
        field = mirror_of(said).model_fields.get("max_mechanical_deg")
        if field is None:
            return None
        text = "degrees that a mirror may turn either way (mechanical; the beam turns twice that, optical)"
        return Question("max_mechanical_deg", text, f"{field.default:g}", number=(0.1, 45))

    def device(said: Answers) -> Question | None:
        kinds = devices_of(counter_of(said))
        return Question("device", "which instrument", kinds[-1], kinds) if kinds else None

    def pulse(key: str, text: str) -> Asking:
        def ask(said: Answers) -> Question | None:
            takes, device, role = counter_of(said), said.get("device", ""), key.removesuffix("_pulse")
            if role not in takes.model_fields:
                return None
            kinds: tuple[Pulse, ...] = ("nim", "ttl")
            taken = tuple(each for each in kinds if takes.pulse_keys(each, device) is not None)
            words = f"{text}: nim (0 to -0.8 V) or ttl (0 to 3 V or more"
            words += ", behind an attenuator)" if needs_attenuator(takes, role) else ")"
            if len(taken) < len(kinds):
                words += "; this counter takes no other, put a converter into the cable"
            return Question(key, words, takes.usual_pulse if takes.usual_pulse in taken else taken[0], taken)

        return ask

    def inputs(said: Answers) -> Question | None:
        fields = counter_of(said).model_fields
        if "input" not in fields and not has_channels(counter_of(said)):
            return None
        default = "2" if has_channels(counter_of(said)) else "1"
        return Question("detector_input", "the detector's input, as printed on the front", default, number=(1, 64))

    def sync_input(said: Answers) -> Question | None:
        if not has_channels(counter_of(said)):
            return None
        return Question("sync_input", "the laser's sync input, as printed on the front", "1", number=(1, 64))

    def markers(said: Answers) -> Question | None:
        field = counter_of(said).model_fields.get("markers")
        if field is None or field.annotation is not bool or not hasattr(mirror_of(said), "marker_output_v"):
            return None
        text = "are the controller's TTL outputs 1 to 3 wired to the counter's marker inputs, and its clock to TRIG IN"
        return Question("markers", text, "yes" if simulated else "no", YES_OR_NO)

    def pixel_clock(said: Answers) -> Question | None:
        if "pixel_clock" not in counter_of(said).model_fields or not hasattr(mirror_of(said), "trigger_input"):
            return None
        text = "the counter's clock output that is wired to TRIG IN, with markers wired back (0: none)"
        return Question("pixel_clock", text, "1" if simulated else "0", ("0", "1", "2"))

    def shutter(said: Answers) -> Question | None:
        outputs = (*COUNTERS[said["counter"]].shutters, *MIRRORS[said["mirror"]].shutters, "none")
        text = "what closes the laser's shutter (none: nothing that this program drives)"
        return Question("shutter", text, outputs[0], outputs)

    def shutter_output(said: Answers) -> Question | None:
        needs = shutter_key(said)
        if needs == "shutter_pin":
            return Question(needs, "the controller's TTL output that the shutter is wired to", "9", number=(9, 16))
        return Question(needs, describe(mirror_of(said))[needs].what) if needs else None  # of another package

    def half_width(said: Answers) -> Question | None:
        reach_deg = min(2 * float(said.get("max_mechanical_deg", _USUAL_REACH_DEG)), 60.0)
        reach_m = float(said["wall_distance_m"]) * tan(radians(reach_deg))
        aside_m = max(abs(float(said["scanner_x_m"])), abs(float(said["scanner_y_m"])))
        text = "how far from the wall's centre the beam may be sent to the left and right, in metres"
        return Question("half_m", text, f"{max(0.05, min(1.0, 0.7 * reach_m - aside_m)):.2g}", number=(0.001, 50))

    def half_height(said: Answers) -> Question | None:
        return Question("half_height_m", "how far up and down, in metres", said["half_m"], number=(0.001, 50))

    wall = Question("wall_distance_m", "metres from the second mirror to the wall, straight ahead",
                    "2.0" if simulated else None, number=(0.05, 100))  # fmt: skip
    lever = Question("mirror_separation_m", "metres between the two mirrors (0 for one that turns both ways)",
                     "0.0", number=(0, 1))  # fmt: skip
    right = Question("scanner_x_m", "metres that the mirrors stand right of the wall's centre (left: negative; 0 if "
                     "not measured: spots find it)", "0.0", number=(-50, 50))  # fmt: skip
    above = Question(
        "scanner_y_m", "metres that they stand above it (below: negative; 0 if not measured)", "0.0", number=(-50, 50)
    )
    yaw = Question("wall_yaw_deg", "degrees by which the wall's right edge swings away from the mirrors (towards them: "
                   "negative)", "0.0", number=(-59, 59))  # fmt: skip
    pitch = Question("wall_pitch_deg", "degrees by which its top edge leans away (towards them: negative)", "0.0",
                     number=(-59, 59))  # fmt: skip
    laser = Question("repetition_hz", "laser pulses a second", "10e6" if simulated else None, number=(1e3, 1e9))
    return [
        lambda said: Question("mirror", "mirror controller", first_mirror, mirrors), port, volts, reach,
        lambda said: Question("counter", "photon counter", first_counter, counters), device,
        sync_input, inputs,
        pulse("sync_pulse", "the laser's sync pulse"), pulse("detector_pulse", "the detector's pulse"),
        markers, pixel_clock,
        shutter, shutter_output, lambda said: wall, lambda said: lever, lambda said: right, lambda said: above,
        lambda said: yaw, lambda said: pitch, half_width, half_height, lambda said: laser,
    ]  # fmt: skip


def shutter_key(said: Answers) -> str:
    """The key of the mirror's block that says where the shutter is wired to; empty where it has none."""
    output = MIRRORS[said["mirror"]].shutters.get(said["shutter"])
    return "" if output is None else output.needs


def has_channels(settings: type[CounterBlock]) -> bool:
    """Whether sync and detector name their inputs each in a block of its own, edges by sign."""
    field = settings.model_fields.get("sync")
    return "channel" in getattr(field and field.annotation, "model_fields", ())


def keys_of_axis(settings: type[DeviceSettings]) -> tuple[str, ...]:
    """What the block of one axis of a mirror takes; empty where it has none."""
    field = settings.model_fields.get("x")
    return tuple(getattr(field and field.annotation, "model_fields", ()))
