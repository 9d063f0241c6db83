"""What a training file says of its samples: `data` and `validation`."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.recon.training.detector import DetectorSettings


class DatasetSettings(Settings):
    """Which samples: geometry, how many scenes, of which kinds, how measured. Equal settings mean equal samples."""

    seed: Annotated[int, Field(ge=0)] = 1
    """Seed of the scenes."""
    scenes: Annotated[int, Field(ge=1)] = 2000
    """How many different scenes."""
    degradations: Annotated[int, Field(ge=1, le=64)] = 3
    """Differently measured copies of each."""
    held_out: bool = False
    """Draw the kinds that are kept for testing."""
    kinds: tuple[str, ...] = ()
    """Kinds of scenes; all unless given."""
    wall_width_m: Annotated[float, Field(ge=0.01, le=100)] = 2.0
    """Side of the wall."""
    rows: Annotated[int, Field(ge=4, le=1024)] = 64
    """Scan points from top to bottom."""
    cols: Annotated[int, Field(ge=4, le=1024)] = 64
    """Scan points from left to right."""
    bins: Annotated[int, Field(ge=8, le=65536)] = 256
    """Time bins."""
    bin_width_ps: Annotated[float, Field(ge=0.1, le=1e5)] = 64.0
    """Width of a bin."""
    retroreflective: bool = False
    """Surfaces that send light back where it came from."""
    shadows: bool = False
    """Surfaces hide each other from the wall."""
    solid: bool = False
    """Sides and rears of bodies, and what is behind something, send light to the wall; only with `shadows`, which says
    what blocks it."""
    second_bounce: bool = False
    """Light that meets two hidden surfaces."""
    impulse_responses: tuple[str, ...] = ()
    """HDF5 files of measured responses."""
    detector: DetectorSettings = DetectorSettings()
    """How scenes are measured."""
    files: Annotated[str, Field(min_length=1)] | None = None
    """Pattern of scenes on disk with their truth, `mine/*.h5`, or a part of LFE's set, `lfe/0:train`; see Train your
    own."""
    share: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Share of the samples that come from `files`; the others are generated."""

    @model_validator(mode="after")
    def _nothing_shines_through(self) -> Self:
        if self.solid and not self.shadows:
            raise ValueError("solid: true needs shadows: true, or light would pass through the bodies")
        return self

    @property
    def wall(self) -> WallGrid:
        return WallGrid(self.wall_width_m, self.wall_width_m * self.rows / self.cols, self.rows, self.cols)

    @property
    def time(self) -> TimeAxis:
        return TimeAxis(self.bins, self.bin_width_ps * 1e-12)

    def __len__(self) -> int:
        return self.scenes * self.degradations
