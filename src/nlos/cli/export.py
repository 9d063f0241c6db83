"""`nlos export`: a recording or a reconstruction in other people's formats."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.matlab import write_matlab
from nlos.acquisition.exporters.npz import write_npz
from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import ScanArrays, Scanner, arrays_of_import, arrays_of_recording
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.importers.isolated import check_isolated, read_isolated
from nlos.acquisition.importers.magic import is_recording
from nlos.acquisition.importers.unchanged import unchanged
from nlos.acquisition.recording.frames import ended_plan
from nlos.acquisition.recording.read_by_child import open_checked
from nlos.calibration.errors import InvalidData as InvalidCalibration
from nlos.cli.contradictions import refuse_without
from nlos.cli.exit_codes import UsageError
from nlos.cli.film import frames_counted
from nlos.cli.targets import check_place, refuse_folder, refuse_own_input
from nlos.cli.terminal import terminal
from nlos.recipe import Recipe
from nlos.recon.export_mesh import write_glb, write_obj
from nlos.recon.export_ply import write_ply
from nlos.recon.export_vti import write_vti
from nlos.recon.methods import find
from nlos.recon.results import read_reconstruction
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.film import Film

SCAN_FORMATS = {"npz": ".npz", "mat": ".mat", "ytal": ".hdf5", "ptu": ".ptu"}
HELD = "Of scans mat, npz, ytal, ptu; of pictures ply, obj, glb, vti; of films gif, mp4."
FILM_FORMATS = {"gif": ".gif", "mp4": ".mp4"}
PICTURE_FORMATS = {"ply": ".ply", "obj": ".obj", "glb": ".glb", "vti": ".vti"}


def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="A recording, or a reconstruction.h5 for pictures.")],
    to: Annotated[str, typer.Option("--to", metavar="FORMAT,...", help=HELD)],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help="Output file, for a single format.")
    ] = None,
    method: Annotated[
        str | None, typer.Option(help="Of a film: by which method its frames are seen. Default: lct.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Writes other people's formats; says what each cannot hold."""
    words = [word.strip() for word in to.split(",") if word.strip()]
    known = SCAN_FORMATS | PICTURE_FORMATS | FILM_FORMATS
    unknown = [word for word in words if word not in known]
    if not words:
        raise UsageError(f"--to: name one format, or several with commas between them: {', '.join(known)}")
    if unknown:
        raise UsageError(f"--to {to}: {', '.join(unknown)} is not known; known: {', '.join(known)}")
    if output is not None and len(words) > 1:
        raise UsageError("-o names one file; with several formats leave it out")
    refuse_without(
        "--method", method is not None and not set(words) & set(FILM_FORMATS), "--to gif or mp4",
        "only films are reconstructed to be exported",
    )  # fmt: skip
    refuse_folder(run)
    targets = {word: output or run.with_suffix(known[word]) for word in words}
    for target in targets.values():
        refuse_own_input(target, [run], "the file that is exported")
        check_place(target, overwrite)
    left_behind = {}
    with ExitStack() as together:  # a format that cannot be written leaves none of the others either
        partials = {
            word: together.enter_context(whole_file(target, new=not overwrite)) for word, target in targets.items()
        }
        together.enter_context(unchanged(run, grows=True))  # nor do formats that are not of one scan
        film = _film(run, method or "lct", words) if set(words) & set(FILM_FORMATS) else None
        for word, target in targets.items():
            partial = partials[word]
            if word in FILM_FORMATS:
                assert film is not None
                left_behind[word] = _write_film(film, word, partial)
            elif word in SCAN_FORMATS:
                left_behind[word] = _write_scan(run, word, partial, target)
            else:
                left_behind[word] = _write_picture(run, word, partial)
    for word, target in targets.items():
        terminal.result(f"{target}: written as {word}")
        for note in left_behind[word]:
            terminal.log(f"  {note}")
    terminal.document["exported"] = [
        {"format": word, "file": str(target), "left_behind": left_behind[word]} for word, target in targets.items()
    ]


def _write_scan(run: Path, word: str, partial: Path, target: Path) -> list[str]:
    frames = 1
    if is_recording(run):
        with open_checked(run) as recording:
            arrays = arrays_of_recording(recording)
            frames = ended_plan(recording.plan, recording.intact_records()).frames
    else:
        try:
            arrays = arrays_of_import(read_isolated(run), run)
        except InvalidData as error:
            if not _is_reconstruction(run):
                raise
            raise InvalidData(
                f"{run}: is a reconstruction, and {word} is a format of scans. A picture becomes "
                f"{', '.join(PICTURE_FORMATS)}; MATLAB and NumPy open this file as it is: "
                f"h5read('{run.name}', '/albedo').', h5py.File('{run.name}')['albedo']."
            ) from error
    if not (arrays.exposure_s > 0).any():
        raise InvalidData(f"{run}: no point of it was measured; there is nothing to export")
    if word == "ytal" and not arrays.rectified:
        arrays = _with_scanner(run, arrays)
    write = {"npz": write_npz, "mat": write_matlab, "ytal": write_ytal, "ptu": write_ptu}[word]
    try:
        left_behind = write(arrays, partial)
    except InvalidData as error:
        raise InvalidData(str(error).replace(str(partial), str(target))) from error
    if frames > 1:
        left_behind = [*left_behind, f"the {frames} frames, which are added up: `nlos reconstruct --frame` takes one"]
    if arrays.left_aside:
        left_behind = [*left_behind, f"{arrays.left_aside} samples that are damaged or unreadable"]
    return left_behind


def _is_reconstruction(path: Path) -> bool:
    try:
        check_isolated(path, "nlos.recon.results:read_reconstruction")
    except InvalidData:
        return False
    return True


def _with_scanner(run: Path, arrays: ScanArrays) -> ScanArrays:
    """The arrays with the scanner's place, and on the wall, that the times of direct light tell; as they are where
    those tell nothing."""
    from nlos.chain import arrivals_of
    from nlos.loaded import load_scan

    loaded = load_scan(run)
    try:
        arrivals = arrivals_of(loaded)
    except InvalidCalibration:
        return arrays
    if arrivals is None or arrivals.wall is None:
        return arrays
    x_m, y_m, z_m = map(float, arrivals.wall.scanner_position_m)
    wall = loaded.transient.wall
    # Errors that points share, as that of where a pulse lies in its bin, are not in their scatter.
    bins = max(arrays.time.bin_width_s / max(arrivals.wall.rms_s, 1e-15), 1.0)
    x_error_m, y_error_m, z_error_m = map(float, bins * np.sqrt(np.diag(arrivals.wall.covariance)[:3]))
    scanner = Scanner((x_m, y_m, z_m), (x_error_m, y_error_m, z_error_m), arrivals.wall.delay_s)
    if not arrays.on_grid:
        return replace(arrays, scanner=scanner)
    return replace(arrays, wall=wall, x_m=wall.x_m(), y_m=wall.y_m(), scanner=scanner)


def _film(run: Path, method: str, words: list[str]) -> "Film":
    from nlos.film import ffmpeg, film_of

    find(method)  # before minutes of pictures
    if "mp4" in words:
        ffmpeg()
    with frames_counted(run) as counted:
        return film_of(run, Recipe(method), step=counted)


def _write_film(film: "Film", word: str, partial: Path) -> list[str]:
    from nlos.film import write_gif, write_mp4

    {"gif": write_gif, "mp4": write_mp4}[word](partial, film)
    return ["brightness only, on one scale: `nlos reconstruct --film` keeps depths and the table of places and speeds"]


def _write_picture(run: Path, word: str, partial: Path) -> list[str]:
    if is_recording(run):
        raise InvalidData(
            f"{run}: is a recording, and {word} is a format of pictures. Export the reconstruction.h5 that "
            f"`nlos reconstruct` makes of it; a recording becomes {', '.join((*SCAN_FORMATS, *FILM_FORMATS))}."
        )
    check_isolated(run, "nlos.recon.results:read_reconstruction")
    result = read_reconstruction(run)
    {"ply": write_ply, "obj": write_obj, "glb": write_glb, "vti": write_vti}[word](partial, result)
    return [] if word == "vti" else ["the front surface only: what lies behind it stays in the volume"]
