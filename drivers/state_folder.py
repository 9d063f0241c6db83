"""The folder of what outlasts a program: trips, constants, the index of runs."""

import os
from pathlib import Path

STATE = "NLOS_STATE"
"""Environment variable: that folder; `~/.local/state/nlos` where it is not set."""


def state_folder() -> Path:
    """Where what outlasts a program is kept. Raises `FileNotFoundError` for a relative path, which is another folder
    elsewhere: whoever scans from there would not know of a trip."""
    named = os.environ.get(STATE)
    if named and not Path(named).is_absolute():
        raise FileNotFoundError(
            f"{STATE}={named}: is no whole path, so it would be another folder wherever a command is run, and trips "
            f"that are latched here would not be there. Name all of it: {STATE}={Path(named).expanduser().absolute()}"
        )
    return Path(named or Path.home() / ".local" / "state" / "nlos")
