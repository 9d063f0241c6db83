"""What can go wrong with a Swabian Time Tagger."""

from nlos.drivers.simulated.fault_row import ALL, SAME, FaultRow

# fmt: off
FAULTS: tuple[FaultRow, ...] = (
    FaultRow("T1", "tags are lost: the USB link or this computer is too slow",
             "points under way are flagged `DATA_LOST` and taken again",
             SAME),
    FaultRow("T2", "a call of the vendor's package fails",
             "`DeviceFault` with the vendor's words; where it says that the connection is gone, `DeviceLost`; "
             "shutter closed",
             ALL, "`place`: the call; `lost`"),
    FaultRow("T4", "the laser's rate changes while points are taken",
             "`SyncLost` that names the input and both rates, at the end of the points under way; shutter closed",
             ALL, "`times_hz`: the factor"),
)
# fmt: on
