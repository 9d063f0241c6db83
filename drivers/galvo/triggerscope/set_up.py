"""From whatever state another program left a TriggerScope in to a known one: dark, still, centred.

It does not restart as its port is opened, and it forgets nothing. Two of its habits give the order. Clearing a table
ends its stepping; the command that ends stepping also brings back the value from before, which may be an open shutter.
And each SAR puts code 0, -10 V, on every output but its own, so that all of them come before the first code.
"""

from collections.abc import Sequence

from nlos.drivers.galvo.triggerscope import wire


def set_up(dacs: Sequence[int], shutter_group: int | None, waves: bool = False) -> list[bytes]:
    """Every command, in order. The mirror swings towards -10 V for a round trip while the ranges are set. `waves`: the
    firmware may play a wave that was left behind in place of a table, and clearing the table does not end that."""
    return [
        *([] if shutter_group is None else dark(shutter_group)),
        wire.LEDS_OFF,  # they cost time in the controller's loop
        *(wire.no_wave(dac) for dac in dacs if waves),
        *(wire.clear_states(dac) for dac in dacs),
        *dark(0),
        *ranges(dacs),
        *(wire.end_blanking(dac) for dac in dacs),  # puts out the centre that SAR has noted for each axis
        *centre(dacs),
    ]


def ranges(dacs: Sequence[int]) -> list[bytes]:
    """Each axis to +-10 V: every output goes to code 0 until it is set."""
    return [wire.set_range(dac) for dac in dacs]


def centre(dacs: Sequence[int]) -> list[bytes]:
    """For axes whose ranges are set."""
    return [wire.set_code(dac, wire.CENTRE) for dac in dacs]


def disarm(dacs: Sequence[int]) -> list[bytes]:
    """Ends stepping that this program began."""
    return [*(wire.step_states(dac, False) for dac in dacs), wire.step_masks(0, False), wire.set_mask(0, 0)]


def dark(group: int) -> list[bytes]:
    """A group of TTL outputs: low at once, stepping ended, low again if an edge came in between; then blanking can end
    and put out low."""
    return [wire.set_mask(group, 0), wire.clear_masks(group), wire.set_mask(group, 0), wire.end_mask_blanking(group)]
