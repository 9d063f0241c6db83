"""Figures as PNG."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def write_png(figure: "Figure", to: Path | BinaryIO, dots_per_inch: int) -> None:
    """Writes a figure, which has that resolution from then on: the file that `savefig` writes, in three quarters of its
    time, as that goes through a figure once more to lay it out."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(dots_per_inch)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.print_png(to, metadata={"Software": "nlos"})
