"""The folder of what outlasts a program: trips, constants, the index of runs."""

import os
from pathlib import Path

STATE = "NLOS_STATE"
"""Environment variable: that folder; `~/.local/state/nlos` where it is not set."""


def state_folder() -> Path:
    """Where what outlasts a program is kept. Raises `FileNotFoundError` for a relative path, which is another folder
    elsewhere: whoever scans from there would not know of a trip; and where there is no home folder."""
    named = os.environ.get(STATE)
    if named and not Path(named).is_absolute():
        raise FileNotFoundError(
            f"{STATE}={named}: is no whole path, so it would be another folder wherever a command is run, and trips "
            f"that are latched here would not be there. Name all of it: {STATE}={Path(named).expanduser().absolute()}"
        )
    return Path(named) if named else home_folder() / ".local" / "state" / "nlos"


def home_folder() -> Path:
    """The home folder of whoever runs this. Raises `FileNotFoundError` where there is none, as for a user without a
    name in a container, and for one that is another wherever a command is run."""
    try:
        if os.environ.get("HOME") == "":
            raise RuntimeError  # to Python it is the root folder then, where nobody looks for a trip
        home = Path.home()
    except RuntimeError:
        raise FileNotFoundError(
            "no home folder: HOME is empty, or not set for a user whom the system does not know, so nothing that "
            f"outlasts the program, such as a trip, would be kept. Set {STATE}=/WHOLE/PATH, or HOME."
        ) from None
    if not home.is_absolute():
        raise FileNotFoundError(
            f"HOME={home}: is no whole path, so it would be another folder wherever a command is run. Set all of it: "
            f"HOME={home.absolute()}"
        )
    return home
