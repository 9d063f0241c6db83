"""From a file to a picture: read, calibrate, reconstruct, write. What `scan --reconstruct` and `reconstruct` share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from nlos.exit_codes import UsageError
from nlos.terminal import terminal

if TYPE_CHECKING:
    from acquisition.recording import Recording
    from acquisition.sample import Sample
    from acquisition.transient import Transient
    from acquisition.wall import WallGrid
    from recon.volume import Reconstruction


@dataclass(frozen=True)
class LoadedScan:
    """A scan from any file, before calibration."""

    transient: "Transient"
    rectified: bool
    direct_cut_bins: int | None
    """The file's own cut; None where the direct light has to be found."""
    falloff: int | None
    offset_bins: npt.NDArray[np.float64] | None  # (H, W)
    """The file's own time offsets."""


def load_scan(path: Path) -> LoadedScan:
    """Reads our own recordings and every format that an importer knows. Raises `InvalidData`."""
    from acquisition.importers.formats import is_recording
    from acquisition.importers.isolated import read_isolated
    from acquisition.recording import Recording

    if is_recording(path):
        with Recording.open(path) as recording:
            return _load_recording(recording)
    scan = read_isolated(path)
    for note in scan.notes:
        terminal.log(f"{path}: {note}", 1)
    cut = scan.direct_cut_bins if scan.direct_cut_bins > 0 else None
    return LoadedScan(scan.transient, scan.rectified, cut, scan.falloff, scan.time_offset_bins)


def _load_recording(recording: "Recording") -> LoadedScan:
    """A recording of our own; one that was imported keeps what its source said."""
    from acquisition.importers.to_recording import said_by_source

    said = said_by_source(recording)
    cut, falloff, offsets = said.get("direct_cut_bins"), said.get("falloff"), said.get("time_offset_bins")
    return LoadedScan(
        recording.transient(),
        bool(said.get("rectified", False)),
        cut if isinstance(cut, int) and cut > 0 else None,
        falloff if isinstance(falloff, int) else None,
        np.asarray(offsets, dtype=np.float64) if isinstance(offsets, list) else None,
    )


def calibrate_scan(scan: LoadedScan, use_file_offsets: bool = False) -> "Transient":
    """The transient that the physics can use: time 0 at the direct arrival, direct light removed.

    A rectified file that states its cut gets that cut; one that states none is left as it is.
    """
    from calibration.correct import correct

    transient = scan.transient
    if scan.rectified:
        return cut_direct(transient, scan.direct_cut_bins or 0)
    if use_file_offsets:
        if scan.offset_bins is None:
            raise UsageError("offsets=file: the file has no time_offset_bins")
        return correct(transient, offset_bins=scan.offset_bins).transient
    corrected = correct(transient)
    report = corrected.report()
    if report["offset_rms_ps"] is not None:
        terminal.log(
            f"calibrated: offsets to {report['offset_rms_ps']:.1f} ps RMS of the wall fit, "
            f"direct light masked up to {report['direct_masked_ns']:.2f} ns"
        )
    return corrected.transient


def transient_of(samples: "Sequence[Sample]", wall: "WallGrid") -> "Transient":
    """Samples as a calibrated transient on the wall's grid; dead time is undone where laser pulses were counted."""
    from acquisition.transient import Transient
    from calibration import raw_points
    from calibration.correct import correct_points

    done = correct_points(raw_points.from_samples(samples))
    # One row of `done` for each place, in the order in which the places were first taken.
    places = list(dict.fromkeys((sample.point.row, sample.point.col) for sample in samples))
    row, col = (np.array(side) for side in zip(*places, strict=True))
    cube = np.zeros((done.time.bins, wall.rows, wall.cols), dtype=np.float32)
    cube[:, row, col] = done.counts.T
    exposure_s = np.zeros((wall.rows, wall.cols))
    exposure_s[row, col] = done.exposure_s
    return Transient(cube, exposure_s, wall, done.time)


def on_wall(scan: LoadedScan, side_m: object) -> LoadedScan:
    """The same scan on a square wall, for files that do not store its size. Raises `UsageError`."""
    if not isinstance(side_m, int | float) or not 0 < side_m <= 100:
        raise UsageError(f"wall_size_m={side_m}: metres between 0 and 100 are expected")
    wall = replace(scan.transient.wall, width_m=float(side_m), height_m=float(side_m))
    return replace(scan, transient=replace(scan.transient, wall=wall))


def cut_direct(transient: "Transient", bins: int) -> "Transient":
    """The same transient with its first `bins` set to zero."""
    if bins == 0:
        return transient
    counts = transient.counts.copy()
    counts[:bins] = 0
    return replace(transient, counts=counts)


def reconstruct_file(
    run: Path,
    method: str,
    settings: dict[str, object],
    folder: Path,
    *,
    device: str = "cpu",
    html: bool = False,
    volume: bool = True,
    overwrite: bool = False,
) -> "Reconstruction":
    """One file to one folder of results. `settings` are the method's, except `offsets=file` and `wall_size_m`."""
    from recon.reconstruct import reconstruct
    from recon.results import NAMES, write_results

    for name in NAMES:
        if (folder / name).exists() and not overwrite:
            raise FileExistsError(f"{folder / name}: exists. Choose another folder with -o, or say --overwrite.")
    scan = load_scan(run)
    chosen = dict(settings)
    offsets = chosen.pop("offsets", None)
    if offsets not in (None, "file"):
        raise UsageError(f"offsets={offsets}: only `offsets=file` is known")
    if (side_m := chosen.pop("wall_size_m", None)) is not None:
        scan = on_wall(scan, side_m)
    transient = calibrate_scan(scan, offsets == "file")
    if scan.falloff is not None:
        chosen.setdefault("falloff", scan.falloff)
    result = reconstruct(transient, method, chosen, device)
    write_results(folder, result, overwrite=overwrite, keep_volume=volume)
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
