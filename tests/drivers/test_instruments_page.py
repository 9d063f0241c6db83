"""The published profile and the page about wiring say what the code does."""

import re
from pathlib import Path

from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.instruments import light_of
from nlos.drivers.simulated.tcspc488.firmware import Tcspc488Firmware
from nlos.drivers.tcspc.known_counters import COUNTERS

PAGE = (Path(__file__).parents[2] / "docs" / "instruments.md").read_text("utf-8")


def headers_of_the_profile() -> set[str]:
    """Every header of the table, with the common root written out (`INP:SYNC:LEV`, `:EDGE` -> `INP:SYNC:EDGE`)."""
    table = PAGE[PAGE.index("| command (query with") : PAGE.index("**Record**")]
    found: set[str] = set()
    for row in table.splitlines()[2:]:
        root = ""
        for word in re.findall(r"`([*:A-Z][A-Z:?]+)", row.split(" | ")[0]):
            header = word.removesuffix("?")
            if header.startswith(":"):
                header = root + header
            root = header.rpartition(":")[0]
            found.add(header)
    return found


def test_every_command_of_the_firmware_is_published_and_no_other() -> None:
    firmware = Tcspc488Firmware(SimulatedBench(light_of(load("bench", "simulated", BenchSettings).settings)))
    known = {header.removesuffix("?") for header in firmware._handlers()} - {"SYST:ERR:NEXT"}
    assert headers_of_the_profile() == known


def test_the_udev_rules_are_those_that_the_program_advises() -> None:
    blocks = [MIRRORS[name].settings(model=name, port="") for name in ("triggerscope", "optotune")]
    blocks.append(MIRRORS["helios"].settings(model="helios"))
    blocks.append(COUNTERS["tcspc488"].settings(model="tcspc488"))
    for block in blocks:
        assert block.udev_rule
        assert block.udev_rule in PAGE
