"""What a reconstruction is: a volume of albedo behind the wall, its front view and its depth map."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from nlos.acquisition.response import Response
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.explained_share import Explained

FINISHED = "finished"
"""Among a picture's settings where a network for films finished it."""


@dataclass(frozen=True)
class Volume:
    """Albedo in arbitrary units at depths in front of the wall (z from the wall towards the hidden scene)."""

    albedo: npt.NDArray[np.float32]  # (D, H, W)
    depths_m: npt.NDArray[np.float64]  # (D,)
    wall: WallGrid


@dataclass(frozen=True)
class Intervals:
    """Where the truth of each pixel lies in nine cases of ten, (H, W) each: of the brightness in the picture's own
    units (its scale being the best one), of the depth where there is a surface."""

    albedo_low: npt.NDArray[np.float32]
    albedo_high: npt.NDArray[np.float32]
    depth_low_m: npt.NDArray[np.float32]
    depth_high_m: npt.NDArray[np.float32]
    seen: npt.NDArray[np.float32]
    """The probability that there is a surface."""


@dataclass(frozen=True)
class Reconstruction:
    """Front view and depth map, NaN where nothing is seen; the volume where the method has one."""

    albedo: npt.NDArray[np.float32]  # (H, W)
    depth_m: npt.NDArray[np.float32]  # (H, W)
    wall: WallGrid
    method: str
    seconds: float
    settings: dict[str, Any] = field(default_factory=dict)
    volume: Volume | None = None
    weights_sha256: str | None = None
    """Of the weights file, for learned methods."""
    confidence: npt.NDArray[np.float32] | None = None
    """(H, W), 0 to 1: how well the wall was measured at each point; see `gridding.confidence`."""
    points: int = 0
    """Points of the wall that were measured; 0 where that is not known."""
    photons: float = 0.0
    """What their histograms held, direct light and background removed."""
    scan: str = ""
    """The name of the file that it was made from."""
    frame: int | None = None
    """Which frame of it; None: all that it holds."""
    response: Response | None = None
    """What the instrument makes of an instant of light, as far as it was known."""
    response_used: bool = False
    """Whether the method took it into account."""
    left_aside: int = 0
    """Samples of the scan that were damaged or unreadable, and not used."""
    intervals: Intervals | None = None
    """How sure the method is of every pixel, where it knows."""
    explained: Explained | None = None
    """How much of light that it was not made from the picture accounts for."""

    @property
    def made_from(self) -> str:
        """The scan, and which frame of it, for people."""
        return self.scan if self.frame is None else f"{self.scan} frame {self.frame}"

    def middle_depths_m(self) -> tuple[float, float] | None:
        """Nearest and farthest of the middle 96 % of the depths that are there; None where nothing is seen."""
        depths_m = self.depth_m[np.isfinite(self.depth_m)]
        if not depths_m.size:
            return None
        near_m, far_m = np.quantile(depths_m, (0.02, 0.98))
        return float(near_m), float(far_m)

    def intervals_to_m(self) -> float | None:
        """The depth behind which nothing stood out of the noise and nothing was looked for: intervals say nothing of
        what may lie there and sends less light. None where it was looked for in all planes, or there are no
        intervals."""
        if self.intervals is None or self.volume is None:
            return None
        lit = np.flatnonzero(self.volume.albedo.any(axis=(1, 2)))
        if not len(lit) or lit[-1] + 1 == len(self.volume.depths_m):
            return None
        return float(self.volume.depths_m[lit[-1]])


def refuse_not_finite(reconstruction: Reconstruction) -> None:
    """Raises `ReconstructionFailed` for a picture or volume with numbers that are not finite, saying how many.

    A depth that is NaN says that nothing is seen there; an infinite one says nothing.
    """
    volume = reconstruction.volume
    fields = {
        "brightness": np.isfinite(reconstruction.albedo),
        "depth": ~np.isinf(reconstruction.depth_m),
        "volume": np.isfinite(volume.albedo) if volume is not None else np.True_,
    }
    wrong = [f"{finite.size - int(finite.sum())} of {finite.size} ({name})" for name, finite in fields.items()
             if not finite.all()]  # fmt: skip
    if wrong:
        raise ReconstructionFailed(
            f"{reconstruction.method}: numbers that are not finite: {', '.join(wrong)}. The counts are finite, so this "
            "is a fault of the method: use another, and report this one with the file."
        )


def response_words(reconstruction: Reconstruction) -> str:
    """Which response of the instrument the picture was made with, in words."""
    response = reconstruction.response
    if response is None:
        return "none known"
    unused = "" if reconstruction.response_used else f"; {reconstruction.method} does not use it"
    return f"{response.fwhm_s * 1e12:.0f} ps FWHM, {response.source}{unused}"
