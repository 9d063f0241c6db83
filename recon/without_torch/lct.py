"""The light-cone transform in NumPy and SciPy."""

from typing import ClassVar

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.physics_settings import LightConeSettings
from nlos.recon.transport.light_cone_filter import LightConeFilter
from nlos.recon.transport.resampling_matrix import resampling_matrix
from nlos.recon.transport.response_bands import BANDS, bands_of, gain_of_both, plane_brightness
from nlos.recon.without_torch.prepared import Cube, prepare
from nlos.recon.without_torch.volume_method import PlainVolumeMethod


class Settings(LightConeSettings):
    """Settings of the light-cone transform."""

    told_cubes: ClassVar[float] = 2.1


class PlainLightConeTransform(PlainVolumeMethod):
    """Counts (T, H, W) and exposure (H, W) -> albedo (D, H, W), a plane a bin. Source: O'Toole et al., Nature 2018."""

    settings: Settings

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(settings, time)
        self.matrix = resampling_matrix(time, settings.conventions).astype(np.float32)
        self.filter = LightConeFilter(wall, time, settings.conventions, settings.tile)

    def volume(
        self, counts: Cube, exposure_s: npt.NDArray[np.float64], response: npt.NDArray[np.float64] | None = None
    ) -> Cube:
        """The albedo volume, not below 0; a `response` (K,), shares a bin, is inverted with the light cone."""
        signal, snr = prepare(counts, exposure_s, self.settings, self.time)
        noise = np.float32(1 / (snr if response is None else self.settings.snr_where_told(snr)))
        if response is None:
            on_cone = along_time(self.matrix, signal)[None]
            image = self.filter(on_cone, True, lambda power, planes: 1 / (power + noise))[0]
        else:
            profile, cells = signal.mean(axis=(1, 2)), self.matrix.shape[0]
            bands = bands_of(profile, BANDS, response, self.time, cells, self.filter.padded[0])
            bright = plane_brightness(self.filter.plane_power(), bands.spectra, float(noise))
            image = np.zeros((cells, *signal.shape[1:]), np.float32)
            even = (bands.windows / bright[:, None]).astype(np.float32)
            for window, spectrum in zip(even, bands.spectra, strict=True):
                part = along_time(self.matrix, signal * window[:, None, None])[None]
                image += self.filter(part, True, gain_of_both(noise, spectrum[None]))[0]
        return np.maximum(along_time(scipy.sparse.csr_array(self.matrix.T), image), 0)


def along_time(matrix: "scipy.sparse.csr_array", x: Cube) -> Cube:
    """A sparse matrix (V, T) applied along the first axis of (T, H, W)."""
    return np.asarray(matrix @ x.reshape(len(x), -1)).reshape(matrix.shape[0], *x.shape[1:])


def build(settings: Settings, wall: WallGrid, time: TimeAxis) -> PlainLightConeTransform:
    """The transform for one geometry."""
    return PlainLightConeTransform(settings, wall, time)
