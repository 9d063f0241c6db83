"""Simulated serial cables under pyserial, and behind a pseudo-terminal."""
