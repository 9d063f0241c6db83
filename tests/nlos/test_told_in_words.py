"""What a report and a 3D view show is told to who cannot see it: figures, heads of tables, names of controls."""

import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from nlos.acquisition.wall import WallGrid
from nlos.recon.view3d import write_view3d
from nlos.recon.volume import Reconstruction, Volume
from nlos.report.in_words import in_words


def letter_in_the_middle() -> Reconstruction:
    """A square of 4 x 2 pixels, 0.5 m from a wall of 1 m."""
    wall, albedo = WallGrid(1.0, 1.0, 8, 8), np.zeros((8, 8), np.float32)
    albedo[2:6, 3:5] = 0.9
    albedo[3, 4] = 1.0
    depths_m = np.linspace(0.1, 1.0, 10)
    solid = np.zeros((10, 8, 8), np.float32)
    solid[4] = albedo
    volume = Volume(albedo=solid, depths_m=depths_m, wall=wall)
    depth_m = np.where(albedo > 0, np.float32(0.5), np.float32(np.nan))
    return Reconstruction(albedo=albedo, depth_m=depth_m, wall=wall, volume=volume, method="lct", seconds=0.0)


def test_a_picture_is_told_by_its_figures() -> None:
    assert in_words(letter_in_the_middle()) == (
        "surfaces between 0.50 and 0.50 m from the wall in 12 % of the picture, x -0.06 to 0.06 m, y -0.19 to 0.19 m; "
        "brightest at x 0.06 m, y 0.06 m"
    )


class Controls(HTMLParser):
    """Controls that nothing names."""

    def __init__(self) -> None:
        super().__init__()
        self.unnamed: list[str | None] = []
        self._labels = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        said = dict(attrs)
        self._labels += tag == "label"
        if tag in ("input", "select", "canvas") and not self._labels and not said.get("aria-label"):
            self.unnamed.append(said.get("id"))

    def handle_endtag(self, tag: str) -> None:
        self._labels -= tag == "label"


def test_every_control_of_the_3d_view_has_a_name_and_its_keys_are_told(tmp_path: Path) -> None:
    write_view3d(tmp_path / "view.html", letter_in_the_middle(), title='"><i>')
    html = (tmp_path / "view.html").read_text(encoding="utf-8")
    read = Controls()
    read.feed(html)
    assert read.unnamed == []
    assert "arrow keys to turn" in html
    assert "<i>" not in html


def test_a_reports_pictures_are_told_by_figures_and_its_tables_have_heads(
    small: Path, nlos: Callable[..., Any], tmp_path: Path
) -> None:
    assert nlos("scan", small.name, "-o", "run.h5").returncode == 0
    assert nlos("report", "run.h5", "--methods", "lct", "-o", "r.html").returncode == 0
    html = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert '<html lang="en">' in html
    told = re.findall(r'<img alt="([^"]*)"', html)
    assert re.search(r"front view and depth, looking towards the wall; (surfaces between \d|nothing is)", told[0])
    assert re.search(r"; [\d,]+ to [\d,]+ counts/s, most at x -?\d\.\d\d m, y -?\d\.\d\d m$", told[-1])
    assert len(re.findall(r"<th[ >]", html)) == len(re.findall(r"<th scope=", html))
    assert html.count("<th scope=") == html.count('<th scope="col"') + html.count("<th scope=row")
    assert 'title="3D view: run.h5, LCT"' in html
