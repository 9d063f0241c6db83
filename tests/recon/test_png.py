"""PNGs are those of matplotlib's own `savefig`."""

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from nlos.recon.png import write_png


def drawn(layout: str) -> Figure:
    figure = Figure(figsize=(4.3, 2.9), layout=layout)
    left, right = figure.subplots(1, 2)
    shown = left.imshow(np.random.default_rng(0).random((5, 7)), extent=(-0.7, 0.7, -0.5, 0.5))
    left.set(title="front view", xlabel="x (m)", ylabel="y (m)")
    figure.colorbar(shown, ax=left, label="brightness (relative)")
    right.plot([1, 2000], [3e-7, 4], label="a curve")
    right.set_yscale("log")
    right.legend()
    figure.supxlabel("small print", fontsize=6.5)
    return figure


@pytest.mark.parametrize("layout", ["constrained", "tight", "none"])
@pytest.mark.parametrize("dots_per_inch", [80, 150])
def test_pixels_are_those_of_savefig(tmp_path: Path, layout: str, dots_per_inch: int) -> None:
    theirs = BytesIO()
    drawn(layout).savefig(theirs, format="png", dpi=dots_per_inch)
    write_png(drawn(layout), tmp_path / "ours.png", dots_per_inch)
    with Image.open(theirs) as expected, Image.open(tmp_path / "ours.png") as made:
        np.testing.assert_array_equal(np.asarray(made), np.asarray(expected))
        assert made.info["dpi"] == expected.info["dpi"]
        assert made.info["Software"] == "nlos"
