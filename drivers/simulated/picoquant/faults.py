"""What can go wrong with PicoQuant's counters."""

from nlos.drivers.simulated.fault_row import ALL, SAME, FaultRow

# fmt: off
FAULTS: tuple[FaultRow, ...] = (
    FaultRow("V1", "a call fails with a USB error that is gone 100 ms later",
             "nothing: tried once more, except StartMeas, ReadFiFo and the like, which raise `DeviceLost`",
             ALL, "`place`: the call; `code`"),
    FaultRow("V2", "FIFO full",
             "points from there on are flagged `DATA_LOST` and taken again",
             SAME),
    FaultRow("V3", "sync lost",
             "`SyncLost`, shutter closed",
             ALL),
    FaultRow("V4", "system error",
             "`DeviceFault`, shutter closed",
             ALL),
)
# fmt: on
