"""Optotune MR-E-2 and MR-E-3: a fast steering mirror with its own controller."""
