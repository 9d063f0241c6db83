"""`nlos import`: other people's formats into a recording."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.terminal import terminal


def import_(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="MAT, PTU, PT3, HT3, T3R, PHD, HHD, HDF5, NPZ.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="RUN.h5", help="With several files: a folder.")],
    wall_size_m: Annotated[
        float | None, typer.Option(min=0.001, max=100.0, help="Side of the wall, for formats that do not store it.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Reads other people's formats into a recording; says what a format could not hold."""
    from nlos.acquisition.importers.isolated import IsolatedReader
    from nlos.acquisition.importers.to_recording import write_recording

    written = []
    with IsolatedReader() as reader:
        for file in files:
            target = output if len(files) == 1 else output / f"{file.stem}.h5"
            scan = reader.read(file)
            if wall_size_m is not None:
                scan = scan.on_wall(wall_size_m, wall_size_m)
            target.parent.mkdir(parents=True, exist_ok=True)
            points = write_recording(scan, file, target, overwrite=overwrite)
            photons = int(scan.transient.counts.sum(dtype="float64"))
            terminal.result(f"{target}: {points} points, {photons} photons ({scan.source_format})")
            for note in scan.notes:
                terminal.log(f"  {note}")
            written.append({"file": str(file), "recording": str(target), "points": points, "photons": photons,
                            "format": scan.source_format, "notes": list(scan.notes)})  # fmt: skip
    terminal.document["imported"] = written
