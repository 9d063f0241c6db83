"""Every fault that the simulators can commit, by name: what happens, what the user sees, what is kept.

Each model brings its own (`DeviceModel.faults`), those of installed packages too. `docs/faults.md` is this table: print
it with `python -m nlos.drivers.simulated.fault_catalogue`.
"""

from collections.abc import Sequence
from typing import Any

from nlos.drivers.device_model import DeviceModel
from nlos.drivers.galvo.known_mirrors import MIRRORS
from nlos.drivers.simulated.fault_row import FaultRow
from nlos.drivers.simulated.faults import Fault
from nlos.drivers.simulated.serial.faults import FAULTS as SERIAL
from nlos.drivers.tcspc.known_counters import COUNTERS


def tables() -> dict[str, Sequence[FaultRow]]:
    """Title -> rows: serial lines, then each model that has faults of its own."""
    models: list[DeviceModel[Any]] = [*MIRRORS.values(), *COUNTERS.values()]
    return {"Serial lines": SERIAL} | {f"`{each.name}`": each.faults for each in models if each.faults}


CATALOGUE = "nlos.drivers.simulated.fault_catalogue"
"""The module that prints the table: this one, whatever it is called as it is run."""


def refusal(fault: Fault) -> str:
    """Why a bench file may not ask for it, and what it may; empty for one that is in the table, as it is written."""
    rows = [row for each in tables().values() for row in each if row.name == fault.name]
    if not rows:
        return f"no fault of that name: {fault.name}. `python -m {CATALOGUE}` prints all of them"
    unknown = min((row.unknown(fault.parameters) for row in rows), key=len)
    if not unknown:
        return ""
    takes = "; or ".join(row.parameters for row in rows if row.parameters) or "none"
    return f"fault {fault.name} has no parameter {', '.join(unknown)}; it takes: {takes}"


_HEAD = """# Faults, by name

What can go wrong between this program and its instruments, what you see when it does, and what is kept. Every row can
be rehearsed on the simulated bench:

```yaml
simulation:
  faults:
    - {name: G2, after_s: 1.0, times: 1, parameters: {delay_s: 2.0}}
```

A fault strikes at the first occasion after `after_s` of bench time and after `skip` earlier occasions, `times` times.
Every error closes the shutter before anything else, but for the one that takes the shutter's own line away (G8 with a
TTL shutter, U11): then the command says that the shutter is NOT CONFIRMED CLOSED. A scan ends with 9 where a deadline
passed, 5 for `SafetyTrip` and `SyncLost`, 3 for every other error of an instrument
([exit codes](exit-codes.md)). "Acknowledged" is what has been flushed to the recording; a scan
that was ended by a fault is resumed by `nlos scan SCAN -o RUN.h5 --resume`, and then holds the same counts as one that
was never disturbed.

*This page is made by `python -m nlos.drivers.simulated.fault_catalogue`, from what each model brings with it. Run on a
computer where a package with a device of its own is installed, it lists the faults of that one, too.*
"""


def markdown() -> str:
    """The page `docs/faults.md`."""
    parts = [_HEAD]
    for title, rows in tables().items():
        parts += [
            f"\n## {title}\n\n",
            "| | what happens | what you see | what is kept | parameters |\n|---|---|---|---|---|\n",
        ]
        parts += [f"| {row.name} | {row.happens} | {row.seen} | {row.kept} | {row.parameters} |\n" for row in rows]
    return "".join(parts)


if __name__ == "__main__":
    print(markdown(), end="")
