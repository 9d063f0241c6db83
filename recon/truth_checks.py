"""Whether a scene's truth can be that of its scan: depths in metres that its light reaches, the same way round."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.recon.errors import InvalidData

Floats = npt.NDArray[np.floating]
WAYS: Mapping[str, Callable[[Floats], Floats]] = {
    "mirrored left to right": lambda truth: truth[:, ::-1],
    "upside down": lambda truth: truth[::-1],
    "turned by half a turn": lambda truth: truth[::-1, ::-1],
    "with rows for columns": lambda truth: truth.T,
    "turned by a quarter to the left": lambda truth: np.rot90(truth),
    "turned by a quarter to the right": lambda truth: np.rot90(truth, -1),
}
LIKE, BETTER = 0.5, 0.2
"""What the best picture's correlation has to be with the truth another way round, and by how much more than as it is: a
truth and a picture the same way round had 0.77 to 0.97, and so much or less with each other turned."""


def checked_depth(path: Path, depth_m: Floats, seen: npt.NDArray[np.bool_]) -> Floats:
    """Depths (H, W) where something is seen, 0 elsewhere. Raises `InvalidData` where they are no distances."""
    if wrong := int((~((depth_m > 0) & np.isfinite(depth_m)) & seen).sum()):
        raise InvalidData(
            f"{path}: gt_depth is not a number above 0 at {wrong} of {int(seen.sum())} points of gt_mask: metres from "
            "the wall to the scene are expected there, and 0 in gt_mask where nothing is."
        )
    return np.where(seen, depth_m, 0.0)


def check_reach(path: Path, depth_m: Floats, time: TimeAxis) -> None:
    """Raises `InvalidData` where most depths (H, W) above 0 are beyond what light of the record came from."""
    reach_m = (time.start_s + time.bins * time.bin_width_s) * SPEED_OF_LIGHT_M_PER_S / 2
    if (depth_m > 0).any() and (typical_m := float(np.median(depth_m[depth_m > 0]))) > reach_m:
        raise InvalidData(
            f"{path}: gt_depth is {typical_m:g} m at most points; the record ends with light from {reach_m:.2f} m. Is "
            "gt_depth in millimetres, or bin_width_s wrong? Metres are expected."
        )


def turned_truth(pictures: Sequence[Floats], truth: Floats) -> str:
    """What to say where pictures (H, W) agree much better with the truth (H, W) another way round; else empty."""
    as_it_is = max((_alike(each, truth) for each in pictures), default=0.0)
    found = {
        way: max((_alike(each, turn(truth)) for each in pictures), default=0.0)
        for way, turn in WAYS.items()
        if turn(truth).shape == truth.shape
    }
    way = max(found, key=lambda name: found[name])
    if found[way] < max(LIKE, as_it_is + BETTER):
        return ""
    return (
        f"pictures correlate by {found[way]:.2f} with the truth {way}, by {as_it_is:.2f} as it is. Row 0 has to be the "
        "top and column 0 the left, seen from the wall, of histograms and gt_* alike"
    )


def _alike(picture: Floats, truth: Floats) -> float:
    if not (picture.std() > 0 and truth.std() > 0):
        return 0.0
    return float(np.corrcoef(picture.ravel(), truth.ravel())[0, 1])
