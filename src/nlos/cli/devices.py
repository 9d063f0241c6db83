"""`nlos devices`: what is plugged in, what the bench file expects, and how to fix the difference. Opens nothing that
moves or shines."""

from contextlib import nullcontext
from dataclasses import asdict, dataclass

from nlos.cli.benches import load_bench, wire_logged
from nlos.cli.exit_codes import ExitCode
from nlos.cli.named_files import BenchWord
from nlos.cli.terminal import terminal
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceError
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.link.serial_line import available_ports
from nlos.drivers.link.usb_search import UsbInfo, available_instruments
from nlos.drivers.tcspc.known_counters import COUNTERS


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
    bench: BenchWord = None,
) -> int:
    """Lists ports, USB instruments and libraries; exits with 3 where something that the bench names is missing."""
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
    # Of a real bench nothing is opened: its log is begun all the same, and holds no byte.
    with nullcontext() if table.settings.simulated else wire_logged():
        expected = expectations(table.settings)
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


def expectations(settings: "BenchSettings") -> list[Expected]:
    """What the bench file names, and whether it is there."""
    if settings.simulated:
        return _simulated(settings)
    found = []
    for role, models, block in (("mirror", MIRRORS, settings.mirror), ("counter", COUNTERS, settings.counter)):
        there = models[block.model].look_for(block)
        found.append(Expected(role, block.model, block.address, there.found, there.what, there.remedy))
    return found


def usb_instruments() -> "tuple[list[UsbInfo], str]":
    """Those that are plugged in, and why they cannot be searched for where that is so."""
    try:
        return available_instruments(), ""
    except DeviceError as error:
        return [], str(error)


def _simulated(settings: "BenchSettings") -> list[Expected]:
    """A simulated bench is there by being opened."""
    blocks = (("mirror", settings.mirror), ("counter", settings.counter))
    named = [(role, block.model, block.address) for role, block in blocks]
    try:
        with wire_logged() as log, open_bench(settings, wire_log=log) as bench:
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
