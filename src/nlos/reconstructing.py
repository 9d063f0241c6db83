"""`nlos.reconstruct`: a file, a scan or NumPy arrays to a picture."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import Transient
from nlos.array_scan import Array, Places, Size, in_its_numbers, scan_from_arrays, whether_rectified
from nlos.chain import reconstruct_scan, reconstruct_transient
from nlos.loaded import said_rectified
from nlos.picture import Picture
from nlos.python_words import said_in_python
from nlos.recipe import FARTHEST_M, Recipe
from nlos.recon.depth_range import within_depths
from nlos.recon.device import check_device
from nlos.recon.errors import InvalidSettings
from nlos.recon.own_arithmetic import own_arithmetic
from nlos.response import response_wanted
from nlos.scan_data import Scan, load
from nlos.whole_imports import whole_imports

ResponseSaid = str | float | Path | tuple[npt.ArrayLike, float]


@whole_imports()
@said_in_python()
@own_arithmetic()
def reconstruct(
    scan: Scan | Transient | str | Path | npt.ArrayLike,
    method: str | Path | None = None,
    *,
    weights: str | Path | None = None,
    wall: Size | None = None,
    bin_width: float | None = None,
    points: Places | None = None,
    axes: str | None = None,
    exposure: npt.ArrayLike | None = None,
    rectified: bool | np.bool_ | None = None,
    constants: str | Path | None = None,
    response: ResponseSaid = "auto",
    depth_m: Sequence[float] | Array | None = None,
    device: str = "cpu",
    **settings: object,
) -> Picture:
    """What is behind the corner: from a `Scan`, a file, or histograms [H, W, T] ([N, T] with `points=(x_m, y_m)`), or
    from what `Scan.calibrated` gave, cut or masked.

    For arrays: `wall` its side or (width, height) in metres, `bin_width` in seconds, `axes` the order of the axes where
    it is another ("TYX"), `exposure` in seconds per point (0 = not measured); `wall`, `bin_width` and `axes` are taken
    of a file as well, as `nlos.load` takes them. `depth_m`: (nearest, farthest), to which the picture is limited, as by
    `--depth-m`. `rectified`: whether time 0 is the wall and direct light is gone, which is assumed of arrays unless
    said; if not, both are found in the histograms. It goes before what a file or a `Scan` says. `response`: what the
    instrument makes of an instant of light, as `--response`: "auto", "none", a FWHM in picoseconds, a file, or (curve,
    bin width in seconds); `picture.response` says which was taken. `method` (a name, or a file of your own) is `lct`,
    unless `weights` (a file, or a name of those that ship) say another: they bring method and architecture. Other
    keywords are settings of the method: `nlos.methods()[method].settings`. Raises `InvalidData`, `InvalidSettings` and
    `ReconstructionFailed` of `nlos.recon.errors`, and what `nlos.load` raises.
    """
    check_device(device)
    said, limits_m = whether_rectified(rectified), _limits(depth_m)
    if isinstance(scan, str | Path):
        scan = load(scan, wall=wall, bin_width=bin_width, axes=axes, rectified=said)
        wall = bin_width = axes = None
    word, chosen = _word(method), settings
    name = word or "lct"
    if weights is not None:
        from nlos.recon.weights.described import use_weights

        name, chosen = use_weights(weights, word, settings)
    place = None if constants is None else Path(constants)
    recipe = Recipe(name, chosen, place, response_wanted(response), device).limited_to(limits_m)
    of_arrays: dict[str, object] = {
        "wall": wall, "bin_width": bin_width, "points": points, "axes": axes, "exposure": exposure
    }  # fmt: skip
    if isinstance(scan, Transient):
        of_scans = {"rectified": said, "constants": constants, "offsets": settings.get("offsets")}
        _refuse({**of_arrays, **of_scans}, "the transient is calibrated, and says so itself; leave it out.")
        made = reconstruct_transient(in_its_numbers(scan), recipe)
    elif isinstance(scan, Scan):
        _refuse(of_arrays, "the scan says so itself; these belong to plain arrays.")
        loaded, whole = scan.loaded, scan.whole
        if said is not None:
            loaded, whole = said_rectified(loaded, said), None if whole is None else said_rectified(whole, said)
        made = reconstruct_scan(loaded, recipe, whole=whole)
    else:
        loaded = scan_from_arrays(
            scan, bin_width=bin_width, wall=wall, points=points, axes=axes, exposure=exposure, rectified=said
        )
        made = reconstruct_scan(loaded, recipe)
    return Picture(made if limits_m is None else within_depths(made, *limits_m))


def _word(method: object) -> str | None:
    """The name of a method, or of its file. Raises `InvalidSettings`."""
    if method is None or isinstance(method, str):
        return method
    if isinstance(method, Path):
        return str(method)
    raise InvalidSettings(f"method: a name is expected, as 'nano', or a file, './mine.py' (given {method!r:.60})")


def _refuse(given: Mapping[str, object], why: str) -> None:
    """Raises `InvalidSettings` for words that were given where they have no place."""
    if named := [name for name, value in given.items() if value is not None]:
        raise InvalidSettings(f"{', '.join(named)}: {why}")


def _limits(depth_m: Sequence[float] | Array | None) -> tuple[float, float] | None:
    """Nearest and farthest depth. Raises `InvalidSettings`."""
    if depth_m is None:
        return None
    try:
        nearest_m, farthest_m = (float(each) for each in depth_m)
    except (TypeError, ValueError):
        nearest_m, farthest_m = 0.0, -1.0
    if not 0 <= nearest_m < farthest_m <= FARTHEST_M:
        raise InvalidSettings(f"depth_m={depth_m!r}: (nearest, farthest) in metres is expected, as (0.5, 2).")
    return nearest_m, farthest_m
