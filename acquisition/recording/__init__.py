"""Scan files: written, read, followed, replayed, verified and recovered."""
