"""`nlos devices` and whoever opens the device tell the same: there, missing, not this user's, or several."""

import itertools
from types import SimpleNamespace
from typing import Any

import pytest
import usb.core

from nlos.drivers.errors import DeviceError
from nlos.drivers.link import usb_search
from nlos.drivers.link.usb_search import UsbInfo, find_usb
from nlos.drivers.presence import usb_presence

IDS = (0x1209, 0x0001)
NOT_OURS = None


class Plugged(SimpleNamespace):
    """A USB device of this kind; the serial number of one that this user may not read is `NOT_OURS`."""

    @property
    def serial_number(self) -> str:
        if self.number is NOT_OURS:
            raise usb.core.USBError("Access denied", -3, 13)
        return str(self.number)


@pytest.mark.parametrize("wanted", ["auto", "A", "B"])
@pytest.mark.parametrize(
    "numbers",
    [each for many in range(4) for each in itertools.combinations_with_replacement(("A", "B", "C", NOT_OURS), many)],
)
def test_what_is_said_to_be_there_is_what_is_found(
    monkeypatch: pytest.MonkeyPatch, numbers: tuple[str | None, ...], wanted: str
) -> None:
    devices = [Plugged(number=each) for each in numbers]
    monkeypatch.setattr(usb_search.usb.core, "find", lambda **_: devices)
    listed = [UsbInfo(*IDS, "TCSPC-488" if each else "", each or "", each is not NOT_OURS) for each in numbers]
    seen = usb_presence(IDS, wanted, "RULE", listed)
    found, refused = _searched(wanted)
    if found is None:
        assert not seen.found, refused
        assert seen.remedy
        if wanted == "auto" and len(numbers) > 1:
            assert all(each in refused for each in numbers if each is not NOT_OURS)
    else:
        # A single one that this user may not open is found, and refused as it is opened.
        assert seen.found == (found.number is not NOT_OURS)
        assert wanted == "auto" or found.number == wanted


def _searched(wanted: str) -> tuple[Any, str]:
    """What whoever opens it finds, or why nothing."""
    try:
        return find_usb("it", *IDS, None if wanted == "auto" else wanted), ""
    except DeviceError as error:
        return None, error.what
