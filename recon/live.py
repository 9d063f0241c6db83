"""Pictures of a scan while it runs: the same reconstruction as of a finished one, and how far it can be trusted."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from acquisition.transient import Transient
from recon.methods import find
from recon.reconstruct import reconstruct
from recon.volume import Reconstruction

Picture = npt.NDArray[np.float32]


@dataclass(frozen=True)
class LivePicture:
    """A reconstruction of the samples so far.

    `change`: how much the front view differs from the one before, relative L2 after scaling both to their best fit;
    1 for the first. `error`: its expected relative error from the number of photons alone (Poisson).
    `confidence` (H, W), 0 to 1: measured here, still where it was in the picture before, with light enough.
    """

    reconstruction: Reconstruction
    samples: int
    change: float
    error: float
    confidence: Picture


class LiveReconstruction:
    """Reconstructs again whenever asked; remembers only the picture before.

    Every picture is made from all samples so far, so that the last one equals that of the finished recording.
    """

    def __init__(self, method: str, settings: Mapping[str, object] | None = None, device: str = "cpu") -> None:
        self.method = method
        self.settings = dict(settings or {})
        self._device = device
        self._before: Picture | None = None

    def update(self, transient: Transient, samples: int, falloff: int | None = None) -> LivePicture:
        """The picture of `transient`, which holds `samples` samples; `falloff` where its file says one, for methods
        that have it. Raises what `reconstruct` raises."""
        settings = dict(self.settings)
        if falloff is not None and "falloff" in find(self.method).Settings.model_fields:
            settings.setdefault("falloff", falloff)
        result = reconstruct(transient, self.method, settings, self._device)
        now = np.nan_to_num(result.albedo)
        before, self._before = self._before, now
        measured = transient.exposure_s > 0
        still = np.ones_like(now) if before is None else _stillness(before, now)
        change = 1.0 if before is None else relative_change(before, now)
        photons = float(np.clip(transient.counts, 0, None).sum(dtype=np.float64))
        lit = max(int(np.count_nonzero(now > 0.1 * float(now.max(initial=0.0)))), 1)
        error = 1.0 / float(np.sqrt(max(photons / lit, 1.0)))
        nearness = _nearness(measured)
        return LivePicture(result, samples, change, error, (nearness * still / (1.0 + error)).astype(np.float32))


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
    from scipy.ndimage import distance_transform_edt

    if not measured.any():
        return np.zeros(measured.shape)
    return np.exp(-0.25 * np.asarray(distance_transform_edt(~measured)))
