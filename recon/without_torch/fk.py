"""f-k migration in NumPy and SciPy."""

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.front_view import middle_map
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.transport.stolt import StoltMigration
from nlos.recon.without_torch.prepared import Cube, prepare
from nlos.recon.without_torch.volume_method import PlainVolumeMethod


class Settings(PhysicsSettings):
    """Settings of f-k migration. It has no inverse filter: `snr` changes nothing, and is known so that one --set does
    for every physics method."""

    has_inverse_filter: ClassVar[bool] = False
    cubes: ClassVar[float] = 8.5


class PlainMigration(PlainVolumeMethod):
    """Counts (T, H, W) and exposure (H, W) -> squared magnitude (D, H, W). Source: Lindell et al., ACM TOG 2019."""

    depth_by = staticmethod(middle_map)

    def __init__(self, settings: Settings, wall: WallGrid, time: TimeAxis) -> None:
        super().__init__(settings, time)
        self.wave = StoltMigration(wall, time, settings.conventions)

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
