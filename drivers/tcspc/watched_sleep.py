"""Sleeping while a point is measured, with an eye on what goes on meanwhile."""

from collections.abc import Callable

from nlos.drivers.clock import Clock

_EVERY_S = 0.01


def sleep_until(clock: Clock, when_s: float, look: Callable[[], object]) -> None:
    """`look` is called every 10 ms until the bench's clock says `when_s`; what it raises ends the sleep."""
    while (left_s := when_s - clock.now()) > _EVERY_S:
        clock.sleep(_EVERY_S)
        look()
    clock.sleep(left_s)
