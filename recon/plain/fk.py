"""f-k migration in NumPy and SciPy."""

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.front_view import depth_map, front_view
from nlos.recon.method import MethodResult
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.plain.prepared import Cube, prepare
from nlos.recon.transport.conventions import depths_m
from nlos.recon.transport.stolt import StoltMigration


class Settings(PhysicsSettings):
    """Settings of f-k migration. It has no inverse filter: `snr` changes nothing."""

    has_inverse_filter: ClassVar[bool] = False
    cubes: ClassVar[float] = 8.5


class PlainMigration:
    """Counts (T, H, W) and exposure (H, W) -> squared magnitude (D, H, W). Source: Lindell et al., ACM TOG 2019."""

    takes_response = True

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)
        self.wave = StoltMigration(wall, time, settings.conventions)

    def __call__(
        self, counts: Cube, exposure_s: npt.NDArray[np.float64], response: npt.NDArray[np.float64] | None = None
    ) -> MethodResult[Cube]:
        """The volume, its front view and its depth map."""
        volume = self.volume(counts, exposure_s, response)
        return MethodResult(front_view(volume), depth_map(volume, self.depths_m), volume)

    def volume(
        self, counts: Cube, exposure_s: npt.NDArray[np.float64], response: npt.NDArray[np.float64] | None = None
    ) -> Cube:
        """The intensity of the migrated wave, whose amplitude at the wall is the root of the counts; a `response` (K,)
        is undone along time first."""
        signal, _ = prepare(counts, exposure_s, self.settings, self.time, response)
        field = self.wave.migrate(np.sqrt(np.maximum(signal, 0)))
        return np.asarray(field.real**2 + field.imag**2)


def build(settings: Settings, wall: WallGrid, time: TimeAxis) -> PlainMigration:
    """The migration for one geometry."""
    return PlainMigration(settings, wall, time)
