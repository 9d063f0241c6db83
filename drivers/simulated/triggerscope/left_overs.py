"""What another program may have left a TriggerScope in: opening its port restarts nothing and clears nothing."""

_TO_FULL_SCALE = (b"SAR1-4", b"SAR2-4", b"SAO1-32767", b"SAO2-32767", b"PAO1-0-0-65535", b"PAO2-0-65535-0")
_TO_LIGHT = (b"PDO1-0-255-255",)

LEFT_OVERS: dict[str, tuple[bytes, ...]] = {
    "open": (b"SDO1-255",),
    "opens_on_edges": (*_TO_LIGHT, b"PDS1-1-1"),
    "opens_on_falling_edges": (*_TO_LIGHT, b"PDS1-1-0"),
    "opens_as_stepping_stops": (b"SDO1-255", b"PDS1-1-1", b"SDO1-0"),
    "opens_while_triggered": (b"SDO1-255", b"BDO1-1-0"),
    "opens_while_not_triggered": (b"SDO1-255", b"BDO1-1-1"),
    "opens_as_blanking_ends": (b"BDO1-1-0", b"SDO1-255", b"PDS1-1-1"),
    "marks_on_edges": (b"PDO0-0-1-6-255", b"PDS0-1-1"),
    "axes_step": (*_TO_FULL_SCALE, b"PAS1-1-1", b"PAS2-1-1"),
    "axes_step_on_falling_edges": (*_TO_FULL_SCALE, b"PAS1-1-0", b"PAS2-1-0"),
    "axes_blanked": (b"SAR1-4", b"SAR2-4", b"SAO1-40000", b"SAO2-20000", b"BAO1-1-0", b"BAO2-1-1"),
    "other_ranges": (b"SAR1-2", b"SAR2-3", b"SAO1-65535", b"SAO2-0"),
}
"""By name, as the commands that lead to it from power-up."""

HALF_LINES: dict[str, bytes] = {
    "table": b"PAO1-0-1",
    "modem": b"AT\r",
    "nothing": b"\0\0\0",
    "shutter": b"SDO1-255",
    "full_scale": b"SAO1-65535",
    "range": b"SAR1-1",
    "stepping": b"PDS1-1-1",
    "blanking": b"BAO2-1-0",
}
"""By name, what a program that was killed in the middle of a line left in the controller's buffer."""
