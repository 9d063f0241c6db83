"""`nlos shutter close`: dark, whatever else on the bench is missing."""

from typing import Annotated

import typer

from nlos.cli.benches import load_bench, wire_logged
from nlos.cli.exit_codes import UsageError
from nlos.cli.named_files import BenchWord
from nlos.cli.terminal import terminal
from nlos.drivers.light_out import make_dark


def shutter(
    what: Annotated[str, typer.Argument(metavar="close")],
    bench: BenchWord = None,
) -> None:
    """Closes the laser shutter: only what drives it has to answer."""
    if what != "close":
        raise UsageError(f"shutter {what}: only `nlos shutter close` is known; scans open it by themselves.")
    table = load_bench(bench)
    with wire_logged() as log:
        make_dark(table.settings, log)
    terminal.result("the shutter is closed", shutter="closed")
