"""A scene of hidden surfaces behind a wall, turned into photon rates per time bin for the spot that the beam lights.

Shares no code with the reconstruction: what it makes is evidence about it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from pydantic import Field

from nlos.configs.settings import Settings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated import spad
from nlos.drivers.simulated.beam import SPEED_OF_LIGHT_M_PER_S, BeamPath, Spot
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.drivers.simulated.moving import Scenery
from nlos.drivers.simulated.spad import DetectorSettings, Response
from nlos.drivers.simulated.surfaces import Surface, Surfels

Array = npt.NDArray[np.float64]


class SceneSettings(Settings):
    """What is behind the corner, and how bright it is at the detector, in counts per second."""

    objects: tuple[Surface, ...] = ()
    """Hidden surfaces."""
    direct_cps: float = Field(default=40e3, ge=0)
    """Light scattered once, at the wall, with the beam undeflected."""
    hidden_cps: float = Field(default=500e3, ge=0)
    """What one square metre of white that faces the wall 1 m in front of the spot would give, were it a point."""
    ambient_cps: float = Field(default=500.0, ge=0)
    """Stray light that is not from the laser."""
    delay_ns: float = 0.0
    """Electronic delay between the sync input and the detector input."""
    surfel_m: float = Field(default=0.01, gt=0)
    """Size of the flat pieces that surfaces are cut into."""


class SceneLight:
    """What the detector sees of a scene: a `Light`.

    A confocal scan lights and watches the same wall point: each surfel returns at t = 2 (range + r) / c with
    rho dA (cos_wall cos_surface / r^2)^2, the diffuse 1/r^4 law (O'Toole et al. 2018, eq. 1), or with the first power
    of that factor where it is retroreflective. Direct light returns at 2 range / c.
    """

    def __init__(
        self, scene: SceneSettings, detector: DetectorSettings, path: BeamPath, repetition_hz: float, seed: int
    ) -> None:
        self._scene, self._detector, self._path = scene, detector, path
        self._repetition_hz, self._seed = repetition_hz, seed
        self._response = Response(detector)
        self._undeflected = _collected(path.spot(MirrorAngles(0.0, 0.0)))
        self._scenery = Scenery(scene.objects, scene.surfel_m)
        self._pieces_at = lru_cache(maxsize=4)(lambda time_s: _pieces(self._scenery.at(time_s)))

    def __call__(self, gate: Gate, beam: MirrorAngles, shutter_open: bool) -> Exposure:
        ways, start_s = gate.track or (beam,), gate.since_lit_s
        if shutter_open and self._scenery.moves and not gate.track:
            ways = (beam,) * self._scenery.moments(start_s, gate.dwell_s)
        spots = [self._path.spot(each) for each in ways] if shutter_open else [None]
        rates = [
            self.photons_per_pulse(
                spot, gate.bin_width_s, gate.offset_s, start_s + (k + 0.5) / len(spots) * gate.dwell_s
            )
            for k, spot in enumerate(spots)
        ]
        per_pulse = rates[0] if len(rates) == 1 else np.mean(rates, axis=0)
        detected = spad.distort(per_pulse, gate.bin_width_s, self._detector)
        return spad.draw(detected, gate, self._repetition_hz, spad.generator(self._seed, gate, beam))

    def spot_m(self, beam: MirrorAngles) -> tuple[float, float] | None:
        """Where the beam lands on the wall's plane."""
        spot = self._path.spot(beam)
        return None if spot is None else (spot.x_m, spot.y_m)

    def photons_per_pulse(self, spot: Spot | None, bin_width_s: float, offset_s: float, time_s: float = 0.0) -> Array:
        """Expected photons per laser pulse in each bin of one period, shape (P,), starting `offset_s` after sync, of
        the scene as it is `time_s` after the first point was lit."""
        bins = max(1, round(1 / (self._repetition_hz * bin_width_s)))
        background_cps = self._detector.dark_cps + self._scene.ambient_cps
        rate = np.full(bins, background_cps / self._repetition_hz / bins)
        if spot is None:
            return rate
        collected = _collected(spot) / self._undeflected / self._repetition_hz
        delay_s = 2 * spot.range_m / SPEED_OF_LIGHT_M_PER_S + self._scene.delay_ns * 1e-9 - offset_s
        first, fractions = self._response.pulse(delay_s / bin_width_s, bin_width_s)
        _add_cyclic(rate, first, fractions * (collected * self._scene.direct_cps))
        pieces = self._pieces_at(time_s if self._scenery.moves else 0.0)
        if len(pieces.weight):
            first, hidden = self._hidden(pieces, spot, delay_s / bin_width_s, bin_width_s)
            _add_cyclic(rate, first, hidden * (collected * self._scene.hidden_cps))
        return rate

    def _hidden(self, pieces: "_Pieces", spot: Spot, delay: float, bin_width_s: float) -> tuple[int, Array]:
        """First bin, and the surfels' light in each from there on, jitter included."""
        dx = pieces.x - spot.x_m
        dy = pieces.y - spot.y_m
        squared = dx * dx + dy * dy + pieces.z2
        toward = pieces.facing + pieces.normal_x * spot.x_m + pieces.normal_y * spot.y_m
        light = np.maximum(toward, 0.0) * pieces.z / (squared * squared)
        light *= pieces.weight * light if pieces.retro is None else np.where(pieces.retro, 1.0, light) * pieces.weight
        arrival = np.sqrt(squared) * (2 / SPEED_OF_LIGHT_M_PER_S / bin_width_s) + (delay - 0.5)
        # Shared between the two bins whose centres enclose the arrival, so that its mean is exact.
        first = int(np.floor(arrival.min()))
        arrival -= first
        index = arrival.astype(np.intp)
        late = light * (arrival - index)
        length = int(index.max()) + 2
        sampled = np.bincount(index, light - late, minlength=length)
        sampled[1:] += np.bincount(index, late, minlength=length)[:-1]
        lead, kernel = self._response.kernel(bin_width_s)
        return first + lead, np.convolve(sampled, kernel)


@dataclass(frozen=True)
class _Pieces:
    """What of the surfels every point of a scan asks for, each (N,); `facing` is -position . normal."""

    x: Array
    y: Array
    z: Array
    z2: Array
    normal_x: Array
    normal_y: Array
    facing: Array
    weight: Array
    retro: npt.NDArray[np.bool_] | None
    """None where nothing is retroreflective."""


def _pieces(found: Surfels) -> _Pieces:
    x, y, z = (np.ascontiguousarray(axis) for axis in found.positions_m.T)
    normal_x, normal_y = (np.ascontiguousarray(axis) for axis in found.normals.T[:2])
    facing = -(found.positions_m * found.normals).sum(axis=1)
    retro = found.retroreflective if found.retroreflective.any() else None
    return _Pieces(x, y, z, z**2, normal_x, normal_y, facing, found.reflectance_m2, retro)


def _collected(spot: Spot | None) -> float:
    """How much of the light at the spot reaches the receiver: Lambert's law over the receiver's solid angle."""
    if spot is None:
        raise ValueError("the undeflected beam does not meet the wall")
    return spot.cos_incidence / spot.range_m**2


def _add_cyclic(rate: Array, first: int, values: Array) -> None:
    """Adds `values` from bin `first` on; what runs past the period's end comes in at its beginning."""
    start = first % len(rate)
    done = 0
    while done < len(values):
        take = min(len(values) - done, len(rate) - start)
        rate[start : start + take] += values[done : done + take]
        done, start = done + take, 0
