"""One update as a row: what the log keeps, the page shows and `--json` says."""

import math
from datetime import UTC, datetime
from typing import Any

from nlos.by_hand.hand import Hand

COLUMNS = (
    "utc", "light", "sync_hz", "detector_hz", "direct_ns", "direct_fwhm_ps", "direct_hz", "x_deg", "y_deg",
)  # fmt: skip


def row(hand: Hand) -> dict[str, Any]:
    """The newest update by `COLUMNS`; empty before the first, or without a counter."""
    reading, peak, watch = hand.reading, hand.peak, hand.watch
    if reading is None or watch is None:
        return {}
    return {
        "utc": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "light": _light(hand, reading.lit),
        "sync_hz": round(reading.sync_hz, 1),
        "detector_hz": round(reading.detector_hz, 1),
        "direct_ns": None if peak is None else round(peak.time_s * 1e9, 4),
        "direct_fwhm_ps": None if peak is None or peak.fwhm_s is None else round(peak.fwhm_s * 1e12, 1),
        "direct_hz": None if peak is None else round(peak.counts / max(watch.summed_s, 1e-9), 1),
        "x_deg": math.degrees(hand.angles.x_rad) if hand.reach is not None else None,
        "y_deg": math.degrees(hand.angles.y_rad) if hand.reach is not None else None,
    }


def _light(hand: Hand, lit: bool | None) -> str | int:
    if not hand.light_is_known:
        return "unknown"
    return "mixed" if lit is None else int(lit)
