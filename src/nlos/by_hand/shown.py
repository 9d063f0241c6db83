"""What the page shows of one update: everything that the terminal shows, and the histogram bin by bin."""

from typing import Any

from nlos.by_hand import lines
from nlos.by_hand.hand import Hand
from nlos.by_hand.row import row
from nlos.live.describe import packed


def shown(hand: Hand) -> dict[str, Any]:
    """Ready for JSON: numbers of the row, light, place on the wall, and counts (T,) of the last second."""
    settings, watch = hand.bench.settings, hand.watch
    numbers = row(hand)
    numbers.pop("light", None)  # of the gate; what is shown is that of now
    update: dict[str, Any] = {
        **numbers,
        "heading": lines.heading(hand),
        "stated_hz": settings.laser.repetition_hz,
        "lit": hand.light.lit,
        "light": _light(hand),
        "notes": list(hand.notes),
    }
    if hand.reach is not None:
        update["x_m"], update["y_m"] = hand.reach.place_of(hand.angles)
    if watch is not None:
        summed, axis = watch.summed, watch.axis
        update["counts"] = packed(summed)
        update["summed_s"] = watch.summed_s
        update["start_ns"], update["bin_ns"] = axis.offset_s * 1e9, axis.bin_width_s * 1e9
    return update


def _light(hand: Hand) -> str:
    """For eyes at a page, whose keys give none."""
    if not hand.light_is_known:
        return "light not known: " + hand.no_light
    if hand.no_light:
        return "no light: " + hand.no_light
    if hand.light.lit:
        return f"LIGHT ON, {hand.light.left_s:.1f} s left"
    return f"light off, {hand.light.left_s:.1f} s left" if hand.light.wanted else "light off"
