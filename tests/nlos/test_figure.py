"""`nlos figure`: results side by side, each by its name, on no more paper than they need."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from nlos.acquisition.wall import WallGrid
from nlos.cli.figure import figure
from nlos.recon.gallery import gallery, save_gallery
from nlos.recon.results import write_results
from nlos.recon.volume import Reconstruction


def picture(method: str, side_m: float = 1.0) -> Reconstruction:
    y, x = np.mgrid[:16, :16]
    albedo = np.exp(-((x - 10) ** 2 + (y - 5) ** 2) / 6).astype(np.float32)
    depth_m = np.full((16, 16), 0.7, np.float32)
    return Reconstruction(albedo, depth_m, WallGrid(side_m, side_m, 16, 16), method, 0.1, {}, None)


def drawn(figure: Figure) -> float:
    """The share of the figure's height that its contents span."""
    figure.draw_without_rendering()
    return float(figure.get_tightbbox().height / figure.get_size_inches()[1])


def test_no_paper_is_left_empty_and_the_width_is_the_journals() -> None:
    for count in (1, 2, 3, 8):
        figure = gallery([picture("lct")] * count, ["one"] * count, 89 if count < 3 else 178)
        assert drawn(figure) > 0.88
        above, below = (next(axes for axes in figure.axes if axes.images and bool(axes.get_title()) is top)
                        .get_position() for top in (True, False))  # fmt: skip
        assert 0 < above.y0 - below.y1 < 0.25 * above.height
        assert figure.get_size_inches()[0] == (89 if count < 3 else 178) / 25.4


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no full disk at hand")
@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_a_disk_that_is_full_is_no_error_of_the_figure(kind: str) -> None:
    with pytest.raises(OSError, match="No space left on device"):
        save_gallery(gallery([picture("lct")], ["one"], 89), Path("/dev/full"), kind)


def test_names_say_the_method_once(nlos, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    from nlos.cli.figure import _named

    for name, method in (("run7_lct", "lct"), ("statue", "nano")):
        write_results(tmp_path / name, picture(method))
    results = [tmp_path / "run7_lct", tmp_path / "statue" / "reconstruction.h5"]
    assert _named(results, [picture("lct"), picture("nano")]) == ["run7_lct", "statue, NANO"]
    done = nlos("figure", "run7_lct", "statue/reconstruction.h5", "-o", "f.png", "--width-mm", "89")
    assert done.returncode == 0, done.stderr
    with Image.open(tmp_path / "f.png") as image:
        assert image.width == round(89 / 25.4 * 300)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("statu", r"statu: no such file\. Did you mean \S*statue\?"),
        ("statue.h5", r"statue\.h5: no such file\. Did you mean \S*statue\?"),
        ("statue/reconstruction", r"Did you mean \S*statue/reconstruction\.h5\?"),
        ("empty", r"empty: holds no reconstruction\.h5\. Make one with `nlos reconstruct`"),
        ("nowhere/x", r"x: no such file\. Make one with `nlos reconstruct`"),
    ],
)
def test_a_result_that_is_not_there_is_told_with_the_one_that_may_have_been_meant(
    given: str, said: str, tmp_path: Path
) -> None:
    write_results(tmp_path / "statue", picture("nano"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match=said):
        figure([tmp_path / given], tmp_path / "f.png")
