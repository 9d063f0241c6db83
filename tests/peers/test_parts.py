"""Where `NLOS_PEERS` is given, every part that `docs/peers.md` names is there: nothing is skipped in silence."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs/peers.md").read_text(encoding="utf-8")
CHECKOUTS = re.findall(r"git clone .*/([\w.-]+)$", PAGE.partition("Then `NLOS_PEERS=")[0], re.MULTILINE)
PACKAGES = {
    "snapi": "snAPI",
    "pyvisa-py": "pyvisa_py",
    "pyusb": "usb",
    "phconvert": "phconvert",
    "Swabian-TimeTagger": "Swabian.TimeTagger",
    "mitransient": "mitsuba",  # itself it asks for a variant of that first
    "qmi": "qmi",
    "nidaqmx": "nidaqmx",
}


def test_the_page_names_the_parts() -> None:
    assert set(CHECKOUTS) == {
        "TriggerScopeMM", "tinyusb", "helios_dac", "coPylot", "MH150-Demos", "HH400-v3.x-Demos", "PH300-v3.x-Demos",
        "pyglotaran", "libpicoquant", "mmCoreAndDevices",
    }  # fmt: skip
    installed = re.search(r"pip install (.+)$", PAGE, re.MULTILINE)
    assert installed is not None
    assert set(installed[1].split()) == set(PACKAGES)


@pytest.mark.parametrize("name", CHECKOUTS)
def test_checkouts_are_there(checkout: Callable[..., Path], name: str) -> None:
    assert any(checkout(name).iterdir())


@pytest.mark.parametrize("module", PACKAGES.values())
def test_packages_are_there(foreign_python: Callable[..., Path], module: str) -> None:
    assert foreign_python(module).exists()
