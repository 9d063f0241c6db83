"""Scans watched while they run: the live page, following a growing file, when a picture is good enough."""
