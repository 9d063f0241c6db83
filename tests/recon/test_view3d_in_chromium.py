"""The 3D view as a browser draws it: of scenes of any size, by keys, and by two fingers."""

import re
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquisition.wall import WallGrid
from nlos.recon.view3d import write_view3d
from nlos.recon.volume import Reconstruction, Volume
from tests.chromium import needs_chromium

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
pytestmark = needs_chromium

WRITTEN = """() => { window.written = []; const pen = CanvasRenderingContext2D.prototype, put = pen.fillText;
  pen.fillText = function(...what) { written.push(what); put.apply(this, what); }; }"""
PIXELS = "document.getElementById('view').toDataURL()"


def made(size_m: float, points: int) -> Reconstruction:
    """A wall of 8 x 8 pixels with so many bright ones in a row, as deep as it is wide."""
    wall, depths_m = WallGrid(size_m, size_m, 8, 8), np.linspace(0.1, 1.0, 5) * size_m
    albedo = np.zeros((5, 8, 8), np.float32)
    albedo[3, 4, 2 : 2 + points] = 1.0
    front = albedo.max(axis=0)
    depth_m = np.where(front > 0, depths_m[3], np.nan).astype(np.float32)
    return Reconstruction(front, depth_m, wall, "lct", 0.1, volume=Volume(albedo, depths_m, wall))


@pytest.fixture
def shown(browser: Any, tmp_path: Path) -> Iterator[Callable[[Reconstruction], Any]]:
    context = browser.new_context(viewport={"width": 800, "height": 700}, has_touch=True)
    complaints: list[str] = []

    def show(result: Reconstruction) -> Any:
        write_view3d(tmp_path / "view.html", result)
        page = context.new_page()
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.add_init_script(f"({WRITTEN})()")
        page.goto((tmp_path / "view.html").as_uri())
        page.wait_for_function("written.length > 4")
        return page

    yield show
    context.close()
    assert complaints == []


def drawn_again(page: Any) -> None:
    page.evaluate("written.length = 0; dispatchEvent(new Event('resize'))")
    page.wait_for_function("written.length > 4")


@pytest.mark.parametrize(("size_m", "points"), [(1.0, 0), (1.0, 1), (0.02, 4), (30.0, 4), (3000.0, 4)])
def test_depths_are_written_beside_scenes_of_any_size(
    shown: Callable[[Reconstruction], Any], size_m: float, points: int
) -> None:
    page = shown(made(size_m, points))
    for mode in ("points", "surface", "slices"):
        if page.locator(f"option[value={mode}]").count():
            page.locator("#mode").select_option(mode)
            drawn_again(page)
            said = {text: (x, y) for text, x, y in page.evaluate("written") if text.endswith(" m")}
            depths = [text for text in said if not text.startswith("wall")]
            assert 1 <= len(depths) < 12
            assert all(float(text.split()[0]) > 0 for text in depths)
            places = sorted(said[text] for text in depths)
            assert all(np.hypot(a[0] - b[0], a[1] - b[1]) > 40 for a, b in pairwise(places))
            wall = next(text for text in said if text.startswith("wall"))
            assert float(wall.split()[1]) == pytest.approx(size_m, rel=0.01)


def test_what_the_middle_meets_is_told_by_keys(shown: Callable[[Reconstruction], Any]) -> None:
    page = shown(made(1.0, 4))
    before = page.evaluate(PIXELS)
    page.focus("#view")
    told = page.locator("#said")
    for _ in range(5):
        page.keyboard.press("-")  # so that none passes by beside the middle
    playwright.expect(told).to_have_text(re.compile(r"^x .* m, y .* m, z .* m: brightness 1.00$"))
    for _ in range(8):
        page.keyboard.press("Shift+ArrowUp")
    playwright.expect(told).to_have_text("")
    for _ in range(8):
        page.keyboard.press("Shift+ArrowDown")
    playwright.expect(told).not_to_have_text("")
    page.keyboard.press("Home")
    playwright.expect(told).to_have_text("")
    assert page.evaluate(PIXELS) == before  # and the cross is gone


def test_two_fingers_zoom_and_one_turns(shown: Callable[[Reconstruction], Any]) -> None:
    page = shown(made(1.0, 4))
    touch = page.context.new_cdp_session(page)

    def fingers(kind: str, *places: tuple[float, float]) -> None:
        points = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        page.wait_for_timeout(50)

    def wide() -> float:
        drawn_again(page)
        at = {text: np.array((x, y)) for text, x, y in page.evaluate("written")}
        return float(np.linalg.norm(at["x+"] - next(at[text] for text in at if text.startswith("wall"))))

    before = wide()
    fingers("touchStart", (350, 350), (450, 350))
    fingers("touchMove", (300, 350), (500, 350))
    fingers("touchEnd")
    assert wide() == pytest.approx(2 * before, rel=0.1)
    page.locator("#view").dblclick(position={"x": 10, "y": 10})
    fingers("touchStart", (350, 350))
    fingers("touchMove", (250, 350))
    fingers("touchEnd")
    assert abs(wide() - before) > 0.1 * before  # turned
    turned = page.evaluate(PIXELS)
    page.mouse.move(200, 300)
    page.mouse.move(500, 300)  # nothing is held any more
    page.wait_for_timeout(100)
    assert page.evaluate(PIXELS) == turned
