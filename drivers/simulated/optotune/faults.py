"""What can go wrong with an Optotune mirror."""

from nlos.drivers.simulated.fault_row import ALL, SAME, FaultRow

# fmt: off
FAULTS: tuple[FaultRow, ...] = (
    FaultRow("B1", "`NO`, `OL`, `OU` or `ERROR` in reply to a position",
             "`CommandRejected`; where it was clamped, with where the mirror is",
             ALL, '`reply`: `"NO"`, `OL`, `OU`, `ERROR`'),
    FaultRow("B2", "the mirror never becomes stable",
             "`SettleTimeout` with STATUS and board faults; it is not moved again",
             ALL),
    FaultRow("B3", "stable, then unstable again",
             "nothing: two stable readings in a row are asked for",
             SAME),
    FaultRow("B4", "over-temperature, current limit, sensor lost",
             "`DeviceFault`, shutter closed; acknowledged by a person only",
             ALL, "`bit` (its number), `latched_only`"),
    FaultRow("B5", "stuck in Pro mode, a truncated, damaged or refused frame",
             "nothing where Simple mode comes back and the frame is whole the second time, else `ProtocolError`; "
             "`CommandRejected` for a refused one",
             SAME, "`place`: `stuck`, `truncated`, `damaged`, `refused`"),
    FaultRow("B6", "it points elsewhere than commanded",
             "a warning with both positions; `DeviceFault` above the hard limit",
             SAME, "`off_by`"),
)
# fmt: on
