"""The first moves of a mirror that has not shown that it moves: small, asked for in words, and seen by a person."""

import math

from nlos.cli.agreeing import answer, somebody_is_there
from nlos.cli.terminal import terminal
from nlos.drivers.errors import DeviceFault
from nlos.drivers.galvo.mirror import MirrorAngles, VerifiedByEye
from nlos.drivers.partial_bench import PartialBench

SMALL_DEG = 0.5
_BLINKS = 3
_BLINK_S = 0.4
_WAYS = (
    ("x", "to the right", MirrorAngles(math.radians(SMALL_DEG), 0.0)),
    ("y", "up", MirrorAngles(0.0, math.radians(SMALL_DEG))),
)


def watch_first_moves(bench: PartialBench) -> None:
    """Does nothing for a mirror that shows by itself that it moves. Raises `DeviceFault` where nobody is there to look,
    or somebody saw it stand still: then it is not moved any further."""
    mirror = bench.mirror
    if mirror is None or not isinstance(mirror, VerifiedByEye) or mirror.shows_that_it_moves:
        return
    who = mirror.identity.model
    if not somebody_is_there():
        mirror.check_trusted()
        return
    terminal.log(
        f"{who}: it gave no start-up banner. Without its SD card it confirms every move and makes none, so a person "
        "has to see it move.",
        -9,
    )
    with mirror.trusted_for_trial():
        for axis, way, angles in _WAYS:
            told = answer(
                f"After Enter the {axis} mirror goes {SMALL_DEG:g} deg {way} and back, {_BLINKS} times, in the dark: "
                "look at the mirrors themselves. Type anything to stop here."
            )
            if told != "":
                raise DeviceFault(who, "its first moves were declined.", "Start again when somebody can look.")
            for _ in range(_BLINKS):
                for target in (angles, MirrorAngles(0.0, 0.0)):
                    mirror.move_to(target)
                    bench.clock.sleep(_BLINK_S)
            if answer(f'Did the {axis} mirror move? Type "yes", or Enter if it did not, or another one did.') != "yes":
                raise DeviceFault(
                    who,
                    f"its {axis} mirror was not seen to move.",
                    "Check SD card, the DAC's number in the bench file, the cable to the head and the head's supply.",
                )
    mirror.trust()
    terminal.log(
        "Seen to move: trusted until this command ends. `allow_unverified_dac: true` in the bench file lets scans "
        "trust it as well; better to fix the SD card.",
        -9,
    )
