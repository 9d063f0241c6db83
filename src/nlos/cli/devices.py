"""`nlos devices`: what is plugged in, what the bench file expects, and how to fix the difference. Opens nothing that
moves or shines."""

import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from nlos.cli.benches import load_bench
from nlos.cli.exit_codes import ExitCode
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.drivers.bench import BenchSettings
    from nlos.drivers.link.usbtmc import UsbInfo


@dataclass(frozen=True)
class Expected:
    """One instrument of the bench file. `remedy` is empty where it is there."""

    role: str
    model: str
    address: str
    found: bool
    what: str
    remedy: str = ""


def devices(
    bench: Annotated[str | None, typer.Option(metavar="BENCH", help="Default: the simulated bench.")] = None,
) -> int:
    """Lists ports, USB instruments and libraries; exits with 3 where something that the bench names is missing."""
    from nlos.drivers.link.serial_line import available_ports

    table = load_bench(bench)
    ports, (instruments, usb_trouble) = available_ports(), usb_instruments()
    for port in ports:
        terminal.result(f"port  {port.port}  {port.description} {port.serial_number}".rstrip())
    for each in instruments:
        name = f"{each.product} {each.serial_number}" if each.readable else "not readable by this user"
        terminal.result(f"usb   {each.vendor_id:04x}:{each.product_id:04x}  {name}")
    if usb_trouble:
        terminal.result(f"usb   {usb_trouble}")
    if not ports and not instruments:
        terminal.result("nothing is plugged in that could be a mirror controller or a counter")
    terminal.result("")
    expected = expectations(table.settings, instruments, usb_trouble)
    for item in expected:
        terminal.result(
            f"{'there  ' if item.found else 'MISSING'}  {item.role} {item.model} at {item.address}: {item.what}"
        )
        if item.remedy:
            terminal.result(f"         {item.remedy}")
    terminal.document.update(
        bench=table.settings.name,
        ports=[asdict(port) for port in ports],
        usb=[asdict(each) for each in instruments],
        expected=[asdict(item) for item in expected],
    )
    return ExitCode.DONE if all(item.found for item in expected) else ExitCode.DEVICE


def expectations(settings: "BenchSettings", instruments: "list[UsbInfo]", usb_trouble: str) -> list[Expected]:
    """What the bench file names, and whether it is there."""
    if settings.simulated:
        return _simulated(settings)
    return [_mirror(settings), _counter(settings, instruments, usb_trouble)]


def usb_instruments() -> "tuple[list[UsbInfo], str]":
    """Those that are plugged in, and why they cannot be searched for where that is so."""
    from nlos.drivers.errors import DeviceError
    from nlos.drivers.link.usbtmc import available_instruments

    try:
        return available_instruments(), ""
    except DeviceError as error:
        return [], str(error)


def _simulated(settings: "BenchSettings") -> list[Expected]:
    """A simulated bench is there by being opened."""
    from nlos.drivers.bench import open_bench
    from nlos.drivers.errors import DeviceError

    address = str(getattr(settings.counter, "usb", "") or getattr(settings.counter, "library", ""))
    named = [("mirror", settings.mirror.model, settings.mirror.port), ("counter", settings.counter.model, address)]
    try:
        with open_bench(settings) as bench:
            said = [f"{who.product} {who.serial or who.firmware}, simulated" for who in bench.identities]
    except DeviceError as error:
        failed = next((model for _, model, _ in named if error.device.startswith(model)), None)
        if failed is None:
            raise
        return [
            Expected(*each, False, error.what, error.remedy)
            if each[1] == failed
            else Expected(*each, True, "simulated")
            for each in named
        ]
    return [Expected(*each, True, what) for each, what in zip(named, said, strict=True)]


def _mirror(settings: "BenchSettings") -> Expected:
    from nlos.drivers.link.serial_line import available_ports
    from nlos.drivers.udev import RELOAD, RULES_FILE, ST_VENDOR_ID, TEENSY_VENDOR_ID, tty_rule

    model, port = settings.mirror.model, settings.mirror.port
    path = Path(port)
    known = {info.port for info in available_ports()}
    if not (path.exists() or port in known or "://" in port):
        return Expected(
            "mirror", model, port, False, "no such port", f"Plug it in, or correct `port`: {_listed(known)}."
        )
    if path.exists() and not os.access(path, os.R_OK | os.W_OK):
        rule = tty_rule(TEENSY_VENDOR_ID if model == "triggerscope" else ST_VENDOR_ID, model)
        return Expected(
            "mirror", model, port, False, "this user may not open it",
            f"Join the group that owns it (usually dialout), or put into {RULES_FILE}: {rule} ({RELOAD}).",
        )  # fmt: skip
    return Expected("mirror", model, port, True, "the port is there; `nlos doctor` asks who answers")


def _counter(settings: "BenchSettings", instruments: "list[UsbInfo]", usb_trouble: str) -> Expected:
    counter = settings.counter
    if counter.model == "picoquant":
        return _library(counter)
    from nlos.drivers.udev import RELOAD, RULES_FILE, usb_rule

    model, wanted = counter.model, counter.usb
    ids = (counter.vendor_id, counter.product_id)
    rule = usb_rule(*ids)
    matching = [each for each in instruments if (each.vendor_id, each.product_id) == ids]
    missing = [each for each in matching if not each.readable]
    serials = [each.serial_number for each in matching if each.readable]
    if usb_trouble:
        return Expected("counter", model, wanted, False, "USB cannot be searched", usb_trouble)
    if missing:
        remedy = f"Put into {RULES_FILE}: {rule} ({RELOAD})."
        return Expected("counter", model, wanted, False, "this user may not open it", remedy)
    if not matching:
        remedy = "Check cable and power; correct vendor_id and product_id if it has others."
        return Expected("counter", model, wanted, False, f"no USB device {ids[0]:04x}:{ids[1]:04x}", remedy)
    if wanted == "auto" and len(serials) > 1:
        return Expected("counter", model, wanted, False, "there are several", f"Name one: {_listed(set(serials))}.")
    if wanted not in ("auto", *serials):
        what = f"another one is plugged in: {_listed(set(serials))}"
        return Expected("counter", model, wanted, False, what, "Plug in the one that is named, or correct `usb`.")
    return Expected(
        "counter", model, wanted, True, f"{matching[0].product} {wanted if wanted != 'auto' else serials[0]}"
    )


def _library(counter: Any) -> Expected:
    """A vendor's instrument is behind its library: whether that loads is all that can be seen without opening it."""
    from nlos.drivers.errors import DeviceNotFound
    from nlos.drivers.tcspc.picoquant.families import FAMILIES
    from nlos.drivers.tcspc.picoquant.library import load_library

    family = FAMILIES[counter.device]
    try:
        load_library(counter.model, family, counter.library)
    except DeviceNotFound as error:
        return Expected("counter", counter.model, counter.library, False, error.what, error.remedy)
    return Expected("counter", counter.model, counter.library, True, f"the library of the {family.product} loads")


def _listed(words: set[str]) -> str:
    return ", ".join(sorted(words)) or "there are none"
