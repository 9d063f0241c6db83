"""Every public function of `drivers` says what it gives, raises and rests on, itself or in the protocol it fulfils."""

import ast
import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial
import usb.backend

from nlos.drivers.clock import Clock
from nlos.drivers.galvo.mirror import GalvoMirror, MeasuresPosition, OwnClock
from nlos.drivers.link.scpi import MessageLink
from nlos.drivers.shutter import LaserShutter
from nlos.drivers.simulated.serial.cable import SerialFirmware
from nlos.drivers.simulated.timetagger.measurements import Measurement
from nlos.drivers.simulated.usb.control_requests import BulkTransfers
from nlos.drivers.simulated.usb.pipes import VendorDevice
from nlos.drivers.simulated.usb.usbtmc_device import Instrument
from nlos.drivers.tcspc.counter import HistogramCounter
from nlos.drivers.tcspc.timetagger.clocked import Clocked

TOP = Path(__file__).parents[2] / "drivers"
PROTOCOLS = (Clock, GalvoMirror, MeasuresPosition, OwnClock, LaserShutter, HistogramCounter, Clocked, MessageLink,
             SerialFirmware, BulkTransfers, VendorDevice, Instrument)  # fmt: skip
FULFILLED = {
    "": PROTOCOLS,
    "simulated/serial": (serial.SerialBase, serial.Serial),
    "simulated/usb": (usb.backend.IBackend,),
    "simulated/timetagger": (Measurement,),
}
VENDORS = "simulated/timetagger"
"""Functions by the vendor's names do what the vendor's reference says: the module's first lines say so."""


def documented(kinds: tuple[type, ...]) -> set[str]:
    return {name for kind in kinds for name, each in inspect.getmembers(kind) if inspect.getdoc(each)}


def public(node: ast.AST) -> Iterator[ast.FunctionDef]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.ClassDef) and not child.name.startswith("_"):
            if isinstance(child, ast.FunctionDef):
                yield child
            else:
                yield from public(child)


def is_setter(function: ast.FunctionDef) -> bool:
    return any(isinstance(each, ast.Attribute) and each.attr == "setter" for each in function.decorator_list)


@pytest.mark.parametrize("path", sorted(TOP.rglob("*.py")), ids=lambda path: str(path.relative_to(TOP)))
def test_every_public_function_is_told_about(path: Path) -> None:
    folder = path.relative_to(TOP).as_posix()
    known = set().union(*(documented(kinds) for part, kinds in FULFILLED.items() if folder.startswith(part)))
    silent = [
        f"{each.name}, line {each.lineno}"
        for each in public(ast.parse(path.read_text("utf-8")))
        if not ast.get_docstring(each) and each.name not in known and not is_setter(each)
        and not (folder.startswith(VENDORS) and each.name != each.name.lower())
    ]  # fmt: skip
    assert not silent
