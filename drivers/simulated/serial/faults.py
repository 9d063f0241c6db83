"""What can go wrong on a serial line, whatever is at its other end."""

from nlos.drivers.simulated.fault_row import ALL, SAME, FaultRow

# fmt: off
FAULTS: tuple[FaultRow, ...] = (
    FaultRow("G1", "no reply",
             "`DeviceTimeout` within the timeout, shutter closed",
             ALL),
    FaultRow("G2", "the reply comes after the timeout",
             "`DeviceTimeout`; the late reply is thrown away and never taken for the answer to the next command",
             ALL, "`delay_s`"),
    FaultRow("G3", "a reply comes in two parts",
             "nothing, within the timeout",
             SAME, "`at`, `delay_s`"),
    FaultRow("G4", "noise, NUL, other than ASCII, or a line without end",
             "`ProtocolError`",
             ALL, "`kind`: `noise`, `nul`, `non_ascii`, `overlong`"),
    FaultRow("G5", "the echo names another axis or value",
             "`ProtocolError`; the position counts as unknown, nothing moves until the bench is opened again",
             ALL),
    FaultRow("G6", "the controller restarts while in use",
             "`DeviceReset`, shutter closed; its settings are gone. Of a `triggerscope` while a scan is paused: a "
             "warning, and they are sent again",
             ALL),
    FaultRow("G7", "replies cut into pieces or run together",
             "nothing",
             SAME, "`chunk` bytes (0: joined to the next), `gap_s`"),
    FaultRow("G8", "the cable is pulled",
             "`DeviceLost`, whichever of the three families of errors the port raises; within 20 ms also while "
             "nothing is said to the mirror",
             ALL, "`place`: `read`, `write`, `in_waiting`, `flush`, ...; `replug_after_s`"),
    FaultRow("G9", "the port takes no more bytes",
             "`DeviceTimeout`",
             ALL, "`sent`"),
    FaultRow("G10", "the port is missing, in use, or not this user's",
             "`DeviceNotFound` or `DeviceBusy`, each with what to do; another device on the port: `WrongDevice`",
             "nothing was opened", "`kind`: `missing`, `busy`, `permission`"),
)
# fmt: on
