"""`nlos import`: other people's formats into a recording."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.acquisition.importers.imported import DOUBT
from nlos.acquisition.importers.isolated import one_reader
from nlos.acquisition.importers.magic import is_recording
from nlos.acquisition.importers.to_recording import write_recording
from nlos.acquisition.wall import ORIENTATION
from nlos.cli.exit_codes import UsageError
from nlos.cli.file_words import Axes, BinWidth, Detector, Rectified, WallSize, given
from nlos.cli.progress import Progress
from nlos.cli.targets import check_place, names_of, recording_target, refuse_own_input
from nlos.cli.terminal import terminal


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="MAT, NPZ, NPY; PTU, PHU, PT3, HT3, T3R, PHD, HHD; SDT; HDF5: plain, y-tal, Zaragoza, Photon-HDF5.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="RUN.h5", help="Output file; with several inputs, a folder.")
    ],
    wall_size_m: WallSize = None,
    bin_width_ps: BinWidth = None,
    axes: Axes = None,
    rectified: Rectified = None,
    detector: Detector = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Reads other people's formats into a recording; says what a format could not hold."""
    said = given(wall_size_m, bin_width_ps, axes, rectified, detector)
    targets = [output] if len(files) == 1 else [output / f"{name}.h5" for name in names_of(files, output)]
    for file, target in zip(files, targets, strict=True):
        recording_target(target)
        refuse_own_input(target, files, "a file that is imported")
        check_place(target, overwrite)
        if file.is_file() and is_recording(file):
            raise UsageError(f"{file}: is a recording already: every verb reads it as it is.")
    written = []
    with one_reader() as reader:
        for file, target in zip(files, targets, strict=True):
            scan = reader.read(file, said)
            target.parent.mkdir(parents=True, exist_ok=True)
            with Progress(int((scan.held.exposure_s > 0).sum()), what=f"import {file.name}") as progress:
                points = write_recording(scan, file, target, overwrite=overwrite, step=progress.step)
            photons = int(scan.held.counts.sum(dtype="float64"))
            terminal.result(f"{target}: {points} points, {photons} photons ({scan.source_format})")
            for note in (*scan.notes, ORIENTATION):
                terminal.log(f"  {'warning: ' if note.startswith(DOUBT) else ''}{note}")
            if not scan.wall_known:
                terminal.log("  `reconstruct` and `calibrate` find the wall by the direct times; or use --wall-size-m")
            written.append({"file": str(file), "recording": str(target), "points": points, "photons": photons,
                            "format": scan.source_format, "notes": list(scan.notes)})  # fmt: skip
    terminal.document["imported"] = written
