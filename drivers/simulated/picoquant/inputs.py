"""What hangs on a simulated PicoQuant counter's inputs, and what they take of it."""

NIM_MV = 800
"""Laser sync and detector send negative pulses of this height, unless a rising edge is waited for:"""
_ATTENUATED_TTL_MV = 500
"""then 5 V behind an attenuator of 20 dB, as a MultiHarp's inputs need it."""
SYNC_DEAD_S = {"PH": 95e-9, "HH": 80e-9, "MH": 1 / 78e6}
"""PicoHarp 300, HydraHarp 400: data sheets; MultiHarp 150 manual, "Warnings": sync events are lost above 78 MHz."""


def edge_crossed(level_mv: int, edge: int) -> bool:
    """Whether the pulses of laser or detector cross a MultiHarp's trigger level (edge 1: rising)."""
    return -NIM_MV < level_mv < 0 or (edge == 1 and 0 < level_mv < _ATTENUATED_TTL_MV)
