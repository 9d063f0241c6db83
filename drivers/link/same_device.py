"""The USB device behind a serial port's name. Plugged in anew it may have another name, and its name another device.

A program that has found its instrument at a port keeps to that adapter as long as it runs, wherever it is: a shutter on
a mirror controller is closed at /dev/ttyUSB1, too, and nothing is said to whoever is at /dev/ttyUSB0 since. From one
program to the next only the bench file can tell, by a name under /dev/serial/by-id. Cheap adapters have no serial
number: they are told apart by the socket that they are plugged into, and named under /dev/serial/by-path.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass

from nlos.drivers.errors import WrongDevice

_AT = "at "
"""Before a socket: no serial number begins so."""


@dataclass(frozen=True)
class PortInfo:
    """A serial port of this computer, as the operating system describes it."""

    port: str
    description: str
    serial_number: str
    vendor_id: int = 0
    """Of the USB device behind it; 0 where there is none."""
    socket: str = ""
    """Where on the computer that is plugged in; empty where the system does not say."""

    @property
    def adapter(self) -> tuple[int, str] | None:
        """What tells it from all others: its serial number or, of those that have none, its socket."""
        told_by = self.serial_number or (self.socket and f"{_AT}{self.socket}")
        return (self.vendor_id, told_by) if told_by else None


_found_at: dict[str, tuple[int, str]] = {}


def remember(url: str, ports: Sequence[PortInfo]) -> None:
    """The device that is meant by `url` is the one that is there now."""
    there = port_at(url, ports)
    if there is not None and there.adapter is not None:
        _found_at[url] = there.adapter


def port_of(device: str, url: str, ports: Sequence[PortInfo]) -> str:
    """Where the adapter is that was found at `url` before; `url` itself where none was, or where it is nowhere.

    Raises `WrongDevice` where another one has its name.
    """
    meant, there = _found_at.get(url), port_at(url, ports)
    if meant is None or (there is not None and there.adapter == meant):
        return url
    elsewhere = [each.port for each in ports if each.adapter == meant]
    if len(elsewhere) == 1:
        return elsewhere[0]
    if there is None or (meant[1].startswith(_AT) and not there.serial_number):
        return url  # plugged into another socket, perhaps: who answers is asked in any case
    raise WrongDevice(
        device,
        f"another adapter is at {url} (serial number {there.serial_number or 'unknown'}) than before ({meant[1]}).",
        "Plug the one that is meant in again; name it by /dev/serial/by-id as `port` in the bench file.",
    )


def port_at(url: str, ports: Sequence[PortInfo]) -> PortInfo | None:
    """The one of these ports that `url` names, by a link, too."""
    path = url if "://" in url else os.path.realpath(url)
    return next((each for each in ports if each.port in (url, path)), None)
