"""From a file or arrays to a picture: read, calibrate, reconstruct, write. What every way to a picture shares."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from nlos.recon.errors import InvalidSettings

if TYPE_CHECKING:
    from nlos.acquisition.recording.recording import Recording
    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.correct import Report
    from nlos.calibration.raw_points import RawPoints
    from nlos.recon.volume import Reconstruction


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadedScan:
    """A scan from any file, before calibration."""

    transient: "Transient"
    devices: Mapping[str, str]
    """Role -> model and serial number; empty where the file does not say."""
    sync_count: npt.NDArray[np.float64]  # (H, W); 0 where not counted
    total_count: npt.NDArray[np.float64]  # (H, W)
    rectified: bool
    direct_cut_bins: int | None
    """The file's own cut; None where the direct light has to be found."""
    falloff: int | None
    offset_bins: npt.NDArray[np.float64] | None  # (H, W)
    """The file's own time offsets."""
    wall_known: bool = True
    """Whether the file says how large the wall is."""
    points: "RawPoints | None" = None
    """Samples at free positions as they were taken; `transient` then has them in the pixels they lie in."""


def load_scan(path: Path) -> LoadedScan:
    """Reads our own recordings and every format that an importer knows. Raises `InvalidData`."""
    from nlos.acquisition.importers.isolated import read_isolated
    from nlos.acquisition.importers.magic import is_recording
    from nlos.acquisition.recording.checked import open_checked

    if is_recording(path):
        with open_checked(path) as recording:
            return _load_recording(recording) if recording.on_grid else _load_free(recording)
    scan = read_isolated(path)
    for note in scan.notes:
        log.debug("%s: %s", path, note)
    check_raw(path, scan.transient)
    cut = scan.direct_cut_bins if scan.direct_cut_bins > 0 else None
    nothing, offsets = np.zeros_like(scan.transient.exposure_s), scan.time_offset_bins
    return LoadedScan(scan.transient, {}, nothing, nothing, scan.rectified, cut, scan.falloff, offsets, scan.wall_known)


def check_raw(path: Path, transient: "Transient") -> None:
    """Raises `InvalidData` for a file whose counts nobody can have counted, naming the first bad point."""
    from nlos.acquisition.errors import InvalidData

    for bad, what in ((~np.isfinite(transient.counts), "not a number"), (transient.counts < 0, "negative")):
        if bad.any():
            bin_, row, col = (int(i) for i in np.argwhere(bad)[0])
            raise InvalidData(
                f"{path}: histograms: row {row}, column {col}, bin {bin_} is {what} "
                f"({transient.counts[bin_, row, col]:g}). Fix that point, or mark it as not measured (exposure 0)."
            )


def _load_recording(recording: "Recording") -> LoadedScan:
    """A whole recording."""
    transient = recording.transient()
    sync_count, total_count = np.zeros_like(transient.exposure_s), np.zeros_like(transient.exposure_s)
    for start, counts, intact in recording.blocks():
        records = recording.records[start : start + len(counts)][intact]
        place = recording.plan.positions.row[records["number"]], recording.plan.positions.col[records["number"]]
        np.add.at(sync_count, place, records["sync_count"])
        np.add.at(total_count, place, records["total_count"])
    return as_recorded(recording, transient, sync_count, total_count)


def _load_free(recording: "Recording") -> LoadedScan:
    """A whole recording of points off the grid: what was drawn along a spiral, a circle, a line."""
    from nlos.calibration.raw_points import from_samples
    from nlos.recon.gridding import grid_samples

    points = from_samples(recording.samples())
    transient = grid_samples(points.x_m, points.y_m, points.counts, points.exposure_s, recording.plan.wall, points.time)
    nothing = np.zeros_like(transient.exposure_s)
    return replace(as_recorded(recording, transient, nothing, nothing), points=points)


def as_recorded(
    recording: "Recording",
    transient: "Transient",
    sync_count: npt.NDArray[np.float64],
    total_count: npt.NDArray[np.float64],
) -> LoadedScan:
    """All or some of a recording's samples; one that was imported keeps what its source said."""
    from nlos.acquisition.importers.to_recording import said_by_source

    said = said_by_source(recording)
    cut, falloff, offsets = said.get("direct_cut_bins"), said.get("falloff"), said.get("time_offset_bins")
    return LoadedScan(
        transient,
        {role: f"{who.model} {who.serial}".strip() for role, who in recording.header.devices.items()},
        sync_count,
        total_count,
        bool(said.get("rectified", False)),
        cut if isinstance(cut, int) and cut > 0 else None,
        falloff if isinstance(falloff, int) else None,
        np.asarray(offsets, dtype=np.float64) if isinstance(offsets, list) else None,
        bool(said.get("wall_known", True)),
    )


def constants_for(scan: LoadedScan, given: Path | None) -> "BenchConstants | None":
    """The constants named, or the newest in `constants/` that fit this scan's devices. Raises `ForeignConstants`."""
    from nlos.calibration.constants import load, newest_that_fits

    path = given
    if path is None and scan.devices and Path("constants").is_dir():
        path = newest_that_fits(Path("constants"), scan.devices, scan.transient.time.bin_width_s)
    if path is None:
        return None
    constants = load(path)
    constants.refuse_other_devices(scan.devices)
    log.info("constants: %s, measured %s", path, constants.measured_utc)
    return constants


def calibrate_scan(
    scan: LoadedScan, use_file_offsets: bool = False, constants: "BenchConstants | None" = None
) -> "Transient":
    """The transient that the physics can use: time 0 at the direct arrival, direct light removed.

    A rectified file that states its cut gets that cut; in one that states none, direct light is looked for.
    """
    from nlos.calibration.correct import correct, correct_points

    transient = scan.transient
    if scan.points is not None:
        from nlos.recon.gridding import grid_samples

        points = scan.points
        if scan.rectified and scan.direct_cut_bins is not None:
            points = replace(points, counts=without_first(points.counts.T, scan.direct_cut_bins).T)
        done = correct_points(points, constants, rectified=scan.rectified, remove_direct=scan.direct_cut_bins is None)
        if not scan.rectified:
            _log_calibration(done.report())
        return grid_samples(scan.points.x_m, scan.points.y_m, done.counts, done.exposure_s, transient.wall, done.time)
    if scan.rectified and scan.direct_cut_bins is not None:
        return cut_direct(transient, scan.direct_cut_bins)
    if scan.rectified:
        return correct(transient, rectified=True).transient
    if use_file_offsets:
        if scan.offset_bins is None:
            raise InvalidSettings("offsets=file: the file has no time_offset_bins")
        return correct(transient, offset_bins=scan.offset_bins).transient
    corrected = correct(transient, constants, sync_count=scan.sync_count, total_count=scan.total_count)
    _log_calibration(corrected.report())
    return corrected.transient


def _log_calibration(report: "Report") -> None:
    rms_bins, points = report["offset_rms_bins"], report["points"]
    assert isinstance(points, int)
    if not isinstance(rms_bins, float):
        if points >= 9:
            log.info(
                "calibrated: no plane wall explains the arrivals at %d points; each was aligned by its own", points
            )
        return
    log.info(
        "calibrated: offsets to %.1f ps RMS of the wall fit, direct light masked up to %.2f ns",
        report["offset_rms_ps"],
        report["direct_masked_ns"],
    )
    if rms_bins > 1:
        log.warning(
            "arrivals scatter by %.1f bins about a plane wall. Is this a raw scan, does its time window hold the "
            "direct light, is the wall plane? `nlos calibrate` draws them.",
            rms_bins,
        )


def on_wall(scan: LoadedScan, side_m: object) -> LoadedScan:
    """The same scan on a square wall, for files that do not store its size. Raises `InvalidSettings`."""
    if not isinstance(side_m, int | float) or not 0 < side_m <= 100:
        raise InvalidSettings(f"wall_size_m={side_m}: metres between 0 and 100 are expected")
    wall = replace(scan.transient.wall, width_m=float(side_m), height_m=float(side_m))
    return replace(scan, transient=replace(scan.transient, wall=wall))


def cut_direct(transient: "Transient", bins: int) -> "Transient":
    """The same transient with its first `bins` set to zero."""
    return replace(transient, counts=without_first(transient.counts, bins))


def without_first(counts: npt.NDArray[Any], bins: int) -> npt.NDArray[Any]:
    """A copy of counts (T, ...) with the first `bins` set to zero."""
    cut = counts.copy()
    cut[:bins] = 0
    return cut


def reconstruct_scan(
    scan: LoadedScan,
    method: str,
    settings: Mapping[str, object],
    *,
    use_file_offsets: bool = False,
    constants: Path | None = None,
    device: str = "cpu",
) -> "Reconstruction":
    """A scan calibrated and reconstructed; the falloff that its file states is used unless the settings say another."""
    from nlos.recon.methods import find
    from nlos.recon.reconstruct import reconstruct

    chosen = dict(settings)
    if scan.falloff is not None and "falloff" in find(method).Settings.model_fields:
        chosen.setdefault("falloff", scan.falloff)
    transient = calibrate_scan(scan, use_file_offsets, constants_for(scan, constants))
    return reconstruct(transient, method, chosen, device)


def reconstruct_file(
    run: Path,
    method: str,
    settings: dict[str, object],
    folder: Path,
    *,
    constants: Path | None = None,
    device: str = "cpu",
    html: bool = False,
    volume: bool = True,
    overwrite: bool = False,
) -> "Reconstruction":
    """One file to one folder of results. `settings` are the method's, except `offsets=file` and `wall_size_m`."""
    from nlos.recon.results import NAMES, write_results

    for name in (*NAMES, "view3d.html") if html else NAMES:
        if (folder / name).exists() and not overwrite:
            raise FileExistsError(f"{folder / name}: exists. Choose another folder with -o, or say --overwrite.")
    scan = load_scan(run)
    chosen = dict(settings)
    offsets = chosen.pop("offsets", None)
    if offsets not in (None, "file"):
        raise InvalidSettings(f"offsets={offsets}: only `offsets=file` is known")
    if (side_m := chosen.pop("wall_size_m", None)) is not None:
        scan = on_wall(scan, side_m)
    elif not scan.wall_known:
        log.warning("%s: the wall's size is not stored; assuming 1 m. Say --set wall_size_m=METRES.", run)
    result = reconstruct_scan(
        scan, method, chosen, use_file_offsets=offsets == "file", constants=constants, device=device
    )
    write_results(folder, result, overwrite=overwrite, keep_volume=volume, html=html)
    return result
