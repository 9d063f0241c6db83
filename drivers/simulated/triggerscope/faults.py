"""What can go wrong with a TriggerScope."""

from nlos.drivers.simulated.fault_row import ALL, SAME, FaultRow, words
from nlos.drivers.simulated.triggerscope.left_overs import HALF_LINES, LEFT_OVERS

# fmt: off
FAULTS: tuple[FaultRow, ...] = (
    FaultRow("A1", "two commands in one packet: the second is lost",
             "nothing: the driver has one command in flight",
             SAME, "built in"),
    FaultRow("A2", "a command is refused",
             "`CommandRejected` with the controller's words",
             ALL, "`kind`: `unknown`"),
    FaultRow("A3", "no SD card: no banner, every command confirmed, nothing moves",
             "`DeviceFault` before the first move, unless `allow_unverified_dac: true`, which is warned about",
             "nothing was moved"),
    FaultRow("A4", "a table is kept with another length than was sent",
             "nothing the first time (cleared and sent again), `ProtocolError` the second",
             ALL),
    FaultRow("A5", "more states or a longer line than the controller holds",
             "`LimitError`, with nothing sent",
             "nothing was sent", "built in: the firmware overruns its memory"),
    FaultRow("A6", "a trigger edge is missed, or comes twice",
             "nothing: markers and points disagree, the segment is taken again",
             SAME, "`kind`: `missed`, `extra`"),
    FaultRow("A7", "another program changes a range, which moves the mirror",
             "a warning: the shutter is closed, ranges are set and the mirror is centred, then the scan continues",
             SAME, "`range`"),
    FaultRow("A8", "left-over state: another program left it armed, blanked, open or in other ranges",
             "nothing: it is made dark, still and centred before anything else",
             SAME, "`state`: " + words(LEFT_OVERS)),
    FaultRow("A9", "half a line: another program was killed in the middle of a command",
             "nothing: the half line is spoiled, not completed",
             SAME, "`line`: " + words(HALF_LINES)),
)
# fmt: on
