"""`nlos reconstruct`: from recordings, or any file that an importer reads, to pictures."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.terminal import terminal


def reconstruct(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="Recordings, plain HDF5 or imported formats.")],
    method: Annotated[str, typer.Option(help="A word of `nlos methods`.")] = "lct",
    output: Annotated[Path, typer.Option("-o", "--output", metavar="DIR")] = Path("out"),
    settings: Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE")] = None,
    constants: Annotated[
        Path | None,
        typer.Option(metavar="CONSTANTS.h5", help="Default: the newest in constants/ that fits the scan's devices."),
    ] = None,
    device: Annotated[str, typer.Option(help="cpu or cuda.")] = "cpu",
    html: Annotated[bool, typer.Option("--html", help="Also a rotatable 3D view in one file.")] = False,
    volume: Annotated[bool, typer.Option("--volume/--no-volume", help="Keep the volume in the result.")] = True,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """From a recording, or any file that an importer reads, to a picture."""
    from nlos.chain import parse_settings, reconstruct_file

    chosen = parse_settings(settings or [])
    results = []
    for run in runs:
        folder = output / run.stem if len(runs) > 1 else output
        terminal.log(f"{run}: {method}")
        done = reconstruct_file(
            run, method, chosen, folder, constants=constants, device=device, html=html, volume=volume,
            overwrite=overwrite,
        )  # fmt: skip
        results.append({"run": str(run), "folder": str(folder), "seconds": done.seconds})
        terminal.result(f"{folder}: reconstruction.h5, albedo.png, depth.png ({method}, {done.seconds:.2f} s)")
    terminal.document["reconstructions"] = results
