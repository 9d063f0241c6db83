"""Pictures of a scan while it runs: the same reconstruction as of a finished one, and how far it can be trusted."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, Transient
from nlos.recon.kept_noise import KeptNoise
from nlos.recon.methods import find, parse_settings
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.predicted_error import said_by
from nlos.recon.reconstruct import explained, get_ready, reconstruct
from nlos.recon.volume import FINISHED, Reconstruction

if TYPE_CHECKING:
    from nlos.recon.film_network import FilmFinish
    from nlos.recon.layers.film_network import FilmNetwork

Picture = npt.NDArray[np.float32]

METHOD = "nano"
GROWTH = 1.25
"""Pictures are compared with one of so many times fewer samples: then "change" means the same from the first to the
last, however often pictures are made."""


@dataclass(frozen=True)
class LivePicture:
    """A reconstruction of the samples so far.

    `change`: how much the front view differs from the newest one of at most 1/`GROWTH` of the samples, relative L2
    after scaling both to their best fit; 1 where there is none. `error`: its expected relative error from the number
    of photons alone (Poisson). `confidence` (H, W), 0 to 1: measured here, still where it was in the picture before,
    with light enough. `bound`: the relative error that nine of ten such front views stay below, by the method's own
    intervals; None where it has none. More light of a scene that does not move takes nothing away from what an earlier
    picture was sure of: the bound is the least so far, which is also what `scan --until sure` ends by.
    """

    reconstruction: Reconstruction
    samples: int
    change: float
    error: float
    confidence: Picture
    bound: float | None = None


class LiveReconstruction:
    """Reconstructs again whenever asked; remembers only the front views that the next ones are compared with, and how
    noisy a film is.

    Every picture is made from all samples so far and equals that of a recording of just these samples.
    """

    def __init__(
        self, method: str = METHOD, settings: Mapping[str, object] | None = None, device: str = "cpu",
        finish: bool = True,
    ) -> None:  # fmt: skip
        """`finish` False: pictures of films stay as the method makes them, although the weights come with a network for
        films. Raises `InvalidSettings` for a method or a setting that does not exist."""
        self.method = method
        self.settings = dict(settings or {})
        parse_settings(method, self.settings)
        self._device = device
        self._earlier: list[tuple[int, Picture]] = []
        self._bound = math.inf
        self._noise = KeptNoise()
        self._finishes = finish
        self._finish: FilmFinish | None = None
        self._knows_falloff = "falloff" in find(method).Settings.model_fields

    def anew(self) -> "LiveReconstruction":
        """The same, which has seen nothing yet."""
        return LiveReconstruction(self.method, self.settings, self._device, self._finishes)

    def update(self, transient: Transient, samples: int, falloff: int | None = None) -> LivePicture:
        """The picture of `transient`, which holds `samples` samples; `falloff` where its file says one, for methods
        that have it. How much light it explains is not looked for: see `explained`. Raises what `reconstruct` raises.
        """
        made = reconstruct(transient, self.method, self._set(falloff), self._device, explain=False)
        picture = self._judged(transient, made, samples)
        if picture.bound is None:
            return picture
        self._bound = min(self._bound, picture.bound)
        return replace(picture, bound=self._bound)

    def get_ready(self, transient: Transient, falloff: int | None = None) -> None:
        """Builds what `update` needs for such a transient, so that it need not wait for that. Raises as it does."""
        get_ready(transient, self.method, self._set(falloff))

    def explained(self, picture: LivePicture, transient: Transient, falloff: int | None = None) -> LivePicture:
        """The same picture, how much of the light of `transient`, which it was made from, it explains, and what speaks
        against the scan's geometry."""
        share = explained(transient, self.method, self._set(falloff), self._device, elsewhere=True)
        return replace(picture, reconstruction=replace(picture.reconstruction, explained=share))

    def of_film(self, seen: HalfGrid, samples: int, falloff: int | None = None) -> LivePicture:
        """The same of a frame of a film: see `made_of_film` and `judged_of_film`."""
        return self.judged_of_film(seen, self.made_of_film(seen, falloff), samples)

    def made_of_film(self, seen: HalfGrid, falloff: int | None = None, hurried: bool = False) -> Reconstruction:
        """A picture of a frame on half the grid, for speed without averages over mirror images, without a look at how
        much light it explains, in bfloat16 where the processor computes in it, and told the response only where that is
        wider than a quarter of a cell; `hurried`, or if it will be finished, without refinement too; `hurried` from the
        first light's depth on. How noisy a film is is found for every eighth frame. May be asked for in several
        threads."""
        wall, response = seen.light.wall, seen.light.response
        cell_s = 2 * max(wall.width_m / wall.cols, wall.height_m / wall.rows) / SPEED_OF_LIGHT_M_PER_S
        told = response is not None and response.fwhm_s > cell_s / 4
        light = seen.light if told else replace(seen.light, response=None)
        chosen = self._set_for_film(falloff, hurried, self.finishes(seen))
        with self._noise.in_use():
            return reconstruct(light, self.method, chosen, self._device, explain=False)

    def get_ready_for_film(self, seen: HalfGrid, falloff: int | None = None, hurried: bool = False) -> None:
        """Builds what `made_of_film` needs for such a frame. Raises as it does."""
        get_ready(seen.light, self.method, self._set_for_film(falloff, hurried, self.finishes(seen)))

    def can_hurry(self, seen: HalfGrid) -> bool:
        """Whether pictures of such frames can be made with less."""
        finished = self.finishes(seen)
        return self._set_for_film(None, True, finished) != self._set_for_film(None, False, finished)

    def judged_of_film(self, seen: HalfGrid, made: Reconstruction, samples: int) -> LivePicture:
        """That picture on the whole grid, finished by the network for films where there is one for it, and how far it
        can be trusted; to be asked for in the order of the frames."""
        picture = self._judged(seen.light, made, samples)
        confidence = seen.enlarged(replace(made, confidence=picture.confidence)).confidence
        assert confidence is not None
        return replace(picture, reconstruction=self._finished(seen, made), confidence=confidence)

    def finishes(self, seen: HalfGrid) -> bool:
        """Whether the network for films that comes with NANO's weights will finish pictures of such frames."""
        return self._network(seen) is not None

    def _network(self, seen: HalfGrid) -> "FilmNetwork | None":
        if not self._finishes or self.method != "nano":
            return None
        from nlos.recon.film_network import film_network_for, takes

        weights = parse_settings(self.method, self.settings).model_dump()["weights"]
        return film_network_for(weights) if takes(seen) else None

    def _finished(self, seen: HalfGrid, made: Reconstruction) -> Reconstruction:
        whole, network = seen.enlarged(made), self._network(seen)
        if network is None or seen.given is None:
            return whole
        from nlos.recon.film_network import FilmFinish

        self._finish = self._finish or FilmFinish(network)
        finished = self._finish(seen.given, whole, made.volume)
        return replace(finished, settings={**finished.settings, FINISHED: True})

    def _set_for_film(self, falloff: int | None, hurried: bool, finished: bool) -> dict[str, object]:
        known = find(self.method).Settings.model_fields
        quick: dict[str, object] = {"symmetries": False, "finer_grid": False}
        if "bfloat16" in known and self._device == "cpu":
            from nlos.recon.layers.in_bfloat16 import bfloat16_is_fast

            quick["bfloat16"] = bfloat16_is_fast()
        if hurried or finished:
            quick["refine"] = False
        if hurried:
            quick["from_first_light"] = not self.settings.get("refine", False)
        return {name: value for name, value in quick.items() if name in known} | self._set(falloff)

    def _set(self, falloff: int | None) -> dict[str, object]:
        settings = dict(self.settings)
        if falloff is not None and self._knows_falloff:
            settings.setdefault("falloff", falloff)
        return settings

    def _judged(self, transient: Transient, result: Reconstruction, samples: int) -> LivePicture:
        now = result.albedo
        before = self._compared_with(samples, now)
        measured = transient.exposure_s > 0
        still = np.ones_like(now) if before is None else _stillness(before, now)
        change = 1.0 if before is None else relative_change(before, now)
        photons = float(np.clip(transient.counts, 0, None).sum(dtype=np.float64))
        lit = max(int(np.count_nonzero(now > 0.1 * float(now.max(initial=0.0)))), 1)
        error = 1.0 / float(np.sqrt(max(photons / lit, 1.0)))
        confidence = (_nearness(measured) * still / (1.0 + error)).astype(np.float32)
        return LivePicture(result, samples, change, error, confidence, error_bound(result))

    def _compared_with(self, samples: int, now: Picture) -> Picture | None:
        """The newest front view of few enough samples; those before it are forgotten."""
        fewer = [entry for entry in self._earlier if entry[0] * GROWTH <= samples]
        more = [entry for entry in self._earlier if entry[0] * GROWTH > samples]
        self._earlier = [*fewer[-1:], *more, (samples, now)]
        return fewer[-1][1] if fewer else None


def error_bound(made: Reconstruction) -> float | None:
    """The relative L2 error that the front view of nine of ten such pictures stays below; None without intervals."""
    from nlos.recon.intervals import head_for

    if made.intervals is None or (head := head_for(made.settings.get("weights"))) is None:
        return None
    return head.error.at(said_by(made.albedo, made.intervals.albedo_low, made.intervals.albedo_high))


def relative_change(before: Picture, now: Picture) -> float:
    """|now - s before| / |now| with the best s; 0 where both are empty."""
    norm = float(np.linalg.norm(now))
    if norm == 0.0:
        return 0.0 if not before.any() else 1.0
    scale = float(np.vdot(before, now)) / max(float(np.vdot(before, before)), 1e-30)
    return float(np.linalg.norm(now - scale * before)) / norm


def _stillness(before: Picture, now: Picture) -> npt.NDArray[np.float64]:
    """1 where a pixel kept its part of the picture, less the more it moved, against the picture's maximum."""
    top = max(float(now.max(initial=0.0)), 1e-30)
    scale = float(np.vdot(before, now)) / max(float(np.vdot(before, before)), 1e-30)
    return np.exp(-4.0 * np.abs(now - scale * before) / top)


def _nearness(measured: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """1 at measured points, falling with the distance in pixels to the nearest one."""
    if not measured.any():
        return np.zeros(measured.shape)
    return np.exp(-0.25 * np.asarray(scipy.ndimage.distance_transform_edt(~measured)))
