"""Photon counters that histogram arrival times: one instrument, one file."""
