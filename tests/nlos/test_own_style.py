"""What a `matplotlibrc` or a program says of other figures changes no picture of ours, and is as it was afterwards."""

import os
import subprocess
import sys
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

import nlos
from nlos.recon.own_style import own_style

THEIRS = {"image.origin": "lower", "image.aspect": "auto", "text.usetex": True, "axes.grid": True, "font.size": 30.0}


@pytest.fixture(scope="module")
def picture() -> nlos.Picture:
    counts = np.zeros((12, 12, 96))
    counts[2:4, 2:4, 40] = 50.0
    return nlos.reconstruct(counts + 0.1, wall=1.0, bin_width=96e-12)


def _saved(picture: nlos.Picture, folder: Path) -> dict[str, bytes]:
    picture.save(folder)
    return {path.name: path.read_bytes() for path in folder.glob("*.png")}


def test_pictures_are_the_same_in_the_style_of_another_program(picture: nlos.Picture, tmp_path: Path) -> None:
    ours, shown = _saved(picture, tmp_path / "ours"), picture._repr_png_()
    with matplotlib.rc_context(THEIRS):  # rows from the bottom, and LaTeX that may not be there
        before = dict(matplotlib.rcParams)
        assert _saved(picture, tmp_path / "theirs") == ours
        assert picture._repr_png_() == shown
        assert dict(matplotlib.rcParams) == before


def test_what_another_thread_sets_while_a_picture_is_drawn_stays() -> None:
    with matplotlib.rc_context(THEIRS):
        with own_style():
            assert matplotlib.rcParams["font.size"] == matplotlib.rcParamsDefault["font.size"]
            matplotlib.rcParams.update({"lines.linewidth": 7.0, "font.size": 20.0})
        assert matplotlib.rcParams["lines.linewidth"] == 7.0
        assert matplotlib.rcParams["font.size"] == 20.0
        assert matplotlib.rcParams["image.origin"] == "lower"


def test_no_other_thread_sees_a_change_where_nothing_was_set(monkeypatch: pytest.MonkeyPatch) -> None:
    default = {name: value for name, value in matplotlib.rcParamsDefault.items() if name != "backend"}
    with matplotlib.rc_context(default):
        monkeypatch.setattr(matplotlib.RcParams, "__setitem__", lambda *what: pytest.fail(f"{what[1:]} was set"))
        with own_style():
            pass
        monkeypatch.undo()


def test_a_picture_that_is_shown_is_readable_in_the_style_of_another_program(
    picture: nlos.Picture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plt, "show", lambda: None)
    with plt.style.context("dark_background"):
        picture.show()
        figure = plt.gcf()
        shades = {label.get_color() for axes in figure.axes for label in axes.get_xticklabels()}
    assert figure.get_facecolor() == (1.0, 1.0, 1.0, 1.0)
    assert shades == {"black"}
    plt.close(figure)


def test_a_matplotlibrc_neither_turns_pictures_nor_ends_the_command(tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_text("".join(f"{name}: {value}\n" for name, value in THEIRS.items()))
    np.savez(tmp_path / "scan.npz", histograms=np.full((8, 8, 64), 0.5), bin_width_s=96e-12, wall_size_m=1.0)
    words = [sys.executable, "-m", "nlos", "reconstruct", "scan.npz", "-o", "out"]
    environment = {**os.environ, "MATPLOTLIBRC": str(tmp_path)}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "albedo.png").exists()


def test_every_drawing_is_in_our_own_style() -> None:
    """Whoever makes a figure says so."""
    rooms = Path(__file__).parents[2]
    for path in (*(rooms / "recon").rglob("*.py"), *(rooms / "src" / "nlos" / "report").rglob("*.py")):
        text = path.read_text(encoding="utf-8")
        if " Figure(" in text or "savefig(" in text:
            assert "own_style()" in text, path


def test_a_backend_that_the_program_chose_stays() -> None:
    name = matplotlib.get_backend()
    with own_style():
        assert matplotlib.get_backend() == name
    assert matplotlib.get_backend() == name
