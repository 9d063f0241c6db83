"""The settings of NANO."""

from typing import Annotated, Literal

from pydantic import Field

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings as AnySettings
from nlos.recon.layers.finer_grid import FinerGrid
from nlos.recon.layers.transient_lifting import LiftingName
from nlos.recon.layers.wiener_volumes import rebinned_axis
from nlos.recon.memory import cube_bytes

OWN_BYTES = 1 << 28  # peak memory at small grids, measured from 128 x 128 x 512 to 512 x 512 x 1024 (float32, CPU)
CUBES = 13.0  # and what comes on top, in float32 volumes of the rebinned counts' size
TOLD_CUBES = 3.5  # more where a response is told, measured at 128 x 128 x 512


class Settings(AnySettings):
    """The switches of the paper's tables. The defaults are those of the weights that come with the program."""

    weights: str | None = "nano"
    """Weights file, or a name of those that ship; none for an untrained network."""
    lifting: LiftingName = "none"
    """How the transient is lifted to the operator's channels: from each point's surroundings, from all points."""
    projection: bool = True
    """Attention and a 2D network; False: the bare maximum."""
    nle: bool = True
    """The operator is told the noise level; False: a middling one, while falloff and snr still follow the estimate."""
    sfe: bool = False
    """Stochastic frequency encoding: random Fourier features of the coarsest scale's spectrum."""
    sfe_bandwidth: Annotated[int, Field(ge=1)] = 64
    """Number of its frequencies."""
    outer_iterations: Annotated[int, Field(ge=1, le=6)] = 1
    """S of algorithm 1."""
    channels: tuple[int, ...] = (16, 32, 48)
    """One entry per scale (J)."""
    iterations: Annotated[int, Field(ge=1)] = 2
    """Updates in each scale (n_j)."""
    spectral_scales: int = 2
    """Scales, the coarsest ones, that are updated in the frequency domain."""
    features: int = 8
    """Feature channels handed to the volume projection."""
    noise_weights: str | None = None
    """Noise level estimation from these weights, frozen."""
    falloff: Literal[2, 4] = 4
    """The light's, 4 from diffuse and 2 from retroreflective surfaces: what is undone before the operator sees it."""
    symmetries: bool = True
    """Average over the flips (and, on a square grid, the transpose) of the wall once trained: eight times the operator,
    not the physics."""
    refine: bool = True
    """Hold the picture against the light that it was made from, and correct it, for the weights that ship; False: a
    picture without intervals, which are those of corrected ones."""
    finer_grid: bool = True
    """See arrays of fewer than 28 points a side among cells that nobody measured, 48 a side and more, once trained."""
    bfloat16: bool = False
    """Convolutions in three dimensions in bfloat16, once trained: for films, where the processor multiplies in it."""
    from_first_light: bool = False
    """Skip the depths before the first light, once trained: for films, where each costs time."""
    stage: Literal["whole", "noise"] = "whole"
    """What is trained: the operator with frozen noise estimation, or noise estimation alone."""

    def grid(self, wall: WallGrid) -> FinerGrid:
        """What scans of `wall` are seen on."""
        return FinerGrid.of_few(wall) if self.finer_grid and self.weights is not None else FinerGrid(wall)

    def bytes_needed(self, wall: WallGrid, time: TimeAxis, told: bool = False) -> int:
        """Peak memory beside the program itself and the counts: the operator's own grid does not grow with the scan's,
        what noise estimation and the Wiener volumes hold does."""
        finer = self.grid(wall).wall
        return OWN_BYTES + int((CUBES + told * TOLD_CUBES) * cube_bytes(finer, rebinned_axis(wall, time)[1]))

    def smaller(self, wall: WallGrid, time: TimeAxis, free: int, told: bool = False) -> dict[str, int]:
        """No setting makes it less."""
        return {}
