"""Every fault that the simulators can commit, by name: what happens, what the user sees, what is kept.

`docs/faults.md` is this table. Print it with `python -m nlos.drivers.simulated.fault_catalogue`.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS


@dataclass(frozen=True)
class FaultRow:
    """`parameters`: what a bench file or a test may say about it; "built in" where it needs no asking for."""

    name: str
    happens: str
    seen: str
    kept: str
    parameters: str = ""


def _words(names: Iterable[str]) -> str:
    return ", ".join(f"`{name}`" for name in names)


_ALL = "everything acknowledged; the point under way is taken again by `--resume`"
_SAME = "everything: the scan goes on"

# fmt: off
SERIAL = (
    FaultRow("G1", "no reply",
             "`DeviceTimeout` within the timeout, shutter closed",
             _ALL),
    FaultRow("G2", "the reply comes after the timeout",
             "`DeviceTimeout`; the late reply is thrown away and never taken for the answer to the next command",
             _ALL, "`delay_s`"),
    FaultRow("G3", "a reply comes in two parts",
             "nothing, within the timeout",
             _SAME, "`at`, `delay_s`"),
    FaultRow("G4", "noise, NUL, other than ASCII, or a line without end",
             "`ProtocolError`",
             _ALL, "`kind`: `noise`, `nul`, `non_ascii`, `overlong`"),
    FaultRow("G5", "the echo names another axis or value",
             "`ProtocolError`; the position counts as unknown, nothing moves until the bench is opened again",
             _ALL),
    FaultRow("G6", "the controller restarts while in use",
             "`DeviceReset`, shutter closed; its settings are gone",
             _ALL),
    FaultRow("G7", "replies cut into pieces or run together",
             "nothing",
             _SAME, "`chunk` bytes (0: joined to the next), `gap_s`"),
    FaultRow("G8", "the cable is pulled",
             "`DeviceLost`, whichever of the three families of errors the port raises; within 20 ms also while "
             "nothing is said to the mirror",
             _ALL, "`place`: `read`, `write`, `in_waiting`, `flush`, ..."),
    FaultRow("G9", "the port takes no more bytes",
             "`DeviceTimeout`",
             _ALL, "`sent`"),
    FaultRow("G10", "the port is missing, in use, or not this user's",
             "`DeviceNotFound` or `DeviceBusy`, each with what to do; another device on the port: `WrongDevice`",
             "nothing was opened", "`kind`: `missing`, `busy`, `permission`"),
)
TRIGGERSCOPE = (
    FaultRow("A1", "two commands in one packet: the second is lost",
             "nothing: the driver has one command in flight",
             _SAME, "built in"),
    FaultRow("A2", "a command is refused",
             "`CommandRejected` with the controller's words",
             _ALL, "`kind`: `unknown`"),
    FaultRow("A3", "no SD card: no banner, every command confirmed, nothing moves",
             "`DeviceFault` before the first move, unless `allow_unverified_dac: true`, which is warned about",
             "nothing was moved"),
    FaultRow("A4", "a table is kept with another length than was sent",
             "nothing the first time (cleared and sent again), `ProtocolError` the second",
             _ALL),
    FaultRow("A5", "more states or a longer line than the controller holds",
             "`LimitError`, with nothing sent",
             "nothing was sent", "built in: the firmware overruns its memory"),
    FaultRow("A6", "a trigger edge is missed, or comes twice",
             "nothing: markers and points disagree, the segment is taken again",
             _SAME, "`kind`: `missed`, `extra`"),
    FaultRow("A7", "another program changes a range, which moves the mirror",
             "a warning: the shutter is closed, ranges are set and the mirror is centred, then the scan goes on",
             _SAME, "`range`"),
    FaultRow("A8", "left-over state: another program left it armed, blanked, open or in other ranges",
             "nothing: it is made dark, still and centred before anything else",
             _SAME, "`state`: " + _words(LEFT_OVERS)),
    FaultRow("A9", "half a line: another program was killed in the middle of a command",
             "nothing: the half line is spoiled, not completed",
             _SAME, "`line`: " + _words(HALF_LINES)),
)
OPTOTUNE = (
    FaultRow("B1", "`NO`, `OL`, `OU` or `ERROR` in reply to a position",
             "`CommandRejected`, or `LimitError` where it was clamped",
             _ALL, "`reply`: `NO`, `OL`, `OU`, `ERROR`"),
    FaultRow("B2", "the mirror never becomes stable",
             "`SettleTimeout` with STATUS and board faults; it is not moved again",
             _ALL),
    FaultRow("B3", "stable, then unstable again",
             "nothing: two stable readings in a row are asked for",
             _SAME),
    FaultRow("B4", "over-temperature, current limit, sensor lost",
             "`DeviceFault`, shutter closed; acknowledged by a person only",
             _ALL, "`bit`, `latched_only`"),
    FaultRow("B5", "stuck in Pro mode, a truncated, damaged or refused frame",
             "nothing where Simple mode comes back and the frame is whole the second time, else `ProtocolError`; "
             "`CommandRejected` for a refused one",
             _SAME, "`place`: `stuck`, `truncated`, `damaged`, `refused`"),
    FaultRow("B6", "it points elsewhere than commanded",
             "a warning with both positions; `DeviceFault` above the hard limit",
             _SAME, "`off`"),
)
TCSPC488 = (
    FaultRow("U1", "a query is not answered",
             "nothing: the transfer is aborted and the query asked again",
             _SAME),
    FaultRow("U2", "a timeout with part of the bytes, and no error",
             "nothing: the length is checked, the query asked again",
             _SAME, "`packets`"),
    FaultRow("U3", "an endpoint stalls",
             "nothing for queries; a trigger is not repeated: `DeviceError`",
             _ALL, "`place`: `in`, `out`, `control`"),
    FaultRow("U4", "an abort stays pending",
             "nothing where it ends, else `DeviceLost` after reset and deadline",
             _ALL, "`replies`"),
    FaultRow("U5", "wrong tag, complement, message or reserved byte",
             "nothing for queries (asked again), else `ProtocolError`; a stale reply is never returned",
             _SAME, "`field`: `tag`, `inverse`, `kind`, `reserved`"),
    FaultRow("U6", "a message split, cut, too long, or ended early",
             "nothing where whole, else asked again",
             _SAME, "`what`: `split`, `cut`, `early_end`; `size`"),
    FaultRow("U7", "no zero-length packet after a full last one",
             "nothing",
             _SAME),
    FaultRow("U8", "padding of 1 to 3 bytes, not zero",
             "nothing",
             _SAME, "`bytes`"),
    FaultRow("U9", "packets of 64, 512 or 1024 bytes",
             "nothing",
             _SAME, "built in: a property of the device"),
    FaultRow("U10", "the device sends more than was asked for",
             "nothing: asked again",
             _SAME),
    FaultRow("U11", "the cable is pulled",
             "`DeviceLost`; the shutter is left to the instrument's watchdog, and that is said aloud",
             _ALL, "`place`: `read`, `write`, `control`; `replug_after_s`, `error`"),
    FaultRow("U12", "a record or block is corrupt, or another point's",
             "nothing: fetched again; damaged twice, the point is flagged `DATA_LOST` and taken again",
             _SAME, "`what`: `crc`, `magic`, `number`, `duplicate`, `header`, `length`, `indefinite`"),
    FaultRow("U13", "errors wait in the instrument's queue",
             "`CommandRejected` with all of them",
             _ALL, "`errors`, `code`"),
    FaultRow("U14", "over-count, interlock, lost sync or watchdog",
             "`SafetyTrip` or `SyncLost`; the instrument has closed the shutter, which stays closed until a "
             "person clears the trip",
             _ALL, "`cause`: `over_count`, `interlock`, `sync`, `watchdog`"),
    FaultRow("U15", "a slot overrun, a late or a missed trigger",
             "the point is flagged and taken again",
             _SAME, "`what`: `missed`, `late`, `overrun`; `place`: `clock`"),
    FaultRow("U16", "a service request is lost",
             "nothing: the status is asked for at 20 Hz at most",
             _SAME),
    FaultRow("U17", "in use, not this user's, or held by a kernel driver",
             "`DeviceBusy` with the udev rule to add; a kernel driver is detached and given back",
             "nothing was opened", "`what`: `busy`, `access`, `kernel_driver`"),
    FaultRow("U18", "the instrument restarts and forgets its settings",
             "nothing where it takes them again, else `DeviceReset`; another identity: `WrongDevice`",
             _ALL, "`new_identity`"),
    FaultRow("U19", "every transfer is slow",
             "nothing but the time",
             _SAME, "`delay_s`"),
    FaultRow("U20", "list mode: late markers, wraps of 0 and n, a full FIFO, a cut record",
             "nothing for the first two; points with lost records are flagged `DATA_LOST` and taken again",
             _SAME, "`tcspc488`: `place`: `records`, `block`; `what`: `marker_order`, `overflow_zero`, "
             "`overflow_one`, `fifo_full`. `picoquant`: `place`: `marker`; `late_pulses`"),
)
PICOQUANT = (
    FaultRow("V1", "a call fails with a USB error that is gone 100 ms later",
             "nothing: tried once more, except StartMeas, ReadFiFo and the like, which raise `DeviceLost`",
             _ALL, "`place`: the call; `code`"),
    FaultRow("V2", "FIFO full",
             "points from there on are flagged `DATA_LOST` and taken again",
             _SAME),
    FaultRow("V3", "sync lost",
             "`SyncLost`, shutter closed",
             _ALL),
    FaultRow("V4", "system error",
             "`DeviceFault`, shutter closed",
             _ALL),
)
# fmt: on

TABLES = {
    "Serial lines (both mirrors)": SERIAL,
    "`triggerscope`": TRIGGERSCOPE,
    "`optotune`": OPTOTUNE,
    "`tcspc488`": TCSPC488,
    "`picoquant`": PICOQUANT,
}
NAMES = frozenset(row.name for rows in TABLES.values() for row in rows)

_HEAD = """# Faults, by name

What can go wrong between this program and its instruments, what you see when it does, and what is kept. Every row can
be rehearsed on the simulated bench:

```yaml
simulation:
  faults:
    - {name: G2, after_s: 1.0, times: 1, parameters: {delay_s: 2.0}}
```

A fault strikes at the first occasion after `after_s` of bench time and after `skip` earlier occasions, `times` times.
Every error closes the shutter before anything else. "Acknowledged" is what has been flushed to the recording; a scan
that was ended by a fault is resumed by `nlos scan SCAN -o RUN.h5 --resume`, and then holds the same counts as one that
was never disturbed.

*This page is made from `drivers/simulated/fault_catalogue.py`.*
"""


def markdown() -> str:
    """The page `docs/faults.md`."""
    parts = [_HEAD]
    for title, rows in TABLES.items():
        parts += [
            f"\n## {title}\n\n",
            "| | what happens | what you see | what is kept | parameters |\n|---|---|---|---|---|\n",
        ]
        parts += [f"| {row.name} | {row.happens} | {row.seen} | {row.kept} | {row.parameters} |\n" for row in rows]
    return "".join(parts)


if __name__ == "__main__":
    print(markdown(), end="")
