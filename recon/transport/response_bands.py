"""An instrument's response on the light cone: over t^2 it widens with time, so it is held in a few bands of time.

At time t a delay tau moves light by 2 t tau in t^2. Within a band around t the response is then a convolution like the
light cone's, and one Wiener gain inverts both together.
"""

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis

Floats = npt.NDArray[np.float64]
BANDS = 4  # more change nothing
EARLIEST_LIGHT = 0.02  # share of the light that comes before the first band's middle


class Bands(NamedTuple):
    """Windows over the time axis that add up to 1, and the response's spectrum along t^2 in each."""

    windows: npt.NDArray[np.float32]  # (N, T)
    spectra: npt.NDArray[np.complex64]  # (N, F)


def bands_of(
    profile: npt.NDArray[np.floating], count: int, taps: Floats, time: TimeAxis, cells: int, padded: int
) -> Bands:
    """`count` bands of a response (K,): shares of light a bin of `time`, K odd, the middle one on time.

    `profile` (T,) is the light over time; `cells` of t^2 reach to its end; `padded` is the transform's length.
    """
    knots_s = knots(profile, time, count)
    return Bands(windows(knots_s, time), spectra(knots_s, taps, time.bin_width_s, time, cells, padded))


def knots(profile: npt.NDArray[np.floating], time: TimeAxis, count: int) -> Floats:
    """`count` times from the first light of `profile` (T,) to the end of the axis, evenly over log t."""
    light = np.maximum(np.asarray(profile, dtype=np.float64), 0.0)
    share = np.cumsum(light) / max(float(light.sum()), 1e-300)
    end_s = time.start_s + time.bins * time.bin_width_s
    first_s = time.start_s + (int((share < EARLIEST_LIGHT).sum()) + 0.5) * time.bin_width_s
    first_s = min(max(first_s, end_s / 16), end_s / 2)
    return np.asarray(np.geomspace(first_s, end_s, count))


def windows(knots_s: Floats, time: TimeAxis) -> npt.NDArray[np.float32]:
    """(N, T): weights by which what belongs to the times (N,) is interpolated over log t, constant beyond them."""
    log_t = np.log(np.maximum(time.centres_s(), time.bin_width_s / 2))
    place = np.zeros(time.bins)
    for before, after in pairwise(np.log(knots_s)):
        place += np.clip((log_t - before) / (after - before), 0, 1)
    weights = np.maximum(1 - np.abs(place - np.arange(len(knots_s))[:, None]), 0)
    return np.asarray(weights, dtype=np.float32)


def spectra(
    at_s: Floats, taps: Floats, bin_width_s: float, time: TimeAxis, cells: int, padded: int
) -> npt.NDArray[np.complex64]:
    """(N, F): the spectrum of the response (K,) as it is along t^2 about each of the times (N,)."""
    end_s = time.start_s + time.bins * time.bin_width_s
    delay_s = (np.arange(len(taps)) - len(taps) // 2) * bin_width_s
    in_cells = 2 * cells / end_s**2 * at_s[:, None] * delay_s  # (N, K)
    cycles = np.arange(padded // 2 + 1) / padded
    turned = np.exp(-2j * np.pi * in_cells[:, None] * cycles[:, None])
    return np.asarray(turned @ taps, dtype=np.complex64)


def plane_brightness(
    power: npt.NDArray[np.floating], spectra: npt.NDArray[np.complexfloating[Any, Any]], noise: Floats | float
) -> Floats:
    """(N,): how bright a plane parallel to the wall comes out of the inverse in each band, over what it would be at an
    instant's response.

    `power` (F,) is |H|^2 at lateral frequency 0. Over t^2 a response is wider the later, and what of its width is not
    inverted spreads a surface over depth, which a picture, the brightest along depth, shows as darker.
    """

    both_sides = np.full(len(power), 2.0)  # of zero, which is in the half spectrum once
    both_sides[0] = 1.0

    def peak(of: Any) -> Any:
        return (both_sides * of / (of + noise)).sum(axis=-1)

    return np.asarray(peak(power * np.abs(spectra) ** 2) / peak(power), dtype=np.float64)


def gain_of_both(noise: Any, response: Any, adjoint: bool = False) -> Any:
    """The gain conj(K) / (|H K|^2 + noise) beside conj(H), or its conjugate: for `LightConeFilter`.

    `noise` and K (N, F) for each of N samples, arrays or tensors as the data are.
    """

    def gain(power: Any, planes: slice) -> Any:
        k = response[:, planes, None, None]
        return (k if adjoint else k.conj()) / (power * (k.real**2 + k.imag**2) + noise)

    return gain
