"""Pictures say what they show: faint depths fade, speckle does not stretch colours, small print is true."""

import re
import shutil
import subprocess
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from PIL import Image

from nlos.__main__ import run
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.errors import InvalidData
from nlos.recon.explained_share import Explained
from nlos.recon.gallery import difference_figure, gallery
from nlos.recon.pictures import UNSEEN, albedo_picture, depth_picture, summary_figure
from nlos.recon.reconstruct import reconstruct
from nlos.recon.results import write_results
from nlos.recon.seen import FAINT, FULL, depth_limits, depth_opacity, depth_span, visible_depth
from nlos.recon.small_print import below, si, small_print
from nlos.recon.uncertainty_picture import uncertainty_picture
from nlos.recon.volume import Intervals, Reconstruction

WALL = WallGrid(1.0, 1.0, 32, 32)


def made() -> Reconstruction:
    """A bright square at 0.8 m to 0.9 m, a faint one at 0.85 m, and speckle as faint at all depths."""
    albedo = np.zeros((32, 32), dtype=np.float32)
    depth_m = np.full((32, 32), np.nan, dtype=np.float32)
    albedo[4:16, 4:16], depth_m[4:16, 4:16] = 1.0, np.linspace(0.8, 0.9, 12)
    albedo[20:24, 4:8], depth_m[20:24, 4:8] = 0.05, 0.85
    speckle = np.random.default_rng(0).uniform(0.1, 3.0, 40)
    albedo[26:30, 10:20], depth_m[26:30, 10:20] = 0.03, speckle.reshape(4, 10)
    albedo[30, 30], depth_m[30, 30] = FAINT / 2, 0.85
    return Reconstruction(albedo, depth_m, WALL, "lct", 0.5)


def test_the_faint_fades_and_what_is_not_seen_has_no_colour() -> None:
    opacity = depth_opacity(made())
    assert (opacity[4:16, 4:16] == 1).all()
    assert 0.1 < opacity[20, 4] < 0.3
    assert opacity[26, 10] < opacity[20, 4]
    assert opacity[30, 30] == opacity[0, 0] == 0
    assert np.array_equal(opacity > 0, np.isfinite(visible_depth(made())))


def test_faint_speckle_does_not_stretch_the_colours() -> None:
    low, high = depth_limits([made()])
    assert 0.75 < low < 0.8 < 0.9 < high < 0.95
    nothing = replace(made(), depth_m=np.full((32, 32), np.nan, dtype=np.float32))
    assert depth_limits([nothing]) == pytest.approx((0.0, 1.028))
    assert depth_span([nothing]) is None
    assert depth_limits([made(), replace(made(), depth_m=made().depth_m + 1)])[1] == pytest.approx(1.95, abs=0.1)


def test_hatches_are_explained_where_there_are_any() -> None:
    sure = np.where(made().albedo > 0, 0.9, 0.0).astype(np.float32)
    doubted = sure.copy()
    doubted[20:24, 4:8] = 0.2
    for seen, explained in ((sure, False), (doubted, True)):
        told = replace(made(), intervals=Intervals(*(made().albedo,) * 2, *(made().depth_m,) * 2, seen))
        labels = [axes.get_ylabel() for axes in summary_figure(told).axes]
        assert any("hatched: likely no surface" in label for label in labels) is explained


@pytest.mark.parametrize("shape", [(1, 32), (32, 1), (2, 5), (1, 1)])
def test_a_line_of_points_and_one_alone_are_drawn(shape: tuple[int, int], tmp_path: Path) -> None:
    bright, deep = np.ones(shape, dtype=np.float32), np.full(shape, 0.5, dtype=np.float32)
    seen = np.full(shape, 0.9, dtype=np.float32)
    seen[0, 0] = 0.2
    wall = WallGrid(shape[1] / 32, shape[0] / 32, *shape)
    line = Reconstruction(
        bright, deep, wall, "nano", 0.1, intervals=Intervals(0 * bright, bright, 0.9 * deep, deep, seen)
    )
    labels = [axes.get_ylabel() for axes in summary_figure(line).axes]
    assert any("hatched: likely no surface" in label for label in labels)
    for draw in (albedo_picture, depth_picture, uncertainty_picture):
        draw(line, tmp_path / "line.png")


def test_a_picture_in_which_nothing_is_seen_says_so() -> None:
    black = replace(made(), albedo=0 * made().albedo, explained=Explained(0.85, 0.02))
    assert summary_figure(black).get_suptitle() == UNSEEN
    assert summary_figure(made()).get_suptitle() == ""


@pytest.mark.parametrize("brightness", [0.03, 0.2, 0.8])
def test_hatches_are_seen_and_what_they_lie_on_is_seen_through_them(tmp_path: Path, brightness: float) -> None:
    """Both of what is dark and of what is bright, and in grey alone."""
    albedo = np.full((32, 32), brightness, dtype=np.float32)
    albedo[0, :] = 1.0
    drawn = []
    for name, seen in (("sure", 0.9), ("doubted", 0.2)):
        held = Intervals(albedo, albedo, *(made().depth_m,) * 2, np.full_like(albedo, seen))
        albedo_picture(replace(made(), albedo=albedo, intervals=held), tmp_path / f"{name}.png")
        with Image.open(tmp_path / f"{name}.png") as image:
            drawn.append(np.asarray(image.convert("RGB"), dtype=float)[250:500, 250:450])  # within the wall
    off = np.abs(drawn[1] - drawn[0])
    assert 30 < off.max() < 120
    assert off.mean() < 30
    assert np.ptp(drawn[1], axis=-1).max() == 0


def test_a_depth_picture_is_grey_beside_the_scene(tmp_path: Path) -> None:
    depth_picture(made(), tmp_path / "depth.png")
    pixels = np.asarray(Image.open(tmp_path / "depth.png").convert("RGB")).astype(int)
    grey = (np.ptp(pixels, axis=2) == 0) & (pixels[..., 0] == round(0.88 * 255))
    assert grey.mean() > 0.2


def test_what_is_near_is_told_from_nothing_by_who_sees_no_colours(tmp_path: Path) -> None:
    """The near end of the colours is as light as the background: a line is where it ends."""
    albedo = np.zeros((32, 32), dtype=np.float32)
    depth_m = np.full((32, 32), np.nan, dtype=np.float32)
    albedo[8:14, 8:24], depth_m[8:14, 8:24] = 1.0, 0.5
    albedo[20:26, 8:24], depth_m[20:26, 8:24] = 1.0, 0.9
    two = replace(made(), albedo=albedo, depth_m=depth_m)
    depth_picture(two, tmp_path / "depth.png")
    with Image.open(tmp_path / "depth.png") as image:
        across = np.asarray(image.convert("L"), dtype=float)[254, 110:670]  # through the near one, within the wall
    assert sorted(set(np.flatnonzero(across < 150) // 140)) == [0, 3]  # its left and its right end
    figure = gallery([two], ["near"], 89)
    assert len(figure.axes[1].patches) == 1


def test_the_sign_of_a_difference_is_seen_without_colours() -> None:
    less = replace(made(), albedo=np.where(made().albedo == 1, np.float32(0.5), made().albedo))
    less.albedo[0], less.depth_m[4:16, 4:16] = 1.0, made().depth_m[4:16, 4:16] + np.float32(0.05)
    drawn = []
    for one, other in ((made(), less), (less, made())):
        figure = difference_figure(one, other, ("a", "b"))
        page = BytesIO()
        figure.savefig(page, dpi=100)
        drawn.append(np.asarray(Image.open(page).convert("L"), dtype=float))
        assert all("hatched: below zero" in bar.get_ylabel() for bar in figure.axes[2:])
    middle = drawn[0].shape[1] // 2
    for part in (np.s_[:, 60:300], np.s_[:, middle : middle + 300]):  # within the pictures, not their bars
        assert (np.abs(drawn[0] - drawn[1])[part] > 60).sum() > 300


def test_the_small_print_counts_points_and_photons() -> None:
    counts = np.zeros((64, 32, 32), dtype=np.float32)
    counts[40, ::2] = 3
    exposure_s = np.zeros((32, 32))
    exposure_s[::2] = 1.0
    result = reconstruct(Transient(counts, exposure_s, WALL, TimeAxis(64, 64e-12)), "lct")
    assert (result.points, result.photons) == (512, 1536.0)
    text = small_print(replace(result, scan="run.h5"))
    assert text.startswith("run.h5 · LCT · 512 points · 1.54 k indirect photons")
    assert [si(number) for number in (12, 3_260_000, 2e9)] == ["12 ", "3.26 M ", "2 G "]
    assert FAINT < FULL


@pytest.mark.skipif(shutil.which("pdfinfo") is None, reason="poppler's tools are not installed")
@pytest.mark.parametrize("width_mm", [89.0, 178.0])
def test_another_reader_finds_the_width_and_the_fonts_of_a_pdf(tmp_path: Path, width_mm: float) -> None:
    write_results(tmp_path / "a", made())
    figure = str(tmp_path / "f.pdf")
    assert run(["figure", str(tmp_path / "a"), "-o", figure, "--width-mm", str(width_mm)]) == 0
    about, fonts = (subprocess.run([tool, figure], capture_output=True, text=True, check=True, timeout=240).stdout
                    for tool in ("pdfinfo", "pdffonts"))  # fmt: skip
    size = re.search(r"Page size:\s+([\d.]+) x ([\d.]+) pts", about)
    assert size is not None
    assert float(size[1]) / 72 * 25.4 == pytest.approx(width_mm, abs=0.1)
    assert re.search(r"Pages:\s+1\b", about)
    listed = [line.split() for line in fonts.splitlines()[2:]]
    assert listed
    assert all(words[-5] == "yes" for words in listed), fonts  # "emb": embedded
    assert "Type 3" not in fonts  # which journals refuse


@pytest.mark.sampled(3)
@pytest.mark.parametrize("suffix", ["pdf", "svg", "png"])
def test_a_gallery_is_as_wide_as_a_journal_asks(tmp_path: Path, suffix: str) -> None:
    for name in ("a", "b"):
        write_results(tmp_path / name, made())
    assert run(["figure", str(tmp_path / "a"), str(tmp_path / "b"), "-o", str(tmp_path / f"f.{suffix}")]) == 0
    data = (tmp_path / f"f.{suffix}").read_bytes()
    if suffix == "png":
        assert Image.open(tmp_path / "f.png").size[0] == pytest.approx(178 / 25.4 * 300, abs=2)
    elif suffix == "svg":
        drawing = ElementTree.fromstring(data)
        assert [float(drawing.attrib[side].removesuffix("pt")) / 72 * 25.4 for side in ("width",)] == [
            pytest.approx(178, abs=0.1)
        ]
        assert not list(drawing.iter("{http://www.w3.org/2000/svg}text"))  # letters are outlines: no font to miss
    else:
        assert data.startswith(b"%PDF")
    assert run(["figure", str(tmp_path / "a"), "-o", str(tmp_path / f"f.{suffix}")]) == 6
    assert run(["figure", str(tmp_path / "a"), "-o", str(tmp_path / "f.xyz")]) == 2
    assert run(["figure", str(tmp_path / "a"), "-o", str(tmp_path / "g.pdf"), "--titles", "x,y"]) == 2


def test_pictures_of_one_wall_on_two_grids_are_compared_on_the_finer() -> None:
    coarse = np.arange(1.0, 65.0).reshape(8, 8).astype(np.float32)
    wall, finer = WallGrid(1.0, 1.0, 8, 8), WallGrid(1.0, 1.0, 16, 16)
    one = Reconstruction(coarse, np.full((8, 8), 0.5, np.float32), wall, "lct", 0.1)
    twice = np.kron(coarse, np.ones((2, 2))).astype(np.float32)
    other = Reconstruction(twice, np.full((16, 16), 0.52, np.float32), finer, "lct", 0.1)
    bright, deep_mm = (panel.images[0].get_array() for panel in difference_figure(one, other, ("a", "b")).axes[:2])
    assert bright is not None
    assert deep_mm is not None
    assert bright.shape == (16, 16)
    assert np.allclose(bright, 0, atol=2e-3)  # each over its own brightest part
    assert np.allclose(deep_mm.compressed(), -20)
    wide = replace(other, wall=WallGrid(2.0, 1.0, 16, 16))
    with pytest.raises(InvalidData, match="walls of different sizes"):
        difference_figure(one, wide, ("a", "b"))


def test_names_over_pictures_are_no_mathematics() -> None:
    name = r"$\cost$"
    gallery([made()], [name])  # draws, to know how high it is
    difference_figure(made(), made(), (name, name)).draw_without_rendering()


def boxes(figure: Figure) -> dict[str, Bbox]:
    """Title of a panel, or label of its colour bar -> where it is drawn, in dots."""
    figure.draw_without_rendering()
    return {axes.get_title() or axes.get_ylabel(): axes.get_window_extent() for axes in figure.axes}


@pytest.mark.parametrize("size_m", [(2.0, 0.5), (0.5, 2.0)])
def test_beside_a_wall_that_is_no_square_colour_bars_are_no_taller_than_it_and_no_title_runs_into_them(
    size_m: tuple[float, float],
) -> None:
    result = replace(made(), wall=WallGrid(*size_m, 32, 32))
    figure = summary_figure(result)
    drawn = boxes(figure)
    panels = [box for name, box in drawn.items() if name.startswith("LCT")]
    bars = [box for name, box in drawn.items() if not name.startswith("LCT")]
    assert len(panels) == len(bars) == 2
    for panel, bar in zip(panels, bars, strict=True):
        assert bar.height <= panel.height
        assert panel.y0 <= bar.y0 < bar.y1 <= panel.y1  # titles stand above
        assert panel.x1 < bar.x0


@pytest.mark.parametrize(
    "scan", ["run.h5", "a measurement of a rather long name on monday.h5", "x" * 300, r"$\cost$.h5"]
)
def test_the_small_print_is_whole_however_long(scan: str) -> None:
    figure = Figure(figsize=(5.6, 4.9), layout="constrained")
    result = replace(made(), scan=scan, points=4096, photons=2.01e6, explained=Explained(0.946, 0.002, ""))
    below(figure, small_print(result), 6.5)
    figure.draw_without_rendering()
    (print_,) = figure.texts or [figure._supxlabel]  # type: ignore[attr-defined]
    box = print_.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.x1
    assert box.y0 >= 0
    told = print_.get_text()
    assert "".join(told.split("\n")).replace(" · ", "") == small_print(result).replace(" · ", "")


@pytest.mark.filterwarnings("error")
def test_names_in_letters_that_the_font_lacks_are_still_told_apart(tmp_path: Path) -> None:
    one, other = (replace(made(), scan=f"{name}.h5") for name in ("\u6d4b\u8bd5", "\u6837\u54c1 \U0001f3a9"))
    titles = [panel.get_title() for panel in gallery([one, other], [one.scan, other.scan]).axes]
    assert "\\u6d4b\\u8bd5.h5" in titles
    assert "\\u6837\\u54c1 \\U0001f3a9.h5" in titles
    assert difference_figure(one, other, (one.scan, other.scan)).axes[0].get_title().isascii()
    assert below_of(one).startswith("\\u6d4b\\u8bd5.h5")
    albedo_picture(other, tmp_path / "picture.png")


def below_of(result: Reconstruction) -> str:
    return str(summary_figure(result).get_supxlabel())
