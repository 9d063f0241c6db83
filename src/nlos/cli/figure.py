"""`nlos figure`: results side by side on one scale, at a journal's width."""

from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from nlos.acquisition.recording.no_such_file import meant_by
from nlos.cli.exit_codes import UsageError
from nlos.cli.targets import check_place
from nlos.cli.terminal import terminal
from nlos.recon.results import read_reconstruction
from nlos.whole_file import whole_file

if TYPE_CHECKING:
    from nlos.recon.volume import Reconstruction

KINDS = (".pdf", ".svg", ".png")
_FILE = "reconstruction.h5"


def figure(
    results: Annotated[list[Path], typer.Argument(metavar="DIR...", help="Folders that `nlos reconstruct` wrote.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="F.pdf", help="PDF, SVG or PNG.")] = Path(
        "figure.pdf"
    ),
    width_mm: Annotated[
        float, typer.Option(min=40, max=400, help="A column of many journals is 89 mm wide, a page 178.")
    ] = 178.0,
    titles: Annotated[
        str | None, typer.Option(help="One per result, separated by commas. Default: folder and method.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite")] = False,
) -> None:
    """Front views above depths, every result on the same scale."""
    from nlos.recon.gallery import gallery, save_gallery

    if output.suffix.lower() not in KINDS:
        raise UsageError(f"-o {output}: a figure is {', '.join(KINDS)}")
    check_place(output, overwrite)
    made = [read_reconstruction(_file_of(place)) for place in results]
    names = _named(results, made) if titles is None else [title.strip() for title in titles.split(",")]
    if len(names) != len(made):
        raise UsageError(f"--titles {titles}: {len(names)} titles for {len(made)} results")
    output.absolute().parent.mkdir(exist_ok=True)
    with whole_file(output, new=not overwrite) as partial:
        save_gallery(gallery(made, names, width_mm), partial, output.suffix[1:].lower())
    terminal.result(f"{output}: {len(made)} results, {width_mm:g} mm wide", figure=str(output))


def _file_of(place: Path) -> Path:
    """Of a result, its folder or the file itself. Raises `FileNotFoundError` with what may have been meant."""
    file = place / _FILE if place.is_dir() else place
    if file.exists():
        return file
    beside = {each.parent.name: each.parent for each in place.parent.glob(f"*/{_FILE}")}
    alike = get_close_matches(place.name, beside, n=1)
    meant = f"Did you mean {beside[alike[0]]}?" if alike else meant_by(place)
    why = f"holds no {_FILE}" if place.is_dir() else "no such file"
    raise FileNotFoundError(f"{place}: {why}. {meant or 'Make one with `nlos reconstruct`.'}")


def _named(results: list[Path], made: "list[Reconstruction]") -> list[str]:
    """The folder of each, and its method where the folder's name does not say it."""
    folders = [place.resolve() if place.is_dir() else place.resolve().parent for place in results]
    return [
        folder.name if one.method.lower() in folder.name.lower() else f"{folder.name}, {one.method.upper()}"
        for folder, one in zip(folders, made, strict=True)
    ]
