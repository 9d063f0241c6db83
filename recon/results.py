"""reconstruction.h5 and its pictures: what `nlos reconstruct` leaves behind.

Layout: `albedo` (H, W), `depth_m` (H, W, NaN where nothing is seen), `confidence` (H, W, 0 to 1: how well the wall was
measured there), `x_m` (W,), `y_m` (H,); where the method knows how sure it is `albedo_low`, `albedo_high`,
`depth_low_m`, `depth_high_m` (90 % intervals) and `seen` (probability of a surface), all (H, W); and where it has them
`volume` (D, H, W) and `depths_m` (D,); attributes `method`, `settings` (JSON), `seconds`, `weights_sha256`, `software`,
`response` (which response of the instrument was taken, in words), where one is known `response_fwhm_ps` and
`response_used` (whether the method took it into account), its curve `response_shares` (K,) with its attributes
`step_s`, `zero` and `source`,
`scan` (the name of the file that it was made from), `frame` (where it is one frame of it alone), `points` and `photons`
(measured, and in their histograms; 0 where that is not known), `samples_left_aside` (damaged or unreadable, not used),
`explained` and `explained_error` (the share of light that the picture accounts for, NaN where that could not be found),
`explained_note`, and `explained_doubt` (what speaks against the scan's wall, time zero or order of points, empty where
nothing does). Row 0 is the top, column 0 the left, seen from the wall.
"""

import json
import os
from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import h5py
import numpy as np

from nlos.acquisition.importers.imported import LARGEST_WALL_M
from nlos.acquisition.importers.untrusted_hdf5 import find_dataset, needed_array, open_hdf5
from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5
from nlos.acquisition.recording.validation import json_object
from nlos.acquisition.response import Response, gaussian, measured
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData
from nlos.recon.explained_share import NOT_LOOKED_FOR, Explained
from nlos.recon.view3d import write_view3d
from nlos.recon.volume import Intervals, Reconstruction, Volume, refuse_not_finite, response_words
from nlos.recon.whole_files import whole_files

NAMES = ("reconstruction.h5", "albedo.png", "depth.png")
EVEN = 0.5  # where no point's confidence is lower there is no picture of it


EVERYTHING = (*NAMES, "slices.png", "confidence.png", "uncertainty.png", "view3d.html")


def files_in(folder: Path) -> list[str]:
    """The names of the results that lie in `folder`: what a verb announces."""
    return [name for name in EVERYTHING if (folder / name).is_file()]


def write_results(
    folder: Path,
    reconstruction: Reconstruction,
    overwrite: bool = False,
    keep_volume: bool = True,
    html: bool = False,
) -> list[Path]:
    """Writes the files into `folder` and returns their paths: three, and where there is something to show
    confidence.png (not every point measured alike), uncertainty.png (a method that knows), slices.png (a volume), and
    view3d.html if asked for.

    Raises FileExistsError unless `overwrite`, and ReconstructionFailed for a result that is not finite, before
    anything is written.
    """
    from nlos.recon.pictures import albedo_picture, confidence_picture, depth_picture
    from nlos.recon.slices_picture import slices_picture
    from nlos.recon.uncertainty_picture import uncertainty_picture

    refuse_not_finite(reconstruction)
    paths = [folder / name for name in NAMES]
    with_slices = keep_volume and reconstruction.volume is not None
    sure = reconstruction.intervals is not None
    uneven = reconstruction.confidence is not None and float(reconstruction.confidence.min()) < EVEN
    optional = {"confidence.png": uneven, "uncertainty.png": sure, "slices.png": with_slices, "view3d.html": html}
    more = [folder / name for name, wanted in optional.items() if wanted]
    present = [path for path in (*paths, *more) if os.path.lexists(path)]
    if present and not overwrite:
        raise FileExistsError(f"{present[0]} exists. Choose another folder, or use --overwrite.")
    draw: dict[str, Callable[[Reconstruction, Path], None]] = {
        NAMES[1]: albedo_picture, NAMES[2]: depth_picture, "confidence.png": confidence_picture,
        "uncertainty.png": uncertainty_picture, "slices.png": slices_picture,
    }  # fmt: skip
    with whole_files(folder, optional, new=not overwrite) as fresh:
        write_reconstruction(fresh / NAMES[0], reconstruction, keep_volume)
        if html:
            write_view3d(fresh / "view3d.html", reconstruction)
        for name in {path.name for path in (*paths, *more)} & set(draw):
            draw[name](reconstruction, fresh / name)
    return [*paths, *more]


def write_reconstruction(path: Path, reconstruction: Reconstruction, keep_volume: bool = True) -> None:
    """Writes one HDF5 file in the layout above."""
    wall = reconstruction.wall
    with written_hdf5(path) as file:
        file.attrs["method"] = reconstruction.method
        file.attrs["settings"] = json.dumps(reconstruction.settings, sort_keys=True)
        file.attrs["seconds"] = reconstruction.seconds
        file.attrs["weights_sha256"] = reconstruction.weights_sha256 or ""
        file.attrs["software"] = software()
        file.attrs["response"] = response_words(reconstruction)
        if reconstruction.response is not None:
            _write_response(file, reconstruction.response, reconstruction.response_used)
        file.attrs["scan"] = reconstruction.scan
        if reconstruction.frame is not None:
            file.attrs["frame"] = reconstruction.frame
        file.attrs["points"], file.attrs["photons"] = reconstruction.points, reconstruction.photons
        file.attrs["samples_left_aside"] = reconstruction.left_aside
        told = reconstruction.explained or NOT_LOOKED_FOR
        file.attrs["explained"] = np.nan if told.share is None else told.share
        file.attrs["explained_error"] = np.nan if told.error is None else told.error
        file.attrs["explained_note"] = told.note
        file.attrs["explained_doubt"] = told.doubt
        file.attrs["wall_size_m"] = (wall.width_m, wall.height_m)
        file["albedo"] = reconstruction.albedo
        file["depth_m"] = reconstruction.depth_m
        if reconstruction.confidence is not None:
            file["confidence"] = reconstruction.confidence
        if reconstruction.intervals is not None:
            for name, values in vars(reconstruction.intervals).items():
                file[name] = values
        file["x_m"], file["y_m"] = wall.x_m(), wall.y_m()
        if keep_volume and reconstruction.volume is not None:
            file.create_dataset("volume", data=reconstruction.volume.albedo, compression="gzip", compression_opts=1)
            file["depths_m"] = reconstruction.volume.depths_m


def read_reconstruction(path: Path) -> Reconstruction:
    """Reads what `write_reconstruction` wrote. Raises `InvalidData` naming what is missing or wrong."""
    try:
        with open_hdf5(path) as file:
            albedo = needed_array(file, "albedo", (None, None))
            rows, cols = albedo.shape
            width_m, height_m = (float(side) for side in file.attrs["wall_size_m"])
            if not (0 < width_m <= LARGEST_WALL_M and 0 < height_m <= LARGEST_WALL_M and np.isfinite(albedo).all()):
                raise InvalidData(f"a picture on a wall of {width_m:g} x {height_m:g} m that is not finite")
            wall = WallGrid(width_m, height_m, rows, cols)
            volume = None
            if find_dataset(file, "volume") is not None:
                held = needed_array(file, "volume", (None, rows, cols))
                depths_m = needed_array(file, "depths_m", (len(held),)).astype(np.float64)
                if not (np.isfinite(held).all() and np.isfinite(depths_m).all()):
                    raise InvalidData("volume or depths_m: hold values that are not finite")
                volume = Volume(held, depths_m, wall)
            known = find_dataset(file, "confidence") is not None
            response, used = _response(file)
            return Reconstruction(
                albedo=albedo,
                depth_m=needed_array(file, "depth_m", (rows, cols)),
                wall=wall,
                method=str(file.attrs["method"]),
                seconds=float(file.attrs["seconds"]),
                settings=json_object("settings", str(file.attrs["settings"])),
                volume=volume,
                weights_sha256=str(file.attrs["weights_sha256"]) or None,
                points=int(file.attrs.get("points", 0)),
                photons=float(file.attrs.get("photons", 0.0)),
                scan=str(file.attrs.get("scan", "")),
                frame=int(file.attrs["frame"]) if "frame" in file.attrs else None,
                response=response,
                response_used=used,
                left_aside=int(file.attrs.get("samples_left_aside", 0)),
                confidence=needed_array(file, "confidence", (rows, cols)) if known else None,
                intervals=_intervals(file, rows, cols),
                explained=_explained(file.attrs),
            )
    except (InvalidData, LookupError, OSError, ValueError, TypeError, RuntimeError, AttributeError) as error:
        if isinstance(error, FileNotFoundError):
            raise
        raise InvalidData(f"{path} is not a reconstruction: {error}. Make one with `nlos reconstruct`.") from error


def _write_response(file: h5py.File, response: Response, used: bool) -> None:
    file.attrs["response_fwhm_ps"] = response.fwhm_s * 1e12
    file.attrs["response_used"] = used
    file["response_shares"] = response.shares
    for name in ("step_s", "zero", "source"):
        file["response_shares"].attrs[name] = getattr(response, name)


def _response(file: h5py.File) -> tuple[Response | None, bool]:
    """The response and whether it was used. Older files have its width and words alone: a Gaussian stands for it."""
    if "response_fwhm_ps" not in file.attrs:
        return None, False
    stored = find_dataset(file, "response_shares")
    if stored is None:
        words = str(file.attrs["response"]).partition(" ps FWHM, ")[2]
        unused = f"; {file.attrs['method']} does not use it"
        of_width = gaussian(float(file.attrs["response_fwhm_ps"]) * 1e-12, words.removesuffix(unused))
        return of_width, not words.endswith(unused)
    said = stored.attrs
    shares = needed_array(file, "response_shares", (None,))
    found = measured(shares, float(said["step_s"]), str(said["source"]), float(said["zero"]))
    return found, bool(file.attrs["response_used"])


def _intervals(file: h5py.File, rows: int, cols: int) -> Intervals | None:
    """None where the method did not know."""
    names = [field.name for field in fields(Intervals)]
    if any(find_dataset(file, name) is None for name in names):
        return None
    held = {name: needed_array(file, name, (rows, cols)) for name in names}
    if not all(np.isfinite(values).all() for values in held.values()):
        raise InvalidData("intervals that are not finite")
    return Intervals(**held)


def _explained(held: h5py.AttributeManager) -> Explained | None:
    """None in files from before it was known."""
    if "explained" not in held:
        return None
    share, error = float(held["explained"]), float(held["explained_error"])
    note, doubt = str(held["explained_note"]), str(held.get("explained_doubt", ""))
    return Explained(None, None, note) if share != share else Explained(share, error, note, doubt=doubt)


def read_explained(folder: Path) -> Explained:
    """What the result in `folder` says of the light it explains. Raises `InvalidData`."""
    try:
        with open_hdf5(folder / NAMES[0]) as file:
            return _explained(file.attrs) or NOT_LOOKED_FOR
    except (InvalidData, LookupError, OSError, ValueError, TypeError) as error:
        raise InvalidData(f"{folder / NAMES[0]} is not a reconstruction: {error}") from error


def read_made_of(folder: Path) -> tuple[str, int | None]:
    """By which method the result in `folder` was made, and of which frame alone. Raises `InvalidData`."""
    try:
        with open_hdf5(folder / NAMES[0]) as file:
            return str(file.attrs["method"]), int(file.attrs["frame"]) if "frame" in file.attrs else None
    except (InvalidData, LookupError, OSError, ValueError, TypeError) as error:
        raise InvalidData(f"{folder / NAMES[0]} is not a reconstruction: {error}") from error


def software() -> str:
    """Name and version of this project and of what computes."""
    found = []
    for package in ("nlos", "numpy", "scipy", "torch"):
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return ", ".join(found)
