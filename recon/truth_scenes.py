"""Scenes with ground truth on disk, and what was measured of them under a condition.

A scene is a plain HDF5 scan with histograms [H, W, T] under the conditions' names (`transient`, `counts_p20` ...), its
attributes as in `acquisition/importers/plain.py`, and the truth on the same grid: `gt_intensity`, `gt_depth` (m),
`gt_mask`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.isolated import check_isolated
from nlos.acquisition.importers.plain import grid_of, read_plain
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, needed_array, open_hdf5
from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.conditions import NOISELESS, parsed, slowed
from nlos.recon.errors import InvalidData
from nlos.recon.subsets import measured_points
from nlos.recon.truth_checks import check_reach, checked_depth

Say = Callable[[str], None]


@dataclass(frozen=True)
class Scene:
    """A file's truth, and where its measurements are."""

    name: str
    path: Path
    intensity: npt.NDArray[np.float32]  # (H, W)
    depth_m: npt.NDArray[np.float32]  # (H, W), 0 = background
    mask: npt.NDArray[np.bool_]  # (H, W)
    wall: WallGrid
    falloff: int | None
    """The exponent that the file says, for methods that have one."""


def find_scenes(paths: Sequence[Path], say: Say) -> Iterator[Scene]:
    """Every scene with a truth among files and folders, in the order of their names; the others are said."""
    for path in paths:
        if not path.exists():
            raise InvalidData(f"{path} does not exist.")
        for file in sorted(path.glob("*.h5")) if path.is_dir() else [path]:
            if file.suffix.lower() in (".npz", ".npy"):
                raise InvalidData(f"{file}: scenes with ground truth are read from HDF5 files alone. Save it as one.")
            check_isolated(file, "nlos.acquisition.importers.untrusted_hdf5:read_everything")
            scene = read_scene(file)
            if scene is None:
                say(f"{file.name}: no ground truth, skipped")
            else:
                yield scene


def read_scene(path: Path) -> Scene | None:
    """The scene in `path`, or None where it has no truth. Raises `InvalidData` where its truth cannot be used."""
    try:
        with open_hdf5(path) as file:
            if not {"gt_intensity", "gt_depth", "gt_mask"} <= set(file):
                return None
            intensity, depth_m, mask = (
                needed_array(file, name, (None, None)) for name in ("gt_intensity", "gt_depth", "gt_mask")
            )
            sizes = np.atleast_1d(np.asarray(file.attrs["wall_size_m"], dtype=np.float64))
            wall = WallGrid(float(sizes[0]), float(sizes[-1]), *intensity.shape)
            falloff = file.attrs.get("falloff_exponent_authors")
            places = grid_of(path, file, intensity.shape)
    except (OSError, LookupError, ValueError, TypeError) as error:
        raise InvalidData(f"{path}: {error}. A scene needs bin_width_s, wall_size_m and gt_* of [H, W].") from error
    if not (intensity.ndim == 2 and intensity.shape == depth_m.shape == mask.shape):
        raise InvalidData(
            f"{path}: gt_intensity {intensity.shape}, gt_depth {depth_m.shape} and gt_mask {mask.shape} must be the "
            "same [H, W]."
        )
    if not (np.isfinite(intensity).all() and intensity.max(initial=0) > 0):
        raise InvalidData(f"{path}: gt_intensity holds no light or is not finite; there is nothing to compare with.")
    intensity, depth_m, mask = (places.upright(each) for each in (intensity, depth_m, mask))  # as histograms are
    depth_m = checked_depth(path, depth_m, mask > 0)
    return Scene(path.stem, path, intensity, depth_m, mask > 0, wall, None if falloff is None else int(falloff))


def datasets(scene: Scene) -> list[str]:
    """The names of the scene's histograms."""
    with open_hdf5(scene.path) as file:
        held = {name: find_dataset(file, name) for name in file}
        return [name for name, dataset in held.items() if dataset is not None and dataset.ndim == 3]


def has_condition(scene: Scene, condition: str) -> bool:
    """Whether the scene has the datasets that `condition` names."""
    return parsed(condition).needed <= set(datasets(scene))


def transient_of(scene: Scene, condition: str) -> Transient:
    """The scene's histograms under a condition; points outside it, and those not measured, have exposure 0 and no
    counts. Raises `InvalidData`, also for raw histograms."""
    wanted = parsed(condition)
    scan = read_plain(scene.path, wanted.dataset)
    whole = replace(scan.transient, response=scan.response)
    if whole.exposure_s.shape != scene.intensity.shape:
        raise InvalidData(
            f"{scene.path}: {wanted.dataset} was measured on {whole.wall.rows} x {whole.wall.cols} points, the truth "
            f"is given on {scene.intensity.shape[0]} x {scene.intensity.shape[1]}."
        )
    if not scan.rectified:
        raise InvalidData(
            f"{scene.path}: {wanted.dataset}: is raw, and methods are compared from time 0 at the wall on, without "
            "direct light. Store it so, with rectified = 1."
        )
    check_reach(scene.path, scene.depth_m, whole.time)
    if (whole.counts < 0).any():
        raise InvalidData(f"{scene.path}: {wanted.dataset} holds {int((whole.counts < 0).sum())} counts below 0.")
    if wanted.fwhm_ps is not None:
        whole = slowed(whole, read_plain(scene.path, NOISELESS).transient, wanted.fwhm_ps)
    exposure_s = whole.exposure_s * measured_points(wanted.subset, whole.wall.rows, whole.wall.cols)
    counts = whole.counts * (exposure_s > 0)
    counts[: scan.direct_cut_bins] = 0
    return replace(whole, counts=counts, exposure_s=exposure_s)
