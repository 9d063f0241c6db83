"""The options by which a user says what a file does not: one spelling for every verb that reads files."""

from typing import Annotated

import typer

from nlos.acquisition.importers.given import Given
from nlos.cli.exit_codes import UsageError
from nlos.recipe import FARTHEST_M

WallSize = Annotated[
    str | None, typer.Option("--wall-size-m", metavar="W[xH]", help="Size of the wall, for files that do not store it.")
]
BinWidth = Annotated[
    float | None,
    typer.Option("--bin-width-ps", help="Width of a time bin, for files that do not store it."),
]
Axes = Annotated[
    str | None,
    typer.Option("--axes", metavar="TYX|YXT|...", help="Order of the array's axes, if not YXT."),
]
Rectified = Annotated[
    bool | None,
    typer.Option(
        "--rectified/--raw", help="Whether time 0 is the wall and direct light has been removed.", show_default=False
    ),
]
Detector = Annotated[
    int | None,
    typer.Option("--detector", metavar="N", min=0, help="Of a file with several detectors, photons of this one alone."),
]
Response = Annotated[
    str,
    typer.Option(
        "--response", metavar="auto|none|FWHM_PS|FILE",
        help="What the instrument makes of an instant of light. auto: the bench's constants, else what the file says, "
        "else the scan's own direct peak, else none.",
    ),
]  # fmt: skip
Depths = Annotated[
    str | None, typer.Option("--depth-m", metavar="NEAR:FAR", help="Limit picture and volume to these depths.")
]


def given(
    wall_size_m: str | None, bin_width_ps: float | None, axes: str | None, rectified: bool | None, detector: int | None
) -> Given:
    """What the options say. Raises `UsageError`."""
    wall_m = None if wall_size_m is None else _sides(wall_size_m)
    if bin_width_ps is not None and not 0.1 <= bin_width_ps <= 1e6:
        raise UsageError(f"--bin-width-ps {bin_width_ps:g}: picoseconds are expected, 0.1 to 1000000")
    return Given(wall_m, None if bin_width_ps is None else bin_width_ps * 1e-12, axes, rectified, detector)


def depths(words: str | None) -> tuple[float, float] | None:
    """Nearest and farthest depth in metres. Raises `UsageError`."""
    if words is None:
        return None
    near, colon, far = words.partition(":")
    open_end = FARTHEST_M if near and colon else far  # as `:2` begins at the wall, `0.5:` has no end
    try:
        nearest_m, farthest_m = float(near or 0.0), float(far or open_end)
    except ValueError:
        nearest_m, farthest_m = 0.0, -1.0
    if not 0 <= nearest_m < farthest_m <= FARTHEST_M:
        raise UsageError(
            f"--depth-m {words}: NEAR:FAR in metres is expected, as 0.5:2, :2 or 0.5: (the nearer first, decimals "
            f"after a dot, at most {FARTHEST_M:g} m)"
        )
    return nearest_m, farthest_m


def _sides(words: str) -> tuple[float, float]:
    width, cross, height = words.lower().partition("x")
    try:
        sides = float(width), float(height if cross else width)
    except ValueError:
        sides = 0.0, 0.0
    if not all(0.001 <= side <= 100 for side in sides):
        raise UsageError(f"--wall-size-m {words}: W or WxH in metres, 0.001 to 100, is expected, as 2 or 2.5x1.5")
    return sides
