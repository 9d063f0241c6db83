"""The settings that physics methods share."""

from typing import Annotated, Any, ClassVar

from pydantic import Field

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.recon.memory import cube_bytes
from nlos.recon.transport.conventions import Conventions
from nlos.recon.transport.light_cone_kernel import padded_cells

TOLD_SNR = 2.0  # times the snr picked from the data, which a slow response makes look noisier than they are
PUBLISHED_SNR = 0.8  # O'Toole et al. 2018, all scenes of theirs but the diffuse ones


class PhysicsSettings(Settings):
    """Settings that every physics method knows."""

    has_inverse_filter: ClassVar[bool] = True
    """Whether `snr` means anything to the method."""

    snr: Annotated[float, Field(gt=0)] | None = None
    """Signal to noise ratio for the inverse; picked from the data unless given (authors: 0.8)."""
    falloff: Annotated[float, Field(ge=0, le=8)] = 4.0
    """Exponent with which light fades: 4 for diffuse, 2 for retroreflective surfaces."""
    bin_width_ps: Annotated[float, Field(gt=0)] | None = None
    """Rebin to this width first; a whole multiple of the data's."""
    conventions: Conventions = "physical"
    """`physical`, or `authors` for comparison with the published programs."""

    def snr_where_told(self, snr: Any) -> Any:
        """The snr for an inverse that has the response in it, from the one that `prepare` picked or was given."""
        return snr if self.snr is not None or self.conventions == "authors" else TOLD_SNR * snr

    cubes: ClassVar[float] = 3.5
    """Peak memory beside the program itself, in float32 volumes of the counts' size, measured."""

    def bytes_needed(self, wall: WallGrid, time: TimeAxis, told: bool = False) -> int:
        """Peak memory beside the program itself."""
        return int(self.cubes * cube_bytes(wall, time))

    def smaller(self, wall: WallGrid, time: TimeAxis, free: int, told: bool = False) -> dict[str, int]:
        """Settings that would take less, the gentlest first: setting -> bytes."""
        wider = (TimeAxis(max(time.bins // k, 1), time.bin_width_s * k, time.start_s) for k in (2, 4, 8, 16))
        return {f"bin_width_ps={axis.bin_width_s * 1e12:g}": self.bytes_needed(wall, axis, told) for axis in wider}


class LightConeSettings(PhysicsSettings):
    """Settings of the methods that work on the light cone."""

    tile: Annotated[int, Field(ge=1)] | None = None
    """Frequencies held at a time, to save memory; all of them unless given. The result is the same."""
    farthest_m: Annotated[float, Field(ge=0)] = 0.0
    """Depths up to here are looked at even where nothing stands out of the noise; FAR of `--depth-m`."""

    told_cubes: ClassVar[float] = 0.0
    told_spectra: ClassVar[float] = 0.0
    """What a response takes on top: volumes, and half spectra along the cone of all points; measured."""

    def bytes_needed(self, wall: WallGrid, time: TimeAxis, told: bool = False) -> int:
        """Peak memory beside the program itself: counts, both ends of the filter, and the spectrum held."""
        frequencies = padded_cells(wall, time, self.conventions) // 2 + 1
        held = min(self.tile or frequencies, frequencies)
        return self._beside(wall, time, told) + 8 * held * wall.rows * wall.cols

    def smaller(self, wall: WallGrid, time: TimeAxis, free: int, told: bool = False) -> dict[str, int]:
        """The settings that would take less, largest first: setting -> bytes."""
        frequencies = padded_cells(wall, time, self.conventions) // 2 + 1
        beside = self._beside(wall, time, told)
        tile = min((free - beside) // (8 * wall.rows * wall.cols), frequencies - 1)
        tiled = {f"tile={tile}": beside + 8 * tile * wall.rows * wall.cols} if tile >= 1 else {}
        return tiled | super().smaller(wall, time, free, told)

    def _beside(self, wall: WallGrid, time: TimeAxis, told: bool) -> int:
        """All but the spectrum that `tile` limits."""
        cubes = self.cubes + told * self.told_cubes
        frequencies = padded_cells(wall, time, self.conventions) // 2 + 1
        return int(cubes * cube_bytes(wall, time) + told * self.told_spectra * 8 * frequencies * wall.rows * wall.cols)
