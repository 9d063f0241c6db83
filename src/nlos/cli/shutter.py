"""`nlos shutter close`: dark, whatever else on the bench is missing."""

from contextlib import ExitStack
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.cli.benches import DEFAULT_BENCH, load_bench, wire_logged
from nlos.cli.exit_codes import UsageError
from nlos.cli.named_files import BenchWord
from nlos.cli.terminal import terminal
from nlos.configs.load import ConfigError, load
from nlos.drivers.bench_settings import BenchSettings, LightSettings
from nlos.drivers.light_out import make_dark

if TYPE_CHECKING:
    from nlos.drivers.device_model import WireLog


def shutter(
    what: Annotated[str, typer.Argument(metavar="close")],
    bench: BenchWord = None,
) -> None:
    """Closes the laser shutter: only what drives it has to answer."""
    if what != "close":
        raise UsageError(f"shutter {what}: only `nlos shutter close` is known; scans open it by themselves.")
    settings = _what_drives_it(bench)
    with ExitStack() as stack:
        log: WireLog | None = None
        try:
            log = stack.enter_context(wire_logged())
        except OSError as error:
            terminal.log(f"warning: {str(error).rstrip('.')}. Nothing of what the devices say is logged.")
        make_dark(settings, log)
    terminal.result("the shutter is closed", shutter="closed")


def _what_drives_it(bench: str | None) -> BenchSettings | LightSettings:
    """The bench; of a file that is not valid the blocks of its instruments, where these are, with a warning."""
    try:
        return load_bench(bench).settings
    except ConfigError as error:
        try:
            light = load("bench", bench or DEFAULT_BENCH, LightSettings).settings
        except ConfigError:
            raise error from None
        if light.simulated:
            raise
        terminal.log(f"warning: {error}")
        return light
