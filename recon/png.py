"""Figures as PNG."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from nlos.recon.own_style import own_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@own_style()
def write_png(figure: "Figure", to: Path | BinaryIO, dots_per_inch: int) -> None:
    """Writes a figure, which has that resolution from then on: the file that `savefig` writes, in three quarters of its
    time, as that goes through a figure once more to lay it out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(dots_per_inch)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(to, metadata={"Software": "nlos"})


def is_own(path: Path) -> bool:
    """Whether a picture that `write_png` wrote is at `path`."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return b"tEXtSoftware\0nlos" in file.read(4096)


def refuse_to_replace_another(path: Path, overwrite: bool = False) -> None:
    """Raises `FileExistsError` where something other than a picture of this program's own is at `path`: such a one is
    drawn anew each time, without being asked. A folder is not replaced by an `overwrite` either."""
    if path.is_dir():
        raise FileExistsError(f"{path}: is a folder, where a picture would go. Rename it.")
    if os.path.lexists(path) and not overwrite and not is_own(path):
        raise FileExistsError(
            f"{path}: exists, and is none of this program's pictures, of which one would go there. Rename it, or use "
            "--overwrite."
        )
