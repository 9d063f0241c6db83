"""Which programs hold a port or a USB device, as Linux tells: a message that says "busy" should say by whom."""

import os
from collections.abc import Iterator
from pathlib import Path

_PROCESSES, _USB = Path("/proc"), Path("/sys/bus/usb/devices")


def owners_of(path: str, processes: Path = _PROCESSES) -> list[str]:
    """`NAME (PID N)` of every other program that has this file open; those of other users only for root. Empty where
    the operating system does not tell."""
    wanted = os.path.realpath(path)
    return [f"{_name(process)} (PID {process.name})" for process in _others(processes) if _holds(process, wanted)]


def held_by(path: str) -> str:
    """` by NAME (PID N)`, to stand behind "is held"; empty where nobody is found."""
    owners = owners_of(path)
    return f" by {', '.join(owners)}" if owners else ""


def usb_nodes(vendor_id: int, product_id: int, devices: Path = _USB) -> list[str]:
    """The files in /dev/bus/usb that are USB devices of these ids."""
    nodes = []
    for device in sorted(devices.glob("*")) if devices.is_dir() else []:
        try:
            ids = tuple(int((device / name).read_text(), 16) for name in ("idVendor", "idProduct"))
            if ids == (vendor_id, product_id):
                bus, number = (int((device / name).read_text()) for name in ("busnum", "devnum"))
                nodes.append(f"/dev/bus/usb/{bus:03d}/{number:03d}")
        except (OSError, ValueError):
            continue
    return nodes


def _others(processes: Path) -> Iterator[Path]:
    own = str(os.getpid())
    for process in processes.glob("[0-9]*") if processes.is_dir() else ():
        if process.name != own:
            yield process


def _holds(process: Path, wanted: str) -> bool:
    try:
        files = list((process / "fd").iterdir())
    except OSError:  # another user's, or over
        return False
    for file in files:
        try:
            if os.readlink(file) == wanted:
                return True
        except OSError:
            continue
    return False


def _name(process: Path) -> str:
    try:
        return (process / "comm").read_text(errors="replace").strip() or "a program"
    except OSError:
        return "a program"
