"""Settings as a list on the terminal: key, type and range, default, then what it means."""

import textwrap
from collections.abc import Iterable

from nlos.cli.columns import columns_shown
from nlos.cli.terminal import terminal
from nlos.configs.describe import Setting

WIDTH = 100


def show_settings(settings: Iterable[Setting]) -> None:
    """Prints every setting in two or more lines."""
    width = min(WIDTH, columns_shown() or WIDTH)
    for setting in settings:
        unit = f" in {setting.unit}" if setting.unit else ""
        given = f"default {setting.default}" if setting.default else "must be given"
        bounds = f" {setting.range}" if setting.range else ""
        terminal.result(f"{setting.name}: {setting.type}{unit}{bounds}; {given}")
        for line in textwrap.wrap(setting.what, width - 4):
            terminal.result(f"    {line}")
