"""A free-running detector under a pulsed laser, click by click, many detectors side by side."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
DETECTORS, PULSES_EACH = 2_500, 400
PULSES = DETECTORS * PULSES_EACH


def clicks_of_many(
    photons: float, per_bin: float, dead: float, after: tuple[float, float], seed: int, bins: int = 100
) -> npt.NDArray[np.int64]:
    """Counts (T,) after a million pulses: `photons` a pulse, even over bins 4 and 5, and `per_bin` in each bin of the
    period, all in bins of continuous time. After each click blind for `dead`; of those, a share `after[0]` clicks once
    more, exponentially in `after[1]` behind that."""
    random = np.random.default_rng(seed)
    live = random.uniform(0, bins, DETECTORS)
    late = np.full((3, DETECTORS), np.inf)  # carriers that are still trapped
    counts = np.zeros(bins, np.int64)
    while (live < PULSES_EACH * bins).any():
        late[late < live] = np.inf
        chance = live + random.exponential(1 / per_bin, DETECTORS)
        click = np.minimum(np.minimum(chance, _next_of_pulse(live, photons, bins, random)), late.min(axis=0))
        counts += np.bincount((click[click < PULSES_EACH * bins] % bins).astype(int), minlength=bins)
        live = click + dead
        caught = random.random(DETECTORS) < after[0]
        slot = np.argmax(late, axis=0)
        freed = live + random.exponential(after[1], DETECTORS)
        late[slot[caught], np.flatnonzero(caught)] = freed[caught]
    return counts


def _next_of_pulse(live: Floats, photons: float, bins: int, random: np.random.Generator) -> Floats:
    """The first photon of a pulse at `live` or later: of the present one's rest, or of one of the next."""
    place = np.clip(live % bins, 4, 6)
    needed = random.exponential(1.0, len(live)) / photons * 2 - (6 - place)  # bins of light beyond this pulse
    more = np.floor(needed / 2)
    this = np.floor(live / bins) * bins
    return np.where(needed < 0, this + 6 + needed, this + (1 + more) * bins + 4 + needed - 2 * more)
