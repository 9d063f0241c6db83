"""A controller whose supply dips at any command of a session: what it still says then, and how long it is deaf."""

import itertools
import math
from collections.abc import Callable

import pytest
from pydantic import TypeAdapter

from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.known_mirrors import MIRRORS, MirrorSettings, open_mirror
from nlos.drivers.galvo.mirror import GalvoMirror, MirrorAngles
from nlos.drivers.galvo.triggerscope.mirror import TriggerScope
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.serial.port import plug, plugged, unplug
from nlos.drivers.simulated.simulation_settings import SimulationSettings
from nlos.drivers.simulated.table import SimulatedTable

SETTINGS: TypeAdapter[MirrorSettings] = TypeAdapter(MirrorSettings)
MODELS = {"triggerscope": {"shutter_pin": 9}, "optotune": {"readback": True}}
PLACES = [MirrorAngles(0.02 * k, -0.03) for k in range(1, 5)]
LAST_WORDS = {"nothing": lambda said: b"", "half": lambda said: said[: len(said) // 2],
              "noise": lambda said: b"\xf8\x00\x9c\xff\x80", "all": lambda said: said}  # fmt: skip
DEAF_S = (0.01, 0.2, 0.45, 0.6, 1.2, 3.0)


def dips(bench: SimulatedBench, number: int, last_words: str, deaf_s: float) -> None:
    """From now on, at the n-th message to the controller."""
    cable = plugged("dips")
    firmware, hear = cable.firmware, cable.firmware.receive
    heard, until_s = 0, -1.0

    def receive(data: bytes, when_s: float) -> bytes:
        nonlocal heard, until_s
        heard += 1
        if heard == number:
            # What it carries out before it goes down is forgotten with the rest.
            said = LAST_WORDS[last_words](hear(data, when_s) if last_words in ("half", "all") else b"")
            cable._reply(said, when_s + 0.001)
            cable._reply(firmware.reboot(), when_s + deaf_s)
            until_s = when_s + deaf_s
        return b"" if when_s < until_s or heard == number else hear(data, when_s)

    firmware.receive = receive


def points_at(bench: SimulatedBench, place: MirrorAngles) -> bool:
    beam = bench.beam_at(bench.clock.now())
    return math.hypot(beam.x_rad - place.x_rad, beam.y_rad - place.y_rad) < 1e-3


def session(bench: SimulatedBench, mirror: GalvoMirror, told_late: bool) -> None:
    if isinstance(mirror, TriggerScope):
        mirror.set_shutter_line(True)
    for place in PLACES:
        mirror.move_to(place)
        bench.clock.sleep(0.05)
        mirror.look()
        assert told_late or points_at(bench, place)
    if isinstance(mirror, TriggerScope):
        mirror.set_shutter_line(False)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("number", range(1, 13))
def test_no_restart_goes_unnoticed_and_in_the_end_it_is_dark_and_centred(
    dark_bench: Callable[..., SimulatedBench], model: str, number: int
) -> None:
    for last_words, deaf_s in itertools.product(LAST_WORDS, DEAF_S):
        bench = dark_bench()
        made = SETTINGS.validate_python({"model": model, "port": "sim://dips", **MODELS[model]})
        unplug("dips")
        plug("dips", MIRRORS[model].firmware(made, SimulatedTable(bench, SimulationSettings(), 10e6)), bench, 0.001)
        mirror = open_mirror(made, bench.clock)
        dips(bench, number, last_words, deaf_s)
        # Nobody can know of a restart that began after the last answer before the start-up text has come.
        told_late = last_words == "all" and deaf_s > 0.05
        try:
            session(bench, mirror, told_late)
        except DeviceError:
            if isinstance(mirror, TriggerScope):
                for _ in range(5):  # as often as a bench that is closed tries
                    try:
                        mirror.set_shutter_line(False)
                        break
                    except DeviceError:
                        continue
        assert not bench.shutter_open
        mirror.park()
        assert points_at(bench, MirrorAngles(0.0, 0.0)), (last_words, deaf_s)
        mirror.close()
