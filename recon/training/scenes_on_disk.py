"""Scenes with their truth from disk, whoever made them: what training learns from beside the scenes that it makes.

Three layouts: the plain HDF5 of `nlos evaluate` (`transient` or `histograms`; `gt_intensity`, `gt_depth`, `gt_mask`);
any other file that an importer reads, y-tal's among them, with those three gt_ in NAME.truth.h5 beside it; and folders
of LFE's set, which have pictures and no depths in metres.
"""

import glob
import hashlib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.importers.isolated import check_isolated
from nlos.acquisition.importers.plain import grid_of, read_plain
from nlos.acquisition.importers.untrusted_hdf5 import needed_array, open_hdf5
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.fingerprint import fingerprint_of
from nlos.recon.training.lfe_set import LfeScene, lfe_scenes
from nlos.recon.training.shapes import Array

NOISELESS, COUNTED, TRUTH = "transient", "histograms", ".truth.h5"
NEEDED = ("gt_intensity", "gt_depth", "gt_mask")
HDF5 = (".h5", ".hdf5")
LFE_BINS = 600
WHOLE = 0.01
"""Of a bin: what rounding makes of a whole number of them."""


@dataclass(frozen=True)
class SceneOnDisk:
    """Light or counts, and the truth, all on one grid of wall points; time 0 is the wall."""

    light: Array  # (T, H, W)
    exposure: Array  # (H, W), 0 = not measured
    intensity: Array  # (H, W)
    albedo: Array  # (H, W)
    depth_m: Array  # (H, W), 0 = nothing, or not known
    coverage: Array  # (H, W)
    wall: WallGrid
    time: TimeAxis
    counted: bool
    """Whether the light was measured: then it is taken as it is, else a detector is put before it."""
    retroreflective: bool


def scene_files(pattern: str) -> list[Path]:
    """What a pattern (`*`, `?`, `[...]`, `**` for any folders) finds, in the order of the names; of a folder of LFE's
    set, `lfe/0:train` and `lfe/0:test` are the parts that were published."""
    top, _, part = pattern.rpartition(":")
    if part in ("train", "test"):
        return sorted(scene.folder for scene in lfe_scenes(Path(top), part))  # type: ignore[arg-type]
    found = sorted(Path(name) for name in glob.glob(pattern, recursive=True))
    return [path for path in found if not path.name.endswith(TRUTH)]


def check_scene(path: Path) -> None:
    """Reads a file in a child process first. Raises `InvalidData` for one that no process should read."""
    if path.is_dir():
        return
    for one in (path, _beside(path)):
        if one == path or one.is_file():
            reader = "untrusted_hdf5:read_everything" if one.suffix in HDF5 else "formats:read_any"
            check_isolated(one, f"nlos.acquisition.importers.{reader}")


def read_scene(path: Path) -> SceneOnDisk:
    """The scene in a file, or in a folder of LFE's set.

    Raises `InvalidData`, or ValueError, saying what is missing, not finite, or of another shape.
    """
    if path.is_dir():
        return _lfe(path)
    scan, counted = _scan(path)
    held = scan.transient
    light = np.array(held.counts, dtype=np.float32)
    if scan.time_offset_bins is not None and not scan.rectified:
        light = _earlier(light, scan.time_offset_bins)
    elif not scan.rectified:
        raise ValueError(f"{path}: time 0 is not the wall; set `rectified` where it is, or store `time_offset_bins`")
    light[: scan.direct_cut_bins] = 0
    if scan.rectified:
        light = _from_time_0(path, light, held.time, counted)
    intensity, albedo, depth_m, coverage = _truth(path)
    if intensity.shape != light.shape[1:]:
        raise ValueError(
            f"{path}: {light.shape[1:]} histograms, but a truth of {intensity.shape}; they must be the same"
        )
    exposure = held.exposure_s.astype(np.float32)
    if not light.any() or light.min() < 0 or not np.isfinite(light).all():
        raise ValueError(f"{path}: light must be finite, not negative and not 0 everywhere")
    time = TimeAxis(len(light), held.time.bin_width_s)
    return SceneOnDisk(
        light, exposure, intensity, albedo, depth_m, coverage, held.wall, time, counted, scan.falloff == 2
    )


def fingerprint(path: Path) -> str:
    """Of what the scene shows, whatever its file is called and however it was measured, turned or stored."""
    if path.is_dir():
        scene = LfeScene(path, path.parent.name)
        text = b"".join(scene.file(name).read_bytes() for name in ("confocal-0-*.hdr", "depth-0-*.hdr"))
        return hashlib.sha256(text).hexdigest()[:16]
    intensity, _, depth_m, _ = _truth(path)
    return fingerprint_of(intensity, depth_m)


def kinds_of(path: Path) -> tuple[str, ...]:
    """Which of our kinds of scenes a file shows, by what `write_scene` put into it; none where nobody says."""
    where = _beside(path) if _beside(path).is_file() else path
    if where.is_dir() or where.suffix not in HDF5:
        return ()
    with open_hdf5(where) as file:
        kind = file.attrs.get("kind", "")
    return tuple(kind.split("+")) if isinstance(kind, str) else ()


def _beside(path: Path) -> Path:
    return path.with_name(path.stem + TRUTH)


def _scan(path: Path) -> tuple[ImportedScan, bool]:
    """The scan, and whether it was counted."""
    if path.suffix in HDF5:
        with open_hdf5(path) as file:
            names = set(file.keys())
        if NOISELESS in names:
            return read_plain(path, NOISELESS), False
        if COUNTED in names:
            return read_plain(path, COUNTED), True
        if "H" not in names and "data" not in names:
            raise ValueError(f"{path}: holds neither `{NOISELESS}` (without noise) nor `{COUNTED}` (counts)")
    scan = read_any(path)
    counts = scan.transient.counts
    return scan, bool((counts == np.rint(counts)).all())


def _truth(path: Path) -> tuple[Array, Array, Array, Array]:
    """Intensity, albedo, depth in metres and coverage, (H, W)."""
    where = _beside(path) if _beside(path).is_file() else path
    if where.suffix not in HDF5:
        raise ValueError(f"{path}: no truth: put {', '.join(NEEDED)} [H, W] into {_beside(path).name}")
    with open_hdf5(where) as file:
        if missing := [name for name in NEEDED if name not in file]:
            raise ValueError(
                f"{path}: no truth: {', '.join(missing)} [H, W] missing; put them there, or into {_beside(path).name}"
            )
        intensity, depth_m, mask = (needed_array(file, name, (None, None)) for name in NEEDED)
        albedo, coverage = _or(file, "gt_albedo", intensity), _or(file, "gt_coverage", (mask > 0).astype(np.float32))
        places = grid_of(where, file, intensity.shape)
    if not intensity.shape == depth_m.shape == mask.shape == albedo.shape == coverage.shape:
        raise ValueError(f"{where}: the truth's arrays are of different shapes")
    if not intensity.max(initial=0) > 0 or intensity.min() < 0:
        raise ValueError(f"{where}: gt_intensity must not be negative, nor 0 everywhere")
    depth_m, coverage = np.where(mask > 0, depth_m, 0).astype(np.float32), np.clip(coverage, 0, 1)
    upright = (np.ascontiguousarray(places.upright(each)) for each in (intensity, albedo, depth_m, coverage))
    return next(upright), next(upright), next(upright), next(upright)  # as histograms are


def _or(file: h5py.File, name: str, default: Array) -> Array:
    return needed_array(file, name, (None, None)) if name in file else default


def _from_time_0(path: Path, light: Array, time: TimeAxis, counted: bool) -> Array:
    """Histograms (T, H, W) of a record that begins after time 0, behind as many empty bins. Raises ValueError where
    these are more than the record has, or of counts no whole number."""
    late = time.start_s / time.bin_width_s
    if late > time.bins or (counted and abs(late - round(late)) > WHOLE):
        raise ValueError(
            f"{path}: its record of {time.bins} bins begins {late:.6g} bins after time 0 (offset_s); no more than it "
            f"has{', and a whole number,' if counted else ''} can be put before it"
        )
    before = int(np.ceil(late - WHOLE))
    padded = np.pad(light, ((before, 0), (0, 0), (0, 0)))
    return padded if before - late <= WHOLE else _earlier(padded, np.full(light.shape[1:], before - late))


def _earlier(light: Array, offsets: npt.NDArray[np.float64]) -> Array:
    """Histograms (T, H, W), each begun at its own bin (H, W); between two bins, shared by both."""
    bins = light.shape[0]
    first = np.floor(offsets).astype(np.int64)
    part = (offsets - first).astype(np.float32)
    padded = np.concatenate((light, np.zeros_like(light[:1])))
    at = np.arange(bins)[:, None, None] + first
    here, next_ = (np.where((k >= 0) & (k < bins), k, bins) for k in (at, at + 1))
    return np.asarray(
        (1 - part) * np.take_along_axis(padded, here, 0) + part * np.take_along_axis(padded, next_, 0), np.float32
    )


def _lfe(folder: Path) -> SceneOnDisk:
    scene = LfeScene(folder, folder.parent.name)
    held, picture = scene.transient("confocal", LFE_BINS), scene.picture()
    coverage = (scene.nearness() > 0).astype(np.float32)
    nowhere = np.zeros_like(picture)
    ones = np.ones(picture.shape, np.float32)
    return SceneOnDisk(
        np.asarray(held.counts, np.float32),
        ones,
        picture,
        picture,
        nowhere,
        coverage,
        held.wall,
        held.time,
        False,
        False,
    )
