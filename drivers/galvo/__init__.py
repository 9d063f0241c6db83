"""Mirrors that aim the beam: one controller, one file."""
