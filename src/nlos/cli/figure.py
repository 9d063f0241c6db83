"""`nlos figure`: results side by side on one scale, at a journal's width."""

from pathlib import Path
from typing import Annotated

import typer

from nlos.cli.exit_codes import UsageError
from nlos.cli.terminal import terminal
from nlos.recon.results import read_reconstruction
from nlos.whole_file import whole_file

KINDS = (".pdf", ".svg", ".png")


def figure(
    results: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders that `nlos reconstruct` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="F.pdf", help="PDF, SVG or PNG.")] = Path(
        "figure.pdf"
    ),
    width_mm: Annotated[
        float, typer.Option(min=40, max=400, help="A column of many journals is 89 mm wide, a page 178.")
    ] = 178.0,
    titles: Annotated[
        str | None, typer.Option(help="One per result, separated by commas. Default: scan and method.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Front views above depths, every result on the same scale."""
    from nlos.recon.gallery import gallery, save_gallery

    if output.suffix.lower() not in KINDS:
        raise UsageError(f"-o {output}: a figure is {', '.join(KINDS)}")
    if output.exists() and not overwrite:
        raise FileExistsError(f"{output}: exists. Choose another name with -o, or use --overwrite.")
    files = [place / "reconstruction.h5" if place.is_dir() else place for place in results]
    made = [read_reconstruction(file) for file in files]
    names = [f"{place.name}, {one.method.upper()}" for place, one in zip(results, made, strict=True)]
    if titles is not None:
        names = titles.split(",")
    if len(names) != len(made):
        raise UsageError(f"--titles {titles}: {len(names)} titles for {len(made)} results")
    with whole_file(output) as partial:
        save_gallery(gallery(made, names, width_mm), partial, output.suffix[1:].lower())
    terminal.result(f"{output}: {len(made)} results, {width_mm:g} mm wide", figure=str(output))
