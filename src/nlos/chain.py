"""From a file to a picture: read, calibrate, reconstruct, write. What `scan --reconstruct` and `reconstruct` share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.acquisition.recording.recording import Recording
    from nlos.acquisition.transient import Transient
    from nlos.calibration.constants import BenchConstants
    from nlos.calibration.correct import Report
    from nlos.calibration.raw_points import RawPoints
    from nlos.recon.volume import Reconstruction


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
    from nlos.acquisition.importers.formats import is_recording
    from nlos.acquisition.importers.isolated import read_isolated
    from nlos.acquisition.recording.recording import Recording

    if is_recording(path):
        with Recording.open(path) as recording:
            return _load_recording(recording) if recording.on_grid else _load_free(recording)
    scan = read_isolated(path)
    for note in scan.notes:
        terminal.log(f"{path}: {note}", 1)
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
                f"({transient.counts[bin_, row, col]:g}). Mend or leave out that point (exposure 0)."
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
    terminal.log(f"constants: {path}, measured {constants.measured_utc}")
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

        done = correct_points(scan.points, constants)
        _log_calibration(done.report())
        return grid_samples(scan.points.x_m, scan.points.y_m, done.counts, done.exposure_s, transient.wall, done.time)
    if scan.rectified and scan.direct_cut_bins is not None:
        return cut_direct(transient, scan.direct_cut_bins)
    if scan.rectified:
        return correct(transient, rectified=True).transient
    if use_file_offsets:
        if scan.offset_bins is None:
            raise UsageError("offsets=file: the file has no time_offset_bins")
        return correct(transient, offset_bins=scan.offset_bins).transient
    corrected = correct(transient, constants, sync_count=scan.sync_count, total_count=scan.total_count)
    _log_calibration(corrected.report())
    return corrected.transient


def _log_calibration(report: "Report") -> None:
    rms_bins, points = report["offset_rms_bins"], report["points"]
    assert isinstance(points, int)
    if not isinstance(rms_bins, float):
        if points >= 9:
            terminal.log(
                f"calibrated: no plane wall explains the arrivals at {points} points; each was aligned by its own"
            )
        return
    terminal.log(
        f"calibrated: offsets to {report['offset_rms_ps']:.1f} ps RMS of the wall fit, "
        f"direct light masked up to {report['direct_masked_ns']:.2f} ns"
    )
    if rms_bins > 1:
        terminal.log(
            f"warning: arrivals scatter by {rms_bins:.1f} bins about a plane wall. Is this a raw scan, does its time "
            "window hold the direct light, is the wall plane? `nlos calibrate` draws them."
        )


def on_wall(scan: LoadedScan, side_m: object) -> LoadedScan:
    """The same scan on a square wall, for files that do not store its size. Raises `UsageError`."""
    if not isinstance(side_m, int | float) or not 0 < side_m <= 100:
        raise UsageError(f"wall_size_m={side_m}: metres between 0 and 100 are expected")
    wall = replace(scan.transient.wall, width_m=float(side_m), height_m=float(side_m))
    return replace(scan, transient=replace(scan.transient, wall=wall))


def cut_direct(transient: "Transient", bins: int) -> "Transient":
    """The same transient with its first `bins` set to zero."""
    counts = transient.counts.copy()
    counts[:bins] = 0
    return replace(transient, counts=counts)


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
    from nlos.recon.methods import find
    from nlos.recon.reconstruct import reconstruct
    from nlos.recon.results import NAMES, write_results

    for name in (*NAMES, "view3d.html") if html else NAMES:
        if (folder / name).exists() and not overwrite:
            raise FileExistsError(f"{folder / name}: exists. Choose another folder with -o, or say --overwrite.")
    scan = load_scan(run)
    chosen = dict(settings)
    offsets = chosen.pop("offsets", None)
    if offsets not in (None, "file"):
        raise UsageError(f"offsets={offsets}: only `offsets=file` is known")
    if (side_m := chosen.pop("wall_size_m", None)) is not None:
        scan = on_wall(scan, side_m)
    elif not scan.wall_known:
        terminal.log(f"warning: {run}: the wall's size is not stored; 1 m stands in. Say --set wall_size_m=METRES.")
    transient = calibrate_scan(scan, offsets == "file", constants_for(scan, constants))
    if scan.falloff is not None and "falloff" in find(method).Settings.model_fields:  # a learned method has none
        chosen.setdefault("falloff", scan.falloff)
    result = reconstruct(transient, method, chosen, device)
    write_results(folder, result, overwrite=overwrite, keep_volume=volume, html=html)
    return result


def parse_settings(pairs: Sequence[str]) -> dict[str, object]:
    """`key=value` words as settings: numbers, true/false, or text. Raises `UsageError`."""
    chosen: dict[str, object] = {}
    for pair in pairs:
        key, equals, text = pair.partition("=")
        if not equals or not key:
            raise UsageError(f"--set {pair}: must be key=value")
        if key in chosen:
            raise UsageError(f"--set {key}: given twice")
        chosen[key] = _value(text)
    return chosen


def _value(text: str) -> object:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return {"true": True, "false": False}.get(text.lower(), text)
