"""`nlos patterns`: the catalogue of scan patterns, and the settings of one."""

import difflib
from dataclasses import asdict
from typing import Annotated

import typer

from nlos.acquisition.planning.patterns import PATTERNS
from nlos.cli.exit_codes import UsageError
from nlos.cli.setting_table import show_settings
from nlos.cli.terminal import terminal
from nlos.configs.describe import describe, docstring


def patterns(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Show this pattern's settings.")] = None,
) -> None:
    """Every scan pattern, one line each; with NAME, its settings: what, unit, default, range."""
    found = {word: docstring(settings).partition("\n")[0] for word, settings in sorted(PATTERNS.items())}
    if name is None:
        width = max(map(len, found))
        for word, line in found.items():
            terminal.result(f"{word:<{width}}  {line}")
        terminal.result(
            "\n`nlos patterns NAME` lists the settings of one, for `pattern: {kind: NAME, ...}` in a scan file."
        )
        terminal.document["patterns"] = found
        return
    if name not in PATTERNS:
        near = difflib.get_close_matches(name, found, n=1)
        raise UsageError(
            f"there is no pattern '{name}'; " + (f"did you mean '{near[0]}'?" if near else f"known: {', '.join(found)}")
        )
    settings = [setting for key, setting in describe(PATTERNS[name]).items() if key != "kind"]
    terminal.result(f"{name}: {found[name]}\n")
    show_settings(settings)
    terminal.document["settings"] = [asdict(setting) for setting in settings]
