"""`nlos methods`: the catalogue of reconstruction methods, and the settings of one."""

from dataclasses import asdict
from typing import Annotated

import typer

from nlos.catalogue import method as one
from nlos.catalogue import methods as known
from nlos.cli.setting_table import show_settings
from nlos.cli.terminal import terminal


def methods(
    name: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="Show the settings of this method, or of the one in this file."),
    ] = None,
) -> None:
    """Every reconstruction method, one line each; with NAME, its settings: what, unit, default, range."""
    if name is None:
        found = known()
        width = max(map(len, found))
        for method in found.values():
            terminal.result(f"{method.name:<{width}}  {method.what}")
        terminal.result("\n`nlos methods NAME` lists the settings of one; use them as --set KEY=VALUE.")
        terminal.document["methods"] = {method.name: method.what for method in found.values()}
        return
    method = one(name)
    terminal.result(f"{name}: {method.what}\n")
    show_settings(method.settings.values())
    terminal.document["settings"] = [asdict(setting) for setting in method.settings.values()]
