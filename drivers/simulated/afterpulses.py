"""Clicks that follow clicks: a carrier that a click left behind comes free after the dead time, and clicks if the
detector is live by then."""

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

FORGOTTEN = 1e-6
"""What is less than this of a click's carriers does not click any more."""


class Afterpulses:
    """Expected afterpulses of a detector that sees `per_pulse` (P,) photons in each bin of the laser's period.

    A click leaves one carrier, which comes free an exponential delay (`decay` bins) after the dead time (`dead` bins);
    while the detector is blind, it is lost. Of a carrier that comes free within a further dead time it is known that
    the detector became live before it: only a photon in between stops it, with the chance 1 - exp(-photons). Later
    ones find it live as often as any photon does. Exact but for afterpulses that stop others.
    """

    def __init__(self, per_pulse: Array, dead: int, decay: float) -> None:
        self._dead, self._free = dead, -np.expm1(-1 / decay)
        self._left = float(np.exp(-dead / decay))
        self._unstopped = _Carriers(np.exp(-1 / decay - per_pulse))
        self._waiting = _Carriers(np.full(1, np.exp(-1 / decay)))
        turns, rest = divmod(dead, len(per_pulse))
        until = np.append(0.0, np.cumsum(np.tile(per_pulse, 2)))
        period = len(per_pulse)
        between = until[period + 1 :] - until[period + 1 - rest : 2 * period + 1 - rest] + turns * until[period]
        self._still = self._left * np.exp(-between)

    def of(self, detected: Array, live: Array) -> Array:
        """Afterpulses in each bin (P,), were each click's carrier certain, of `detected` (P,) clicks by a detector that
        is `live` (P,) of the pulses."""
        due = np.roll(detected, self._dead)
        due = (due + np.roll(due, 1)) / 2  # a click is anywhere in its bin
        soon = self._unstopped.of(due)
        soon -= self._still * np.roll(soon, self._dead)
        late = self._left * np.roll(self._waiting.of(due), self._dead)
        return np.asarray(self._free * (soon + live * late))


class _Carriers:
    """y_b = kept_b y_(b-1) + x_b, cyclic, by doubling: a step looks twice as far back as the one before."""

    def __init__(self, kept: Array) -> None:
        self._steps = []
        while kept.max() > FORGOTTEN:
            self._steps.append(kept)
            kept = kept * np.roll(kept, 2 ** (len(self._steps) - 1))

    def of(self, added: Array) -> Array:
        for number, kept in enumerate(self._steps):
            added = added + kept * np.roll(added, 2**number)
        return added
