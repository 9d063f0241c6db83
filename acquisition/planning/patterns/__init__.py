"""The catalogue of patterns: one file each, one word each in a scan file."""

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from nlos.acquisition.planning.patterns.adaptive import Adaptive
from nlos.acquisition.planning.patterns.archimedean_spiral import ArchimedeanSpiral
from nlos.acquisition.planning.patterns.blue_noise import BlueNoise
from nlos.acquisition.planning.patterns.circle import Circle
from nlos.acquisition.planning.patterns.coarse_to_fine import CoarseToFine
from nlos.acquisition.planning.patterns.concentric_circles import ConcentricCircles
from nlos.acquisition.planning.patterns.fermat_spiral import FermatSpiral
from nlos.acquisition.planning.patterns.from_list import FromList
from nlos.acquisition.planning.patterns.jittered import Jittered
from nlos.acquisition.planning.patterns.random_pixels import RandomPixels
from nlos.acquisition.planning.patterns.raster import Raster
from nlos.acquisition.planning.patterns.serpentine import Serpentine
from nlos.acquisition.planning.patterns.subgrid import Subgrid


def _spelled_out(value: Any) -> Any:
    """`pattern: raster` is short for `pattern: {kind: raster}`."""
    return {"kind": value} if isinstance(value, str) else value


_Block = Annotated[
    Raster
    | Serpentine
    | Subgrid
    | Jittered
    | RandomPixels
    | BlueNoise
    | Circle
    | ConcentricCircles
    | ArchimedeanSpiral
    | FermatSpiral
    | CoarseToFine
    | Adaptive
    | FromList,
    Field(discriminator="kind"),
]
Word = Literal["raster", "serpentine", "coarse_to_fine"]
"""Patterns that need nothing but their word."""

Pattern = Annotated[_Block, BeforeValidator(_spelled_out, json_schema_input_type=Word | _Block)]

PATTERNS: dict[str, type[Any]] = {
    pattern.model_fields["kind"].default: pattern
    for pattern in (
        Raster,
        Serpentine,
        Subgrid,
        Jittered,
        RandomPixels,
        BlueNoise,
        Circle,
        ConcentricCircles,
        ArchimedeanSpiral,
        FermatSpiral,
        CoarseToFine,
        Adaptive,
        FromList,
    )
}
"""Word -> settings class. The first line of its docstring describes it."""

SCATTERED = (Jittered, RandomPixels, BlueNoise)
"""Patterns whose own order is no path: they are put on one."""
