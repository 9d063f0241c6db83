"""Whether this program was started from a terminal that is not at the bench."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

_SAID_BY = ("SSH_CONNECTION", "SSH_CLIENT", "SSH_TTY", "MOSH_CONNECTION")
_SERVERS = ("sshd", "mosh-server", "dropbear", "telnetd", "in.telnetd")
_MOST_ANCESTORS = 64


def remote_terminal(environment: Mapping[str, str] | None = None, processes: Path = Path("/proc")) -> str | None:
    """How this terminal is reached from afar, in words; None where nothing says that it is.

    Asks the environment and, where the operating system tells, the programs that started this one: `sudo` takes SSH's
    variables away. A terminal multiplexer that was started at the bench and is looked at from afar is not noticed, nor
    is a remote desktop.
    """
    said = os.environ if environment is None else environment
    for name in _SAID_BY:
        if said.get(name):
            return f"{name}={said[name]}"
    return next((f"started by {name}" for name in _ancestors(processes) if name.startswith(_SERVERS)), None)


def _ancestors(processes: Path) -> Iterator[str]:
    """Names of the programs above this one, as Linux tells them."""
    number = os.getpid()
    for _ in range(_MOST_ANCESTORS):
        try:
            before, _, after = (processes / str(number) / "stat").read_text(errors="replace").rpartition(")")
        except OSError:
            return
        yield before.partition("(")[2]
        if (number := int(after.split()[1])) <= 1:
            return
