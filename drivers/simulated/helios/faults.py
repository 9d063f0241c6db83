"""What can go wrong with a Helios laser DAC."""

from nlos.drivers.simulated.fault_row import ALL, SAME, FaultRow

# fmt: off
FAULTS: tuple[FaultRow, ...] = (
    FaultRow("H1", "a frame is skipped, and nobody is told",
             "`DeviceTimeout` where it was a sequence, shutter closed. That a single point was skipped cannot be seen: "
             "what is known to be skipped is never sent",
             ALL, "`place`: `sequence`, `point`"),
    FaultRow("H2", "a mark on a colour output does not arrive",
             "nothing: marks and points disagree, or a gate stays closed; what is not confirmed is taken again",
             SAME, "`place`: `marker_1`, `marker_2`, `marker_4`, `trigger`"),
    FaultRow("H3", "the cable is pulled",
             "`DeviceLost`, shutter closed; the DAC stops and centres its mirror by itself",
             ALL, "`place`: `frame`, `command`, `answer`"),
    FaultRow("H4", "a command is not answered, or only later",
             "`DeviceTimeout`, shutter closed; nothing moves until the bench is opened again, which throws away what "
             "comes late",
             ALL, "`delay_s`"),
)
# fmt: on
