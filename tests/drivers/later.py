"""Faults that begin once a bench is open."""

from nlos.drivers.simulated.faults import Fault

AFTER_OPENING_S = 1.0
"""On the bench's clock, to which a test advances it behind opening."""


def later(name: str, **parameters: object) -> Fault:
    """A fault that is committed as soon as `AFTER_OPENING_S` has come."""
    return Fault(name=name, after_s=AFTER_OPENING_S, parameters=parameters)
