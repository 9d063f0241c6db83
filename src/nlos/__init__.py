"""Confocal non-line-of-sight imaging: from galvo mirrors and single photons to what is behind the corner."""
