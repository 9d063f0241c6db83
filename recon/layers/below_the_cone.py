"""Noise where no scene has light: what a scan holds below the light cone, of whatever kind it is.

Confocal light obeys f^2 = (c / 2)^2 (kx^2 + ky^2 + kz^2), so at a low frequency f it varies over the wall no faster
than 2 f / c. The polynomials that so slow a field needs are taken off what was measured at each of a few low
frequencies, on whatever points were measured; the rest is noise, which is white in time and over the wall.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from numpy.polynomial.legendre import legvander
from torch import Tensor

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S

FREQUENCIES = 8  # at most, one over the scan's length apart
FIRST = 1.5  # the lowest, over the scan's length
ENOUGH = 4  # of them: with as many, light is left more room
LEAST_REST = 0.2  # of the points: with fewer degrees of freedom left, what is left is not noise alone
MOST_POINTS = 1024  # of a scan with gaps; more tell no more
MOST_TERMS = 640  # polynomials over them
MOST_OF_SIDE = 0.8  # degree of a polynomial over the points of that side
EDGE, FAINT = 3, 0.03  # bins at either end of what was recorded; of the brightest bin

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Room:
    """What light is left: degrees beyond a field's own, for itself and for each cube root of it, and how sharply time
    is cut: more tapers weigh it more evenly, and need more room."""

    degrees: float
    growth: float
    tapers: int

    @property
    def lobe(self) -> float:
        """The tapers' half width in frequency, over the scan's length."""
        return (self.tapers + 1) / 2


ROOMS = (Room(8.0, 2.0, 5), Room(3.0, 1.0, 3), Room(3.0, 1.0, 2), Room(2.0, 0.5, 2))


@dataclass(frozen=True)
class Rest:
    """What is left of one scan; variances of one bin of the rates, their mean over time and measured points."""

    variance: float
    """Of all frequencies together, after each point's own delay."""
    least: float
    """Of the frequency that holds least."""
    frequencies: int
    """How many there were."""
    room: float
    """How much of it light was left, in `ROOMS`' first."""
    even: float
    """What the variance of noise that does not know the light is, over `variance`, which is the photons'."""
    bright: float
    """The same of grain, whose deviation goes with the rate."""


def below_the_cone(raw: Tensor, measured: Tensor, size_m: tuple[float, float], bin_width_s: float) -> Rest | None:
    """The noise of rates `raw` (T, H, W) at the points `measured` (H, W) of a wall of `size_m` (height, width).

    None where too few points were measured, or for too short a time, to tell light from noise. Sine tapers (Riedel and
    Sidorenko, 1995) keep light that ends with the scan from leaking; what they weigh little at its ends is made up for.
    A point whose clock is off by a little adds to every frequency what is in proportion to the light's derivative
    there, and it is taken off.
    """
    profile = raw.sum(dim=(1, 2))
    first, end = recorded(profile)
    rows, cols = (index.cpu().numpy() for index in measured.nonzero(as_tuple=True))
    if end - first < 2 * FREQUENCIES:
        return None
    whole = len(rows) == measured.numel()
    if not whole and len(rows) > MOST_POINTS:
        chosen = np.linspace(0, len(rows) - 1, MOST_POINTS).round().astype(np.int64)
        rows, cols = rows[chosen], cols[chosen]
    shape = (measured.shape[0], measured.shape[1])
    wall = _Points(rows, cols, shape, whole, size_m)
    found = _best((end - first) * bin_width_s, wall)
    if found is None:
        return None
    room, bases = found
    inside = raw[first:end]
    points = inside.flatten(1) if whole else inside[:, torch.from_numpy(rows), torch.from_numpy(cols)]

    wave = _wave(end - first, len(bases), room.tapers)
    _, rest = _told_apart(points, wave, bases, wall)
    late, _ = _told_apart(points, np.gradient(wave, axis=2), bases, wall)
    free = torch.tensor([1 - basis.size / points.shape[1] for basis in bases], dtype=torch.float64)
    each = rest.abs().square().double().mean(dim=(1, 2)).cpu() / free
    along = (late.conj() * rest).real.sum(dim=(0, 1)).double().square()
    taken = along / late.abs().square().sum(dim=(0, 1)).double().clamp(min=1e-30)
    every = float((rest.abs().square().double().sum(dim=(0, 1)) - taken).mean())
    kept = 1 - 1 / (2 * (len(bases) + room.tapers - 1))  # a number a point of those that are independent
    variance = every / (len(bases) * room.tapers * float(free.mean()) * kept)

    weight = torch.from_numpy(np.square(np.abs(wave)).mean(axis=(0, 1)) * (end - first)).to(points)
    shares = [float((power * weight).sum() / power.sum().clamp(min=1e-30)) for power in _powers(points)]
    share = (end - first) / raw.shape[0] / max(shares[1], 1e-6)
    even, bright = (shares[1] / max(of, 1e-6) for of in (shares[0], shares[2]))
    degrees = room.degrees / ROOMS[0].degrees
    return Rest(variance * share, float(each.min()) * share, len(bases), degrees, even, bright)


def recorded(profile: Tensor) -> tuple[int, int]:
    """From which bin to which a scan was recorded, by its histogram (T,) over all points: what was cut is skipped,
    what is merely dark before the first light and behind the last is not."""
    lit = profile.nonzero()[:, 0]
    if len(lit) == 0:
        return 0, 0
    first, end = int(lit[0]), int(lit[-1]) + 1
    faint = FAINT * profile.max()
    starts, ends = profile[first : first + EDGE].mean() >= faint, profile[max(0, end - EDGE) : end].mean() >= faint
    return (first if starts else 0), (end if ends else len(profile))


def _powers(points: Tensor) -> list[Tensor]:
    """(T,) each: how the variance of noise, photons and grain is spread over time, by the rates (T, N)."""
    rate = points.clamp(min=0)
    return [torch.ones_like(rate[:, 0]), rate.mean(dim=1), rate.square().mean(dim=1)]


@dataclass(frozen=True)
class _Points:
    rows: npt.NDArray[np.int64]
    cols: npt.NDArray[np.int64]
    shape: tuple[int, int]
    whole: bool
    size_m: tuple[float, float]


@dataclass(frozen=True)
class _Basis:
    """Orthonormal polynomials over the measured points: over all of them (N, M), or of a whole grid a side each."""

    joint: Floats | None
    sides: tuple[Floats, Floats] | None
    kept: npt.NDArray[np.bool_]  # (rows' degrees, columns' degrees): those that light needs

    @property
    def size(self) -> int:
        return int(self.kept.sum())


def _best(duration_s: float, wall: _Points) -> tuple[Room, list[_Basis]] | None:
    """As much room as leaves `ENOUGH` frequencies, or else any."""
    fallback = None
    for room in ROOMS:
        kept = _degrees(duration_s, wall, room)
        if kept and (len(kept) >= ENOUGH or fallback is None):
            fallback = room, kept
        if len(kept) >= ENOUGH:
            break
    if fallback is None:
        return None
    room, kept = fallback
    if wall.whole:
        most = [max(one.shape[axis] for one in kept) for axis in (0, 1)]
        both = _side(wall.shape[0], most[0] - 1), _side(wall.shape[1], most[1] - 1)
        ends = [[(0, of - own) for of, own in zip(most, one.shape, strict=True)] for one in kept]
        return room, [_Basis(None, both, np.pad(one, end)) for one, end in zip(kept, ends, strict=True)]
    joint = _joint(wall, kept)
    return room, [_Basis(joint[:, : one.sum()], None, one) for one in kept]


def _degrees(duration_s: float, wall: _Points, room: Room) -> list[npt.NDArray[np.bool_]]:
    """Which degrees light needs along rows and columns, for each frequency at which noise can be told from it."""
    found = []
    for number in range(FREQUENCIES):
        highest = (FIRST + number + room.lobe) / duration_s
        own = [math.pi * 2 * highest / SPEED_OF_LIGHT_M_PER_S * side for side in wall.size_m]
        spare = [room.degrees + room.growth * degree ** (1 / 3) for degree in own]
        most = [int(a + b) for a, b in zip(own, spare, strict=True)]
        over = [np.clip(np.arange(m + 1) - b, 0, None) / a for m, a, b in zip(most, own, spare, strict=True)]
        kept = over[0][:, None] ** 2 + over[1] ** 2 <= 1
        too_fine = any(m >= MOST_OF_SIDE * n for m, n in zip(most, wall.shape, strict=True))
        most_terms = (1 - LEAST_REST) * len(wall.rows)
        if too_fine or kept.sum() > (most_terms if wall.whole else min(MOST_TERMS, most_terms)):
            break
        found.append(kept)
    return found


def _joint(wall: _Points, kept: list[npt.NDArray[np.bool_]]) -> Floats:
    """(N, M) orthonormal polynomials over the points, those that the lowest frequency needs first, and so on."""
    first = np.full(kept[-1].shape, len(kept))
    for number, one in reversed(list(enumerate(kept))):
        first[: one.shape[0], : one.shape[1]][one] = number
    at = (wall.rows, wall.cols)
    up, along = (legvander((2 * at[k] + 1) / wall.shape[k] - 1, first.shape[k] - 1) for k in range(2))
    needed = np.argsort(first, axis=None, kind="stable")[: int((first < len(kept)).sum())]
    ups, alongs = np.unravel_index(needed, first.shape)
    return np.asarray(np.linalg.qr(up[:, ups] * along[:, alongs])[0])


@lru_cache(maxsize=64)
def _side(points: int, degree: int) -> Floats:
    """(points, degree + 1) orthonormal polynomials over the points of a side."""
    at = (2 * np.arange(points) + 1) / points - 1
    return np.asarray(np.linalg.qr(legvander(at, degree))[0])


@lru_cache(maxsize=8)
def _wave(bins: int, frequencies: int, tapers: int) -> npt.NDArray[np.complex128]:
    """(F, tapers, bins) tapered waves of unit energy, blind to a background, which may differ from point to point."""
    order, at = np.arange(1, tapers + 1)[:, None], np.arange(1, bins + 1) / (bins + 1)
    frequency = np.arange(frequencies)[:, None, None] + FIRST
    wave = np.exp(-2j * np.pi * frequency * np.arange(bins) / bins) * np.sin(np.pi * order * at)
    wave -= wave.mean(axis=2, keepdims=True)
    return np.asarray(wave / np.linalg.norm(wave, axis=2, keepdims=True))


def _told_apart(
    points: Tensor, wave: npt.NDArray[np.complex128], bases: list[_Basis], wall: _Points
) -> tuple[Tensor, Tensor]:
    """What the polynomials hold of (T, N) at each frequency, and what they do not, (F, tapers, N) each."""
    frequencies, tapers, bins = wave.shape
    flat = torch.from_numpy(np.concatenate((wave.real, wave.imag)).reshape(-1, bins)).to(points)
    real, imaginary = (flat @ points).reshape(2, frequencies, tapers, -1)
    spectra = torch.complex(real, imaginary)
    if bases[0].sides is not None:  # of a whole grid, and the same for every frequency
        up, along = (torch.from_numpy(side).to(spectra) for side in bases[0].sides)
        kept = torch.from_numpy(np.stack([basis.kept for basis in bases])).to(points.device)
        held = (up.T @ spectra.reshape(frequencies, tapers, *wall.shape) @ along) * kept[:, None]
        seen = (up @ held @ along.T).flatten(2)
    else:
        joint = [torch.from_numpy(basis.joint).to(spectra) for basis in bases]
        seen = torch.stack([(one @ of) @ of.T for one, of in zip(spectra, joint, strict=True)])
    return seen, spectra - seen
