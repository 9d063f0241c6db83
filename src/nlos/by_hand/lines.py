"""What `nlos jog` and `nlos monitor` show, line by line."""

import math
import sys
import textwrap

from nlos.by_hand.chart import chart, ruler
from nlos.by_hand.hand import Hand

_NOTE_LINES = 4


def heading(hand: Hand) -> list[str]:
    """Who answers, and who does not."""
    bench = hand.bench
    there = [each.identity for each in (bench.mirror, bench.counter) if each is not None]
    names = [f"{each.product} {each.serial}".strip() for each in there]
    lines = [f"bench {bench.settings.name}: {', '.join(names)}"]
    return lines + [f"without the {role}: {error.what}" for role, error in bench.absent.items()]


def address(url: str) -> list[str]:
    """Where the page is, for whoever has one."""
    return [f"page        {url}"] if url else []


def beam(hand: Hand) -> list[str]:
    """Where the beam was sent, as angles and as a place on the wall."""
    if hand.reach is None:
        return []
    x_m, y_m = hand.reach.place_of(hand.angles)
    x_deg, y_deg = math.degrees(hand.angles.x_rad), math.degrees(hand.angles.y_rad)
    return [
        f"sent to     x {x_deg:+9.4f}   y {y_deg:+9.4f} deg, optical",
        f"on the wall x {x_m:+9.4f}   y {y_m:+9.4f} m",
    ]


def light(hand: Hand) -> str:
    """Whether there is light, how long still, and how to have some."""
    if not hand.light_is_known:
        return f"light       not known: {hand.no_light}"
    if hand.no_light:
        return f"light       none: {hand.no_light}"
    duty = hand.bench.settings.alignment.duty
    part = "" if duty == 1.0 else f", open for {duty:.0%} of the time"
    if hand.light.wanted:
        return f"light       ON  {hand.light.left_s:5.1f} s left{part}"
    return "light       off" + ("   (hold SPACE for light)" if hand.keys.there else "")


def counts(hand: Hand) -> list[str]:
    """Rates, and the direct peak."""
    if hand.reading is None or hand.watch is None:
        return []
    reading, peak, stated_hz = hand.reading, hand.peak, hand.bench.settings.laser.repetition_hz
    off = abs(reading.sync_hz / stated_hz - 1) > 0.01 if reading.sync_hz > 0 else True
    stated = f"   the bench file says {rate(stated_hz, 'Hz')}" if off else ""
    lines = [
        f"sync        {rate(reading.sync_hz, 'Hz')}{stated}",
        f"detector    {rate(reading.detector_hz, 'counts/s')}   {reading.detector_hz / stated_hz:.2%} of the pulses",
    ]
    if peak is None:
        return [*lines, "direct      no peak"]
    seconds = max(hand.watch.summed_s, 1e-9)
    width = "FWHM -" if peak.fwhm_s is None else f"FWHM {peak.fwhm_s * 1e12:.0f} ps"
    return [*lines, f"direct      at {peak.time_s * 1e9:.3f} ns   {width}   {rate(peak.counts / seconds, 'counts/s')}"]


def histogram(hand: Hand, columns: int, rows: int, logarithmic: bool) -> list[str]:
    """The last second's, over the axis that is looked at."""
    watch = hand.watch
    if watch is None or rows < 1:
        return []
    summed, axis = watch.summed, watch.axis
    highest = int(summed.max(initial=0))
    plain = "utf" not in (getattr(sys.stdout, "encoding", None) or "").lower()
    end_s = axis.offset_s + len(summed) * axis.bin_width_s
    scale = "log" if logarithmic else "linear"
    return [
        f"{watch.summed_s:.1f} s in bins of {axis.bin_width_s * 1e12:g} ps, highest {highest} ({scale})",
        *chart(summed, columns, rows, logarithmic, plain),
        ruler(axis.offset_s * 1e9, end_s * 1e9, columns),
    ]


def notes(hand: Hand, columns: int) -> list[str]:
    """What was said lately, whole: the newest lines of it."""
    return [line for note in hand.notes for line in textwrap.wrap(note, max(columns - 1, 20))][-_NOTE_LINES:]


def rate(value: float, unit: str) -> str:
    """With as many digits as a person reads while it changes."""
    if not math.isfinite(value):
        return f"- {unit}"
    for size, prefix in ((1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return f"{value / size:.4g} {prefix}{unit}"
    return f"{value:.4g} {unit}"
