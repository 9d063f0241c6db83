"""The folder of what outlasts a program: trips, constants, the index of runs."""

import os
from pathlib import Path

STATE = "NLOS_STATE"
"""Environment variable: that folder; `~/.local/state/nlos` where it is not set."""


def state_folder() -> Path:
    """Where what outlasts a program is kept."""
    return Path(os.environ.get(STATE) or Path.home() / ".local" / "state" / "nlos")
