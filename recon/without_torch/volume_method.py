"""What the methods in NumPy and SciPy have in common: a volume, seen from the front."""

from abc import ABC, abstractmethod

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import TimeAxis
from nlos.recon.front_view import DepthBy, depth_map, front_view
from nlos.recon.method import MethodResult
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.transport.conventions import depths_m
from nlos.recon.without_torch.prepared import Cube


class PlainVolumeMethod(ABC):
    """Counts (T, H, W) and exposure (H, W) -> front view, depth map and volume (D, H, W); `volume` is what differs."""

    takes_response = True
    depth_by: DepthBy = staticmethod(depth_map)
    """What finds the depths in a volume."""

    def __init__(self, settings: PhysicsSettings, time: TimeAxis) -> None:
        self.settings, self.time = settings, time
        self.depths_m = depths_m(time, settings.conventions)

    def __call__(
        self, counts: Cube, exposure_s: npt.NDArray[np.float64], response: npt.NDArray[np.float64] | None = None
    ) -> MethodResult[Cube]:
        """The volume, its front view and its depth map."""
        volume = self.volume(counts, exposure_s, response)
        return MethodResult(front_view(volume), self.depth_by(volume, self.depths_m), volume)

    @abstractmethod
    def volume(
        self, counts: Cube, exposure_s: npt.NDArray[np.float64], response: npt.NDArray[np.float64] | None = None
    ) -> Cube:
        """The volume (D, H, W), not below 0; a `response` (K,), shares a bin, is undone."""
