"""y-tal HDF5 (HDF5_TAL): a confocal capture that `tal.io.read_capture` reads. Format: y-tal 0.20, `tal.io`."""

import json
from pathlib import Path

import h5py
import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.scan_arrays import ScanArrays
from nlos.acquisition.exporters.scan_facts import unsaid
from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, as_floats

_NOWHERE_M = (0.0, 0.0, 1.0)
_H_FORMATS = {"UNKNOWN": 0, "T_Sx_Sy": 1, "T_Lx_Ly_Sx_Sy": 2, "T_Si": 3, "T_Li_Si": 4}
_GRID_FORMATS = {"UNKNOWN": 0, "N_3": 1, "X_Y_3": 2}
_VOLUME_FORMATS = {"UNKNOWN": 0, "N_3": 1, "X_Y_Z_3": 2, "X_Y_3": 3}


def write_ytal(scan: ScanArrays, path: Path) -> list[str]:
    """Writes a scan on a grid, indexed [x, y] with x and y rising, or the list of its free positions. Returns what the
    format cannot hold.

    Times of a raw scan keep the ways between scanner and wall (`t_accounts_first_and_last_bounces`), which y-tal takes
    off by the scanner's place; `t_start` is the length of a path that would end with the first bin's beginning.

    Raises `InvalidData` for a grid of points on one line, which say of no wall how high it is, or how wide.
    """
    if scan.on_grid and min(scan.wall.rows, scan.wall.cols) < 2:
        raise InvalidData(f"{path}: y-tal's captures need 2 x 2 points at least; export a line of points to npz")
    if scan.on_grid:
        x, y = np.meshgrid(scan.x_m, scan.y_m[::-1], indexing="ij")
        counts, kind, points = scan.histograms[::-1].transpose(2, 1, 0), "T_Sx_Sy", "X_Y_3"
    else:
        x, y, counts, kind, points = scan.x_m, scan.y_m, scan.histograms.T, "T_Si", "N_3"
    grid = np.stack([x, y, np.zeros_like(x)], axis=-1)
    normals = np.zeros_like(grid)
    normals[..., 2] = 1.0
    with written_hdf5(path) as file:
        file.create_dataset(
            "H",
            data=as_floats(counts),
            compression="gzip",
            compression_opts=1,
        )
        _enum(file, "H_format", kind, _H_FORMATS)
        for who in ("sensor", "laser"):
            file[f"{who}_xyz"] = np.array(_NOWHERE_M if scan.scanner is None else scan.scanner.position_m)
            file[f"{who}_grid_xyz"] = grid
            file[f"{who}_grid_normals"] = normals
            _enum(file, f"{who}_grid_format", points, _GRID_FORMATS)
        _enum(file, "volume_format", "UNKNOWN", _VOLUME_FORMATS)
        file["delta_t"] = scan.time.bin_width_s * SPEED_OF_LIGHT_M_PER_S
        delay_s = 0.0 if scan.scanner is None else scan.scanner.delay_s
        file["t_start"] = (scan.time.start_s - delay_s) * SPEED_OF_LIGHT_M_PER_S
        file["t_accounts_first_and_last_bounces"] = scan.scanner is not None
        file["scene_info"] = json.dumps(_said(scan))  # which is YAML as well
    left: list[str] = []
    if scan.scanner is not None:
        (x_m, y_m, z_m), error_mm = scan.scanner.position_m, [1e3 * each for each in scan.scanner.error_m]
        left.append(
            f"the scanner is at ({x_m:.3f}, {y_m:.3f}, {z_m:.3f}) m by the times of direct light, which tell it to "
            f"{', '.join(f'{each:.2g}' for each in error_mm)} mm where they are true to a bin: more points tell more"
        )
    elif not scan.rectified:
        left.append("time 0 is not the wall and nothing tells the scanner's place: y-tal's solvers will not focus it")
    in_its_paths = ("time_offset_bins",) if scan.scanner is not None else ()
    return [*left, *unsaid(scan, "falloff_exponent_authors", *in_its_paths)]


def _said(scan: ScanArrays) -> dict[str, object]:
    """What y-tal's own fields do not say, in the place that it leaves for anything; `exposure_us` indexed [x, y]. In
    microseconds no dwell is written as 1e-05, which YAML takes for text."""
    said: dict[str, object] = {"original_format": "nlos", "rectified": scan.rectified, "wall_known": scan.wall_known}
    said["exposure_us"] = (1e6 * (scan.exposure_s[::-1].T if scan.on_grid else scan.exposure_s)).round(6).tolist()
    if not scan.on_grid:  # whose points do not say how large the wall is
        said["wall_size_m"] = [float(scan.wall.width_m), float(scan.wall.height_m)]
    if scan.falloff is not None:
        said["falloff_exponent_authors"] = scan.falloff
    if scan.direct_cut_bins:
        said["direct_cut_bins"] = scan.direct_cut_bins
    return said


def _enum(file: h5py.File, name: str, word: str, words: dict[str, int]) -> None:
    dataset = file.create_dataset(name, (1,), dtype=h5py.enum_dtype(words, basetype="i"))
    dataset[0] = words[word]
