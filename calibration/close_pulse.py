"""A second pulse so close behind the direct one that they overlap: a laser that pulses twice, or light thrown back in
the optics. It is the same share of the direct light at every point; light of a scene so near the wall is not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.calibration.second_pulse import SecondPulse
from nlos.calibration.told import warn
from nlos.calibration.wall_timing import FEWEST_POINTS

Floats = npt.NDArray[np.float64]
Counts = npt.NDArray[np.float32]
_WIDTHS = 6
"""Full widths at half maximum behind the direct pulse: what comes later is for `second_pulse` ..."""
_LATEST_S = 1.2e-9
"""... as is what may be an object."""
_SURFACE_S, _BRIGHT = 0.6e-9, 0.03
"""From here on a surface 9 cm off may be as even; but as bright as this, beside what is left of the direct pulse, only
where the spot on the wall is 4 cm wide or more."""
_AS_SHARP = 2.5
"""Full widths of the direct pulse, within which it falls to its half at the latest."""
_FAINTEST = 0.002
"""Of what is left of the direct pulse where histograms begin at its maximum: of all of it half as much."""
_SURE = 8.0
"""Standard errors from which on a pulse is believed."""
_EVEN = 0.3
"""Standard deviation over points, of its mean share of the direct light, beyond chance and beyond doubt."""


@dataclass(frozen=True)
class ClosePulse:
    """How late its maximum is, the bin where it ends, and how bright it is as a share of the direct pulse."""

    lag_s: float
    end_bin: int
    share: float


def close_pulse(counts: Counts, smooth: Floats, between: tuple[int, int], bin_width_s: float) -> ClosePulse | None:
    """The pulse that rises behind a minimum. `counts` (N, T) are aligned, `smooth` (T,) is their mean over points,
    `between` the bins of the direct pulse's maximum and of that minimum. None where it is late, wide or not even, and
    of so few points that all of them tell nothing."""
    peak, turn = between
    if len(counts) < FEWEST_POINTS:
        return None
    width = _width(smooth, peak)
    latest = peak + min(_WIDTHS * width, _LATEST_S / bin_width_s)
    top = turn + int(np.argmax(smooth[turn : round(latest) + width + 1])) if turn < latest else turn
    half = (smooth[top] + smooth[turn]) / 2
    behind = np.flatnonzero(smooth[top:] < half)
    if not peak < turn < top <= latest or not len(behind) or behind[0] > _AS_SHARP * width:
        return None
    end = min(2 * top - turn + 1, top + 3 * int(behind[0]) + 1, len(smooth))
    low = top + int(np.argmin(smooth[top:end]))
    core = slice(max(peak - width, 0), peak + width + 1)
    direct, held = (counts[:, some].sum(axis=1, dtype=np.float64) for some in (core, slice(turn, low + 1)))
    below = (smooth[turn] + smooth[low]) / 2 * (low + 1 - turn)
    if not direct.mean() > 0:
        return None
    bright = held - below * direct / direct.mean()
    share = bright.sum() / direct.sum()
    chance = np.maximum(held, 1.0)
    spread = np.mean((bright - share * direct) ** 2 - chance)
    doubt = 2 * np.sqrt(2 / len(held)) * chance.mean()
    faintest = _FAINTEST if (top - peak) * bin_width_s < _SURFACE_S else _BRIGHT
    sure = share > faintest and bright.sum() > _SURE * np.sqrt(chance.sum())
    if not sure or not spread + doubt < (_EVEN * bright.mean()) ** 2:
        return None
    mean = counts[:, : low + 1].mean(axis=0, dtype=np.float64)
    as_high = (mean[turn:].max() - (mean[turn] + mean[low]) / 2) / mean[:turn].max()
    return ClosePulse((top - peak) * bin_width_s, low + 1, float(as_high))


def doubt_close_pulse(found: ClosePulse | None, taken: Sequence[SecondPulse]) -> None:
    """Says where it is and what is done about it, unless it is one of those `taken` out, which are told already."""
    if found is not None and not any(each.is_at(found.lag_s) for each in taken):
        warn(
            "a second pulse comes %.2f ns behind the direct one, at every point about %.2g %% as bright: a laser that "
            "pulses twice, or light thrown back between lens and detector. It is masked with the direct light; what is "
            "hidden is seen once more %.1f cm behind itself. If neither is so, it is a surface so near the wall, as "
            "far from every point, and not in the picture.",
            found.lag_s * 1e9, 100 * found.share, found.lag_s * SPEED_OF_LIGHT_M_PER_S / 2 * 100,
        )  # fmt: skip


def _width(smooth: Floats, peak: int) -> int:
    """Full width at half maximum, in bins, by the falling half: what was aligned begins at its maximum."""
    low = np.flatnonzero(smooth[peak:] < smooth[peak] / 2)
    return 2 * int(low[0]) - 1 if len(low) else len(smooth)
