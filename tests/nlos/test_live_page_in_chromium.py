"""What a person sees on the live page: the system's Chromium, driven by Playwright, on a scan and on a finished one."""

import base64
import dataclasses
import io
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
import yaml
from matplotlib.colors import Normalize
from PIL import Image

from nlos.acquisition.recording.ended_as_asked import KIND, NOTHING_LEFT
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.cli.interrupts import BY_HAND
from nlos.configs.load import find
from nlos.recon.explained_share import Explained
from nlos.recon.pictures import BACKGROUND
from nlos.recon.results import read_reconstruction
from nlos.recon.seen import depth_limits, depth_opacity, visible_depth
from tests import command
from tests.chromium import needs_chromium

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
pytestmark = needs_chromium

SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: coarse_to_fine, batch: 8}
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
PATIENCE_MS = 90_000.0
COLOURS = """id => { const c = document.getElementById(id);
  return new Set(new Uint32Array(c.getContext("2d").getImageData(0, 0, c.width, c.height).data.buffer)).size; }"""
PIXELS = "id => document.getElementById(id).toDataURL()"


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as name:
        there = Path(name)
        (there / "scan.yaml").write_text(SCAN)
        command.nlos(there, "scan", "scan.yaml", "-o", "run.h5", check=True)
        yield there


@contextmanager
def viewed(folder: Path, *words: str, ends: int | None = 130) -> Iterator[str]:
    """The address of the page of `nlos live WORDS`, ended by Ctrl-C; None: killed."""
    process = subprocess.Popen(
        [sys.executable, "-m", "nlos", "live", *words],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        yield process.stdout.readline().strip()
        if ends is not None:
            process.send_signal(signal.SIGINT)
            assert process.wait(240) == ends
    finally:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def viewer(folder: Path) -> Iterator[str]:
    """The address of the page of the finished scan, one for all tests: it is read-only, and each opens its own page."""
    with viewed(folder, "run.h5", "--method", "lct") as url:
        yield url


def opened(browser: Any, url: str) -> tuple[Any, list[str]]:
    """A page, and what its scripts complain about."""
    page, complaints = browser.new_page(), []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.set_default_timeout(PATIENCE_MS)
    page.goto(url)
    return page, complaints


def shows(page: Any, name: str, pattern: str) -> None:
    """Waits for an element's text. The page's policy forbids what a browser would have to evaluate for `wait`."""
    playwright.expect(page.locator(f"#{name}")).to_have_text(re.compile(pattern), timeout=PATIENCE_MS)


def colours(page: Any, canvas: str) -> int:
    """How many colours a canvas shows."""
    return int(page.evaluate(COLOURS, canvas))


def test_a_finished_scan_is_shown_whole_and_along_its_time(viewer: str, browser: Any) -> None:
    page, complaints = opened(browser, viewer)
    page.wait_for_selector('body[data-picture="256"]')
    assert page.locator("#points").inner_text() == "256 of 256"
    assert page.locator("#rate").inner_text().endswith("counts/s")
    shows(page, "rateof", "^count rate at the end$")
    shows(page, "noiseof", "^photon noise of the picture of 256 points$")
    shows(page, "laser", r"^laser off since the scan's end \(simulated bench\)$")
    shows(page, "banner", r"Scan complete")
    for canvas in ("map", "albedo", "depth", "histo"):
        assert colours(page, canvas) > 2, canvas
    assert page.locator("#events tr").count() >= 3

    wall = page.locator("#map").bounding_box()
    page.mouse.click(wall["x"] + 0.2 * wall["width"], wall["y"] + 0.5 * wall["height"])
    shows(page, "histotitle", r"kept; Esc lets go")
    logarithmic = page.evaluate(PIXELS, "histo")
    page.keyboard.press("l")
    assert page.evaluate(PIXELS, "histo") != logarithmic
    page.keyboard.press("Escape")
    shows(page, "histotitle", r"last point taken")

    box, drawn = page.locator("#albedo").bounding_box(), page.evaluate("panels[0].frame.box")
    page.mouse.move(box["x"] + drawn[0] + drawn[2] / 2, box["y"] + drawn[1] + drawn[3] / 2)
    playwright.expect(page.locator(".panel .say").first).to_have_text(
        re.compile(r"x -?0\.0\d\d m, y -?0\.0\d\d m: brightness")
    )

    page.keyboard.press("3")
    page.wait_for_selector("#volume")
    page.wait_for_timeout(300)
    still = page.evaluate(PIXELS, "volume")
    box = page.locator("#volume").bounding_box()
    page.mouse.move(box["x"] + 60, box["y"] + 60)
    page.mouse.down()
    page.mouse.move(box["x"] + 120, box["y"] + 40, steps=4)
    page.mouse.up()
    page.wait_for_timeout(300)
    turned = page.evaluate(PIXELS, "volume")
    assert turned != still
    assert page.evaluate("performance.getEntriesByType('resource').filter(e => e.name.includes('solid')).length") == 0
    page.keyboard.press("v")  # surface, then slices: what they need is asked for now
    playwright.expect(page.locator(".controls button[aria-pressed=true]")).to_have_text("surface")
    page.wait_for_timeout(500)
    surface = page.evaluate(PIXELS, "volume")
    page.locator(".controls button", has_text="slices").click()
    playwright.expect(page.locator(".controls output")).to_have_text([re.compile(r"^-?\d\.\d\d m$")] * 3)
    page.wait_for_timeout(300)
    assert len({still, turned, surface, page.evaluate(PIXELS, "volume")}) == 4
    page.keyboard.press("4")

    whole = colours(page, "map")
    page.wait_for_selector("#slider", state="visible")
    playwright.expect(page.locator("#first")).not_to_contain_text("ready", timeout=PATIENCE_MS)
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.locator("#time").fill("5")
    page.wait_for_selector('body[data-picture="64"]')
    assert "64 of 256" in page.locator("#first").inner_text()
    assert colours(page, "map") < whole
    assert not [url for url in asked if "picture" in url]  # it was there already
    page.keyboard.press("ArrowRight")
    page.wait_for_selector('body[data-picture="77"]')
    assert complaints == []
    page.close()


FILM = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 1
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
frames: 24
"""


def test_a_finished_film_replays_frame_by_frame_with_its_memory(folder: Path, browser: Any) -> None:
    (folder / "film.yaml").write_text(FILM)
    command.nlos(folder, "scan", "film.yaml", "--bench", "moving", "-o", "film.h5", check=True)
    with viewed(folder, "film.h5", "--method", "lct") as url:
        page, complaints = opened(browser, url)
        page.wait_for_selector("#slider", state="visible")
        playwright.expect(page.locator("#first")).not_to_contain_text("ready", timeout=PATIENCE_MS)
        assert page.locator("#time").get_attribute("max") == "24"
        assert page.locator("#time").input_value() == "24"  # what is shown: more than a page begins with
        shown = []
        for frame in range(1, 6):
            page.locator("#time").fill(str(frame))
            page.wait_for_selector(f'body[data-picture="{64 * frame}"]')
            assert page.locator("#film dd").inner_text() == f"{frame} of 24"
            playwright.expect(page.locator("#first")).to_have_text(re.compile(r"^at \d\.\d\d s$"))
            shown.append((page.locator("#first").inner_text(), page.evaluate(PIXELS, "albedo")))
        moments, pictures = zip(*shown, strict=True)
        assert list(moments) == sorted(set(moments))
        assert len(set(pictures)) == 5
        assert page.evaluate("speedWords([0.3, 0.4, 0], [0.1, 0.1, 9])") == "0.50 ± 0.10 m/s"
        assert page.evaluate("speedWords([0.3, 0.4, 0], [null, null, null])") == "0.50 m/s"
        page.locator("#time").fill("1")
        page.keyboard.press("Space")
        page.wait_for_selector('body[data-picture="1536"]')  # played to its end, at its own pace
        playwright.expect(page.locator("#play")).to_contain_text("Play")
        assert complaints == []
        page.close()
    with viewed(folder, "film.h5", "run.h5", "--method", "lct") as url:  # of other steps: as far along
        page, complaints = opened(browser, url)
        page.wait_for_selector("#slider", state="visible")
        playwright.expect(page.locator("#first")).not_to_contain_text("ready", timeout=PATIENCE_MS)
        page.locator("#time").fill("12")
        for place, points in enumerate((768, 128)):
            playwright.expect(page.locator(".panel .say").nth(place)).to_contain_text(f"of {points} points")
        assert complaints == []
        page.close()


def test_nanos_depths_have_the_colours_of_the_picture_on_disk(folder: Path, browser: Any) -> None:
    """What the page draws at every pixel is what `depth.png` has there: faded with brightness and doubt, on grey."""
    command.nlos(folder, "reconstruct", "run.h5", "--method", "nano", "-o", "nano", "--no-volume", check=True)
    made = read_reconstruction(folder / "nano" / "reconstruction.h5")
    scale, ink = Normalize(*depth_limits([made]), clip=True), depth_opacity(made)[..., None]
    colour = matplotlib.colormaps["viridis_r"](scale(np.nan_to_num(visible_depth(made))))[..., :3]
    expected = 255 * (ink * colour + (1 - ink) * BACKGROUND)
    with viewed(folder, "run.h5", "--method", "nano") as url:
        page, complaints = opened(browser, url)
        page.wait_for_selector('body[data-picture="256"][data-method="nano"]')
        page.keyboard.press("2")
        page.wait_for_selector("#depth")
        seen = page.evaluate("""() => { const c = $("depth"), [x, y, w, h] = panels[0].frame.box, g = c.getContext("2d"), out = [];
          for (let r = 0; r < 16; r++) for (let k = 0; k < 16; k++) out.push(...g.getImageData(x + (k + .5) * w / 16, y + (r + .5) * h / 16, 1, 1).data.slice(0, 3));
          return out; }""")  # noqa: E501
        page.keyboard.press("1")
        page.wait_for_selector("#albedo")
        # a surface is likely everywhere, or not: hatched; drawn at one go, since news of the scan draws the page, too
        front = page.evaluate("""() => [.9, .2, .9].map(probability => {
          scans[0].pictures.nano.seen.fill(probability); draw(); return $("albedo").toDataURL(); })""")
        assert front[0] == front[2] != front[1]
        assert complaints == []
        page.close()
    drawn = np.array(seen, dtype=float).reshape(16, 16, 3)
    assert float(ink.max()) > 0.5  # there is something to compare
    assert np.abs(drawn - expected).max() < 16  # the page interpolates ten colours, matplotlib has 256


@pytest.mark.parametrize("width", [420, 1280, 1920])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_cut_off_at_any_width(viewer: str, browser: Any, width: int, scheme: str) -> None:
    page = browser.new_page(viewport={"width": width, "height": 800}, color_scheme=scheme)
    page.set_default_timeout(PATIENCE_MS)
    page.goto(viewer)
    page.wait_for_selector("body[data-picture]")
    for key in "1234":
        page.keyboard.press(key)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate("[...document.querySelectorAll('.panel canvas')].every(c => c.clientHeight > 200)")
    page.close()


SOLID = """async () => {
  const canvas = Object.assign(document.createElement("canvas"), {style: "width:200px;height:200px"}); document.body.append(canvas);
  const view = turnable(canvas, () => ({back: inks.card, dim: inks.card, grid: inks.card})), seen = [];
  for (const [depth, albedo] of [[.6, 1], [.8, 1], [1, 1], [1, .2]]) {
    view.show({points: Float32Array.of(0, 0, depth, albedo), wall: [1, 1], near: .6, far: 1, pitch: .2});
    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
    const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height), ground = data.slice(0, 3);
    let most = [...ground]; const away = c => Math.abs(c[0] - ground[0]) + Math.abs(c[1] - ground[1]) + Math.abs(c[2] - ground[2]);
    for (let i = 0; i < data.length; i += 4) if (away(data.slice(i, i + 3)) > away(most)) most = [...data.slice(i, i + 3)];
    seen.push([[...ground], most]);
  }
  canvas.remove(); return seen; }"""  # noqa: E501


def contrast(one: list[int], other: list[int]) -> float:
    """The contrast ratio of two colours, 1 to 21 (WCAG 2.1)."""

    def luminance(colour: list[int]) -> float:
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (v / 255 for v in colour)]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_in_3d_what_is_far_is_as_readable_as_what_is_near_and_only_the_faint_is_pale(
    viewer: str, browser: Any, scheme: str
) -> None:
    page = browser.new_page(color_scheme=scheme)
    page.set_default_timeout(PATIENCE_MS)
    page.goto(viewer)
    page.wait_for_selector("body[data-picture]")
    near, between, far, faint = (contrast(ground, seen) for ground, seen in page.evaluate(SOLID))
    assert min(near, between, far) > 3.0  # what graphics need (WCAG 2.1, 1.4.11)
    assert 1.0 < faint < 0.75 * far
    page.close()


LABEL = """h => { const said = [];
  const g = new Proxy({measureText: t => ({width: 6 * t.length}), fillText: t => said.push(t)}, {
    get: (known, name) => known[name] || (() => {}), set: () => true});
  colourBar(g, 0, 0, h, 0, 1, v => [0, 0, 0], "brightness (relative), hatched: likely no surface");
  return said.filter(text => /[a-z]/.test(text)); }"""
"""What colourBar writes beside a bar of this height, in a font of 6 pixels a letter."""


UPPER_END = """id => { const pencil = $(id).getContext("2d"), ends = []; const drawn = pencil.fillText;
  pencil.fillText = function (text, ...at) { const m = this.getTransform(); if (m.b < 0) ends.push([text, m.f / devicePixelRatio - this.measureText(text).width / 2]);
    drawn.call(this, text, ...at); };
  map.draw(); delete pencil.fillText; return ends.find(end => end[0].endsWith("counts/s")); }"""  # noqa: E501
"""The label along a bar, and how far below the canvas's upper edge its end is."""


def test_the_label_of_a_short_bar_is_not_cut_off(viewer: str, browser: Any) -> None:
    page, _ = opened(browser, viewer)
    assert page.evaluate(LABEL, 400) == ["brightness (relative), hatched: likely no surface"]
    assert page.evaluate(LABEL, 130) == ["brightness (relative)", "hatched: likely no surface"]
    for width in (360, 1280, 1920):  # on the map of counts there is one line, and little room above it
        page.set_viewport_size({"width": width, "height": 700})
        page.wait_for_timeout(300)
        above, upper = page.evaluate(UPPER_END, "map")
        assert upper >= 0, (width, above)
    page.close()


def test_a_scan_under_way_shows_what_comes_next_and_its_end(folder: Path, browser: Any) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "nlos", "live", "grows.h5", "--method", "lct"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    page, complaints = opened(browser, process.stdout.readline().strip())
    shows(page, "status", r"^Waiting for the scan's file$")
    bench = subprocess.Popen(
        [sys.executable, "-m", "nlos", "replay", "run.h5", "-o", "grows.h5", "-q"], cwd=folder,
        stdout=subprocess.DEVNULL,
    )  # fmt: skip
    shows(page, "left", r" s left$")
    shows(page, "status", r"^Replaying a recording$")
    shows(page, "laser", r"^replay of a recording: no laser$")
    assert page.locator("#slider").is_hidden()
    assert bench.wait(240) == 0
    page.wait_for_selector('body[data-picture="256"]')
    shows(page, "status", r"^Scan complete$")
    page.wait_for_selector("#slider", state="visible")
    assert complaints == []
    process.send_signal(signal.SIGINT)
    assert process.wait(240) == 130
    shows(page, "status", r"^No answer")
    shows(page, "banner", r"The viewer has ended")
    page.wait_for_timeout(300)  # nothing is asked any more: the banner alone has made everything another size
    assert page.evaluate("""[...document.querySelectorAll("canvas")].every(c => Math.abs(c.width - c.clientWidth) < 2
      && Math.abs(c.height - c.clientHeight) < 2)""")
    page.close()


class Bench:
    """A scan that is written word by word and sample by sample, for a viewer to follow."""

    def __init__(self, folder: Path, name: str, shutter: str = "tcspc488") -> None:
        with Recording.open(folder / "run.h5") as recording:
            self._samples = list(recording.samples())
            bench = {**json.loads(recording.header.bench_json), "shutter": {"model": shutter}}
            header = dataclasses.replace(recording.header, bench_json=json.dumps(bench))
            self._writer = RecordingWriter.create(folder / name, recording.plan, header)
        self._taken = 0

    def says(self, kind: str, text: str) -> None:
        self._writer.log(kind, text, self._samples[max(0, self._taken - 1)].taken_s)
        self._writer.flush()

    def takes(self, count: int) -> None:
        for sample in self._samples[self._taken : self._taken + count]:
            self._writer.write(sample)
        self._taken += count
        self._writer.flush()

    def ends(self, status: Status) -> None:
        self._writer.finish(status)


LAMP = """id => { const e = document.getElementById(id), s = getComputedStyle(e), rgb = c => (c.match(/[\\d.]+/g) || []).map(Number);
  const over = e => { for (let at = e; at; at = at.parentElement) { const c = rgb(getComputedStyle(at).backgroundColor); if (c.length === 3) return c; } return [255, 255, 255]; };
  return {ink: rgb(s.color), ground: over(e), page: over(document.body), size: parseFloat(s.fontSize), box: e.getBoundingClientRect().toJSON()}; }"""  # noqa: E501


TAPE = """() => { const s = getComputedStyle($("banner"));
  return s.borderImageSource === "none" && s.borderTopWidth === "0px" ? "banner" : "banner with tape"; }"""
"""What is about light that may be on has the look of a hazard, and no other trouble has."""


@pytest.mark.sampled(2)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_light_that_is_on_is_loud_and_light_that_is_off_is_calm_and_always_said(
    folder: Path, browser: Any, scheme: str
) -> None:
    name = f"lamp-{scheme}.h5"
    with viewed(folder, name, "--method", "lct", ends=None) as url:
        page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme=scheme)
        page.set_default_timeout(PATIENCE_MS)
        page.goto(url)
        shows(page, "laser", "^laser: not known before the scan begins$")
        bench = Bench(folder, name)
        shows(page, "laser", r"^laser off \(simulated bench\)$")
        bench.says("shutter", "opened")
        bench.takes(64)
        shows(page, "laser", r"^LASER ON \(simulated bench\)$")
        shows(page, "rateof", "^count rate$")
        lit = page.evaluate(LAMP, "laser")
        bench.says("signal", "SIGINT")
        bench.says("shutter", "closed: SIGINT")
        bench.says("scan", f"paused by {BY_HAND}")
        shows(page, "laser", r"^laser off \(simulated bench\)$")
        shows(page, "rateof", "^count rate before the pause$")
        shows(page, "banner", "^Paused ?by Ctrl-C in the terminal. The laser is off. Pressing Enter there resumes")
        shows(page, "banner", "resumes the scan and opens the shutter.$")
        dark = page.evaluate(LAMP, "laser")
        assert contrast(lit["ground"], lit["page"]) > 3.0 > contrast(dark["ground"], dark["page"])
        assert min(contrast(each["ink"], each["ground"]) for each in (lit, dark)) > 4.5  # text (WCAG 2.1, 1.4.3)
        assert lit["size"] > 1.2 * dark["size"]
        assert dark["size"] >= 15
        bench.says("scan", "paused")
        shows(page, "banner", "^Paused ?The laser is off")
        bench.says("scan", "paused: Ctrl-C")  # as recordings of before say it
        shows(page, "banner", "^Paused ?by Ctrl-C in the terminal. The laser is off")
        bench.says("shutter", "NOT CONFIRMED CLOSED: no answer")
        shows(page, "laser", r"^LASER MAY BE ON \(simulated bench\)$")
        bench.says("shutter", "closed: SIGINT")
        bench.says("scan", "paused: alarm: no photon where 40 were expected")
        shows(page, "banner", "^Alarm: the scan is paused")
        assert page.evaluate(TAPE) == "banner"
        bench.says("shutter", "NOT CONFIRMED CLOSED: no answer")
        shows(page, "laser", "^LASER MAY BE ON")
        assert page.evaluate(TAPE) == "banner with tape"
        bench.says("shutter", "closed: SIGINT")
        bench.says("scan", f"ended while paused by {BY_HAND}")
        bench.says("scan", "interrupted")
        bench.ends(Status.INTERRUPTED)
        shows(page, "status", "^Ended early$")
        shows(page, "banner", "^Ended early ?while paused by Ctrl-C in the terminal: 64 of 256 points")
        shows(page, "laser", r"^laser off since the scan's end \(simulated bench\)$")
        shows(page, "rateof", "^count rate at the end$")
        page.close()


def test_a_bench_without_a_shutter_is_loud_for_as_long_as_its_scan_lasts(folder: Path, browser: Any) -> None:
    with viewed(folder, "bare.h5", "--method", "lct", ends=None) as url:
        page, _ = opened(browser, url)
        bench = Bench(folder, "bare.h5", shutter="none")
        bench.takes(16)
        shows(page, "laser", r"^NO SHUTTER: TREAT THE LASER AS ON \(simulated bench\)$")
        playwright.expect(page.locator("#laser")).to_have_class("lit")
        bench.says("scan", f"paused by {BY_HAND}")
        shows(page, "banner", "^Paused ?by Ctrl-C in the terminal. This bench has no shutter: the laser is as it was.")
        shows(page, "banner", "resumes the scan.$")
        bench.says("scan", "interrupted")
        bench.ends(Status.INTERRUPTED)
        shows(page, "laser", r"^laser: not switched by this bench \(simulated bench\)$")
        page.close()


KILLED = """
import os, signal, sys
from pathlib import Path
from tests.nlos.test_live_page_in_chromium import Bench
bench = Bench(Path(sys.argv[1]), sys.argv[2])
for word in sys.argv[3:]:
    bench.says("shutter", word)
bench.takes(64)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_of_scans_that_were_killed_the_one_that_may_have_left_its_light_on_is_loud(folder: Path, browser: Any) -> None:
    """Whichever is looked at: nobody commands a shutter any more."""
    for words in (["dark.h5", "opened", "closed"], ["lit.h5", "opened"]):
        subprocess.run([sys.executable, "-c", KILLED, folder, *words], cwd=Path(__file__).parents[2], check=False)
    with viewed(folder, "dark.h5", "lit.h5", "--method", "lct", ends=None) as url:
        page, _ = opened(browser, url)
        shows(page, "status", "^dark.h5: The scan was killed$")
        shows(page, "laser", r"^lit.h5: LASER MAY BE ON \(simulated bench\)$")
        shows(page, "banner", "^The scan was killed; the laser was off ?dark.h5: .*run `nlos shutter close`.* 64")
        assert page.evaluate(TAPE) == "banner"
        page.wait_for_selector("body[data-picture]")
        page.locator(".panel canvas").nth(1).click()
        shows(page, "banner", "^The scan was killed: the laser may be on ?lit.h5: .*run `nlos shutter close`")
        assert page.evaluate(TAPE) == "banner with tape"
        page.close()


def test_a_scan_whose_picture_was_good_enough_ended_as_asked(folder: Path, browser: Any) -> None:
    with viewed(folder, "enough.h5", "--method", "lct", ends=None) as url:
        page, _ = opened(browser, url)
        bench = Bench(folder, "enough.h5")
        bench.says("shutter", "opened")
        bench.takes(64)
        bench.says(KIND, NOTHING_LEFT)
        bench.says("shutter", "closed")
        bench.says(KIND, "interrupted")
        bench.ends(Status.INTERRUPTED)
        shows(page, "status", "^Ended as asked$")
        shows(page, "banner", "^Ended as asked ?the picture was good enough: 64 of 256 points are taken; .*--resume")
        shows(page, "laser", r"^laser off since the scan's end \(simulated bench\)$")
        shows(page, "rateof", "^count rate at the end$")
        assert page.locator("#banner").get_attribute("class") == "good"
    shows(page, "laser", r"^laser off when last seen \(simulated bench\)$")  # the viewer is gone
    page.close()


def test_a_scan_that_failed_says_by_what_not_which_alarm_was_mended_before(viewer: str, browser: Any) -> None:
    page, _ = opened(browser, viewer)
    shows(page, "status", "^Scan complete$")
    said = page.evaluate("""() => { const state = scans[0].state; state.status = "failed";
      state.events = [[1, "alarm", "an old one"], [2, "failed", "run.h5: the disk refused a write"]];
      tell(); return $("banner").innerText; }""")
    assert said.splitlines()[-1] == "run.h5: the disk refused a write"
    page.close()


def test_a_scan_whose_recording_is_gone_is_not_waited_for(viewer: str, browser: Any) -> None:
    page, _ = opened(browser, viewer)
    shows(page, "status", "^Scan complete$")
    page.evaluate("""() => { const state = scans[0].state; delete state.light;
      [state.status, state.message, state.pictures] = ["missing", "run.h5: was deleted.", {}]; tell(); }""")
    shows(page, "status", "^No recording to show$")
    shows(page, "banner", r"run\.h5: was deleted\. Nothing here knows whether the laser is on: see the scan's terminal")
    shows(page, "laser", "^laser: not known$")
    page.close()


def test_a_viewer_that_is_killed_leaves_behind_first_of_all_that_the_laser_may_be_on(
    folder: Path, browser: Any
) -> None:
    with viewed(folder, "orphan.h5", "--method", "lct", ends=None) as url:
        page, _ = opened(browser, url)
        bench = Bench(folder, "orphan.h5")
        bench.says("shutter", "opened")
        bench.takes(64)
        page.wait_for_selector("body[data-picture]")
        bench.takes(8)
        shows(page, "points", "^72 of 256$")
        shows(page, "noiseof", f"of the picture of {page.evaluate('document.body.dataset.picture')} points$")
        assert int(page.evaluate("document.body.dataset.picture")) < 72
    shows(page, "laser", r"^LASER MAY BE ON \(simulated bench\)$")
    large = page.locator("#banner strong")
    assert large.inner_text() == "The laser may still be on"
    assert page.evaluate(LAMP, "laser")["size"] < float(large.evaluate("e => parseFloat(getComputedStyle(e).fontSize)"))
    shows(page, "banner", "Treat it as on and see the scan's terminal. The viewer has ended, or the way to it")
    shows(page, "banner", r"This page changes once it answers. When last seen, at \d\d:\d\d:\d\d: scanning, 72 of")
    assert page.evaluate(TAPE) == "banner with tape"
    shows(page, "rateof", "^count rate when last seen$")
    shows(page, "histotitle", r"\(last point taken\)$")
    bench.ends(Status.INTERRUPTED)
    page.close()


def test_a_viewer_that_does_not_answer_is_told_and_what_it_last_said_is_not_taken_for_now(
    folder: Path, browser: Any
) -> None:
    """A line that was cut while a laptop slept, say, of which nobody hears: no request fails."""
    with viewed(folder, "silent.h5", "--method", "lct", ends=None) as url:
        page, complaints = opened(browser, url)
        bench = Bench(folder, "silent.h5")
        bench.says("shutter", "opened")
        bench.takes(64)
        shows(page, "points", "^64 of 256$")
        shows(page, "laser", "^LASER ON")
        held: list[Any] = []
        page.route("**/state*", lambda route: held.append(route))
        bench.says("shutter", "closed")
        bench.ends(Status.INTERRUPTED)
        page.wait_for_timeout(500)
        page.evaluate("heardMs -= SILENT_MS")
        shows(page, "status", "^No answer$")
        shows(page, "laser", "^LASER MAY BE ON")
        shows(page, "banner", r"^The laser may still be on ?Treat it as on .*: scanning, 64 of 256 points")
        shows(page, "banner", r"When last seen, at \d\d:\d\d:\d\d: ")
        assert page.evaluate(TAPE) == "banner with tape"
        assert page.title() == "No answer - silent.h5"
        page.unroute("**/state*")
        assert len(held) == 1
        shows(page, "status", "^Ended early$")
        shows(page, "laser", "^laser off since the scan's end")
        page.route("**/picture*", lambda route: None)  # what is long in coming holds up nothing that is said
        page.evaluate("scans[0].pictures = {}")
        before = page.evaluate("heardMs")
        page.wait_for_function("before => heardMs > before + 1000", arg=before)
        page.unroute_all(behavior="ignoreErrors")
        assert complaints == []
        page.close()


@pytest.mark.parametrize(
    ("status", "said"),
    [(404, '{"detail": "Not Found"}'), (200, "{}"), (200, '{"scans": []}'), (200, "<p>log in"), (404, "no")],
)
def test_the_answer_of_another_program_at_its_address_is_no_word_of_the_viewer(
    folder: Path, browser: Any, status: int, said: str
) -> None:
    """A notebook server, say, that got the port after the viewer had ended, or the network's own page."""
    with viewed(folder, "run.h5", "--method", "lct", ends=None) as url:
        page, complaints = opened(browser, url)
        page.wait_for_selector("body[data-picture]")
        shows(page, "laser", "^laser off since the scan's end")
        page.evaluate("scans[0].state.status = 'paused'")
        page.route("**/state*", lambda route: route.fulfill(status=status, body=said, content_type="application/json"))
        shows(page, "status", "^No answer: the viewer has ended or is cut off$")
        shows(page, "laser", "^laser off when last seen")
        assert [each for each in complaints if "Failed to load" not in each] == []
        page.unroute("**/state*")
        shows(page, "status", "^Scan complete$")
        page.close()


def test_a_page_that_slept_for_days_says_of_which_day_its_words_are(viewer: str, browser: Any) -> None:
    page, _ = opened(browser, viewer)
    shows(page, "status", "^Scan complete$")
    said = page.evaluate("[moment(new Date()), moment(new Date(2020, 1, 3, 4, 5, 6))]")
    assert re.fullmatch(r"\d\d:\d\d:\d\d", said[0])
    assert said[1] == "03/02/2020, 04:05:06"
    page.close()


HAPPENED = """() => { const state = scans[0].state; const long = "a photon where none was expected, and none where many were ".repeat(3);
  state.events = [...Array(30).keys()].map(i => [i, i % 3 ? "shutter" : "alarm", (i === 7 ? "x".repeat(200) : long) + i]); tell();
  const log = $("log"), out = [];
  for (const row of document.querySelectorAll("#events tr")) {
    row.scrollIntoView({block: "nearest"}); const r = row.getBoundingClientRect(), l = log.getBoundingClientRect(), cells = [...row.children];
    out.push([r.top >= Math.max(l.top, 0) - 1, r.bottom <= Math.min(l.bottom, innerHeight) + 1, r.right <= l.right + 1, cells.every(c => c.scrollWidth <= c.clientWidth + 1)]);
  } return out; }"""  # noqa: E501


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (420, 860), (1920, 1080)])
def test_every_event_can_be_read_to_its_end(viewer: str, browser: Any, width: int, height: int) -> None:
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(viewer)
    page.wait_for_selector("#slider", state="visible")
    rows = page.evaluate(HAPPENED)
    assert len(rows) == 30
    assert [row for row in rows if not all(row)] == []
    if width > 900:  # the panel is on the screen, whole, without scrolling the page
        box = page.locator("#happened").bounding_box()
        assert box["y"] + box["height"] <= height
    page.close()


@pytest.mark.parametrize(
    ("peak", "labels"),
    [
        (0, ["0"]),
        (4, ["0", "1", "2"]),
        (60, ["0", "1", "5", "10", "20", "50"]),
        (7000, ["0", "1", "10", "100", "1,000", "5,000"]),
    ],
)
def test_counts_have_labels_up_to_the_peak(viewer: str, browser: Any, peak: int, labels: list[str]) -> None:
    """On a logarithmic axis the last one stood at 10 for a peak of 99."""
    page, _ = opened(browser, viewer)
    page.wait_for_function("() => scans.length && histogram.counts", timeout=PATIENCE_MS)
    said = page.evaluate(
        """peak => { const most = Math.log10(1 + Math.max(peak, 1)), py = v => 130 * (1 - Math.log10(1 + v) / most);
        return histogram.decades(peak, py).sort((a, b) => a - b).map(count); }""",
        peak,
    )
    assert said == labels
    page.close()


VERDICTS = """([change, bound, said, verdict]) => { const panel = panels.find(p => p.kind === "front");
  Object.assign(panel.picture, {change, bound, explained: said, verdict, refined: true}); return panel.about().map(e => e.textContent).join(""); }"""  # noqa: E501


@pytest.mark.parametrize(
    ("change", "bound", "explained", "words"),
    [
        (0.03, 0.3, Explained(0.9, 0.01), ("(settled)", "(good)", "(believable)")),
        (0.08, 0.4, Explained(0.02, 0.01), ("(still changing)", "(not good yet)", "(do not believe it)")),
        (0.08, 1.0, Explained(0.5, 0.01, doubt="another wall"), ("not good yet", "doubtful: another wall")),
    ],
)
def test_every_percentage_has_a_verdict(
    viewer: str, browser: Any, change: float, bound: float, explained: Explained, words: tuple[str, ...]
) -> None:
    page, complaints = opened(browser, viewer)
    page.wait_for_selector("body[data-picture]")
    said = page.evaluate(VERDICTS, [change, bound, str(explained), explained.verdict])
    assert [word for word in words if word not in said] == [], said
    assert ("believable" in said) == (explained.verdict == "believable")
    shows(page, "noise", r"^\d+\.\d %, (low|high)$")
    assert complaints == []
    page.close()


WRITTEN = """() => { const said = [], g = CanvasRenderingContext2D.prototype, before = g.fillText;
  g.fillText = function (text, x, y) { if (this.canvas.id === "histo") said.push([text, x, y]); return before.call(this, text, x, y); };
  histogram.draw(); g.fillText = before; const {start, bin} = scans[0].plan;
  return {said, start, end: start + bin * histogram.counts.length, zero: histogram.zero, wide: $("histo").clientWidth - 66}; }"""  # noqa: E501


def test_the_scale_over_a_histogram_is_range_from_the_wall_point(viewer: str, browser: Any) -> None:
    """Light that went out and back: c t / 2 after time zero, and no depth."""
    page, _ = opened(browser, viewer)
    page.wait_for_function("() => scans.length && histogram.zero !== null && histogram.counts", timeout=PATIENCE_MS)
    found = page.evaluate(WRITTEN)
    texts = [text for text, _, _ in found["said"]]
    assert "range from the wall point, c t / 2 (m)" in texts
    assert not [text for text in texts if "depth" in text]
    label_y = next(y for text, _, y in found["said"] if text.startswith("range"))
    scale = [(float(text), x) for text, x, y in found["said"] if y == label_y + 13 and re.fullmatch(r"[\d.]+", text)]
    assert len(scale) >= 2
    for range_m, x in scale:
        along = (found["zero"] + 2e9 * range_m / 299792458.0 - found["start"]) / (found["end"] - found["start"])
        assert x == pytest.approx(58 + found["wide"] * along, abs=0.01)
    page.close()


DOUBT = """([dark, size]) => { const out = {};
  for (const sure of [.9, .2]) {
    const c = Object.assign(document.createElement("canvas"), {width: size, height: size});
    const g = c.getContext("2d"), n = 64;
    const p = {seen: new Float32Array(n * n).fill(sure), albedo: new Float32Array(n * n).fill(dark)};
    image(g, p.albedo, n, n, [0, 0, size, size], gray); hatch(g, p, n, n, [0, 0, size, size]);
    out[sure] = btoa(Array.from(g.getImageData(0, 0, size, size).data, v => String.fromCharCode(v)).join(""));
  } return out; }"""


@pytest.mark.parametrize("brightness", [0.03, 0.2, 0.39, 0.41, 0.7, 1.0])
@pytest.mark.parametrize("size", [128, 384])
def test_doubt_is_seen_and_what_is_drawn_is_seen_through_it(
    viewer: str, browser: Any, brightness: float, size: int
) -> None:
    """In grey alone, so that every eye sees it."""
    page, _ = opened(browser, viewer)
    found = page.evaluate(DOUBT, [brightness, size])
    drawn = (np.frombuffer(base64.b64decode(found[key]), np.uint8) for key in ("0.9", "0.2"))
    plain, hatched = (pixels.reshape(size, size, 4)[..., :3].astype(float) for pixels in drawn)
    off = np.abs(hatched - plain).max(axis=-1)
    assert off.max() > 30  # an eighth of the whole range, on every ground
    assert off.mean() < 25
    assert off.max() < 110
    assert np.ptp(hatched, axis=-1).max() == 0
    page.close()


def test_two_scans_are_set_side_by_side_with_their_difference(folder: Path, browser: Any) -> None:
    command.nlos(folder, "replay", "run.h5", "--speed", "max", "-o", "same.h5", "--overwrite", check=True)
    with viewed(folder, "run.h5", "same.h5", "--method", "lct") as url:
        page, complaints = opened(browser, url)
        page.wait_for_selector("#slider", state="visible")
        shows(page, "run", "^run.h5 and same.h5$")
        shows(page, "status", "^run.h5: Scan complete$")  # whose the figures beside it are
        page.locator(".panel canvas").nth(1).click()
        shows(page, "status", "^same.h5: Scan complete$")
        shows(page, "banner", "Scan complete ?same.h5: 256 points in ")
        page.keyboard.press("d")
        page.wait_for_selector("#difference[aria-pressed=true]")
        titles = page.locator(".panel h2").all_inner_texts()
        assert titles == ["run.h5: front view", "same.h5: front view", "Difference: run.h5 less same.h5",
                          "run.h5: depth", "same.h5: depth", "Depth difference: run.h5 less same.h5"]  # fmt: skip
        playwright.expect(page.locator(".panel[data-kind=difference] .say")).to_have_text(
            "LCT of 256 points less LCT of 256 points", timeout=PATIENCE_MS
        )
        page.wait_for_function("() => albedo.toDataURL() === albedo1.toDataURL()", timeout=PATIENCE_MS)
        # Less without colours: as much above and below zero differ by strokes alone.
        strokes = page.evaluate("""() => { const c = document.createElement("canvas");
          c.width = c.height = 64; const g = c.getContext("2d"), seen = below => { g.clearRect(0, 0, 64, 64);
          hatchBelow(g, 8, 8, [0, 0, 64, 64], () => below); return g.getImageData(0, 0, 64, 64).data.some(v => v); };
          return [-1, -.3, -.05, 0, .3, 1].map(seen); }""")
        assert strokes == [True, True, False, False, False, False]
        middle = page.evaluate("id => { const p = panels.find(p => p.kind === id); return [...p.picture.albedo].every("
                               "(v, i) => v === p.other.albedo[i]); }", "difference")  # fmt: skip
        assert middle is True
        page.keyboard.press("d")
        page.keyboard.press("3")
        playwright.expect(page.locator(".panel h2").nth(1)).to_have_text("same.h5: 3D", timeout=PATIENCE_MS)
        with page.expect_download() as saved:
            page.locator(".panel button", has_text="Save as PNG").nth(1).click()
        assert saved.value.suggested_filename == "same.h5-3d.png"
        assert complaints == []
        page.close()


def test_scans_of_one_wall_on_two_grids_are_compared_on_the_finer(folder: Path, browser: Any) -> None:
    """With what the coarser picture has at the centre of every pixel."""
    (folder / "coarse.yaml").write_text(SCAN.replace("rows: 16, cols: 16", "rows: 8, cols: 8"))
    command.nlos(folder, "scan", "coarse.yaml", "-o", "coarse.h5", "--overwrite", check=True)
    with viewed(folder, "run.h5", "coarse.h5", "--method", "lct") as url:
        page, complaints = opened(browser, url)
        page.wait_for_selector("#slider", state="visible")
        page.keyboard.press("d")
        playwright.expect(page.locator(".panel[data-kind=difference] .say")).to_have_text(
            "LCT of 256 points less LCT of 64 points", timeout=PATIENCE_MS
        )
        fine, held, own = page.evaluate(
            """() => { const d = panels.find(p => p.kind === "difference");
            const own = panels.find(p => p.scan === 1).picture;
            return [[...d.picture.albedo], [...d.other.albedo], [...own.albedo]]; }"""
        )
        coarse = np.reshape(own, (8, 8))
        assert np.array_equal(np.reshape(held, (16, 16)), np.kron(coarse, np.ones((2, 2))))
        assert len(fine) == 256
        assert complaints == []
        page.close()


def test_the_depths_of_two_scans_are_compared_where_both_have_one(folder: Path, browser: Any) -> None:
    """One flat object, 60 mm farther from the wall in the second scan."""
    for name, z_m in (("near", 0.6), ("far", 0.66)):
        bench = yaml.safe_load(find("bench", "simulated").read_text("utf-8"))
        bench["simulation"]["scene"]["objects"] = [{"letter": "I", "centre_m": [0.0, 0.0, z_m], "height_m": 0.6}]
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(bench))
        command.nlos(
            folder, "scan", "scan.yaml", "--bench", f"{name}.yaml", "-o", f"{name}.h5", "--overwrite", check=True
        )
    with viewed(folder, "near.h5", "far.h5", "--method", "lct") as url:
        page, complaints = opened(browser, url)
        page.wait_for_selector("#slider", state="visible")
        page.keyboard.press("2")
        page.keyboard.press("d")
        deeper = page.locator(".panel[data-kind=deeper]")
        playwright.expect(deeper.locator(".say")).to_contain_text(
            "red: the first is farther away, hatched: it is nearer", timeout=PATIENCE_MS
        )
        assert page.locator(".panel h2").all_inner_texts()[-1] == "Depth difference: near.h5 less far.h5"
        spot = page.evaluate("""() => { const p = panels[2], ink = [...p.picture.albedo].map((_, i) =>
          Math.min(inkOf(p.picture, i), inkOf(p.other, i))), i = ink.indexOf(Math.max(...ink));
          const [x, y, w, h] = p.frame.box;
          return [x + (i % 16 + .5) * w / 16, y + (Math.floor(i / 16) + .5) * h / 16]; }""")
        box = page.locator("#deeper").bounding_box()
        page.mouse.move(box["x"] + spot[0], box["y"] + spot[1])
        playwright.expect(deeper.locator(".say")).to_contain_text("nearer", timeout=PATIENCE_MS)
        said = re.search(r"depths (\S+) and (\S+) m, the first (\S+) mm nearer", deeper.locator(".say").inner_text())
        assert said is not None
        assert float(said[3]) == pytest.approx(60.0, abs=10.0)
        colour = "([x, y]) => [...$('deeper').getContext('2d').getImageData(x, y, 1, 1).data]"
        red, _, blue, _ = page.evaluate(colour, spot)
        assert blue > red + 50  # nearer
        left, top, *_ = page.evaluate("panels[2].frame.box")
        corner = page.evaluate(colour, [left + 3, top + 3])
        assert corner[:3] == [150, 150, 150]
        assert complaints == []
        page.close()


def test_a_page_that_was_hidden_goes_on_where_somebody_looks_again(viewer: str, browser: Any) -> None:
    page, complaints = opened(browser, viewer)
    page.wait_for_selector("#slider", state="visible")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.evaluate("() => { window.unseen = true; Object.defineProperty(document, 'hidden', {get: () => unseen}); }")
    page.wait_for_timeout(2_000)
    asked.clear()
    page.wait_for_timeout(2_000)
    assert asked == []
    with page.expect_request(lambda request: request.url.endswith("/state")):
        page.evaluate("() => { window.unseen = false; document.dispatchEvent(new Event('visibilitychange')); }")
    assert len([url for url in asked if url.endswith("/state")]) == 1
    assert complaints == []
    page.close()


def test_a_report_needs_nothing_but_itself_and_prints(folder: Path, browser: Any) -> None:
    command.nlos(folder, "report", "run.h5", "-o", "run.html", "--methods", "lct,fk", "--overwrite", check=True)
    page, complaints = browser.new_page(), []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto((folder / "run.html").as_uri())
    page.wait_for_load_state("load")
    text = page.locator("body").inner_text()
    for word in ("LCT", "FK", "triggerscope", "tcspc-488", "256", "shutter", "LCT sees surfaces between"):
        assert word.lower() in text.lower(), word
    assert page.locator("img").count() >= 4
    assert page.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 0)")
    tops = page.evaluate(
        "['.hero', '.summary', 'iframe', 'table'].map(s => document.querySelector(s).getBoundingClientRect().top)"
    )
    assert tops == sorted(tops)  # the picture first, the tables last
    assert page.locator(".still").is_hidden()
    page.emulate_media(media="print")
    assert page.locator(".still").is_visible()
    assert page.locator("iframe").is_hidden()
    printed = page.pdf(format="A4")
    assert printed.startswith(b"%PDF")
    assert [url for url in asked if not url.startswith(("file:", "data:", "blob:", "about:"))] == []
    assert complaints == []
    page.close()


def test_a_report_on_two_scans_sets_them_side_by_side(folder: Path, browser: Any) -> None:
    (folder / "dim.yaml").write_text(SCAN.replace("dwell_ms: 20", "dwell_ms: 2"))
    command.nlos(folder, "scan", "dim.yaml", "-o", "dim.h5", "--overwrite", check=True)
    command.nlos(
        folder, "report", "run.h5", "dim.h5", "-o", "two.html", "--methods", "lct,fk", "--overwrite", check=True
    )
    page = browser.new_page()
    page.goto((folder / "two.html").as_uri())
    assert page.locator("h1").all_inner_texts() == ["Side by side", "run.h5", "dim.h5"]
    assert page.locator("details figure img").first.is_hidden()
    page.locator("summary", has_text="Differences").click()
    assert page.locator("details figure img").first.is_visible()
    differences = [text for text in page.locator("details figcaption").all_inner_texts() if " less " in text]
    assert sorted(differences) == [
        "dim.h5, LCT less dim.h5, FK", "run.h5, FK less dim.h5, FK",
        "run.h5, LCT less dim.h5, LCT", "run.h5, LCT less run.h5, FK",
    ]  # fmt: skip
    page.close()


def test_the_page_is_used_by_keys_alone_and_told_to_who_cannot_see_it(viewer: str, browser: Any) -> None:
    page, complaints = opened(browser, viewer)
    page.wait_for_selector('body[data-picture="256"]')
    page.keyboard.press("4")
    assert page.get_by_role("img", name="Histogram").count() == 1
    # What takes arrow keys says so by its role: a screen reader keeps them to itself on what is an image.
    for name in (
        r"^Front view, looking towards the wall: brightest at x -0\.\d\d m, y -?0\.\d\d m; surfaces from 0\.\d\d to 1",
        r"^Depth.* m from the wall in \d+ % of the picture$",
        "count rate",
    ):
        assert page.get_by_role("application", name=re.compile(name)).count() == 1, name
    assert page.get_by_role("button", name="Side by side", pressed=True).count() == 1
    assert page.get_by_role("button", name="Depth", pressed=False).count() == 1
    stops = set()
    for _ in range(20):
        page.keyboard.press("Tab")
        stops.add(page.evaluate("document.activeElement.id"))
        here = page.evaluate("[document.activeElement.tagName, getComputedStyle(document.activeElement).outlineWidth]")
        assert here[0] == "BODY" or here[1] == "2px"
    assert {"albedo", "depth", "map", "time", "log", "scale", "help"} <= stops
    page.focus("#albedo")
    page.keyboard.press("ArrowUp")
    front = page.locator(".panel[data-kind=front] .say")
    playwright.expect(front).to_have_text(re.compile(r"^x .* m: brightness 1\.\d+, depth \d\.\d+ m"))  # the brightest
    assert front.get_attribute("aria-live") == "polite"
    here, plain = front.inner_text(), page.evaluate(PIXELS, "depth")
    page.keyboard.press("ArrowRight")
    east = front.inner_text()
    assert float(east.split()[1]) - float(here.split()[1]) == pytest.approx(1 / 16, abs=2e-3)
    page.keyboard.press("ArrowLeft")
    assert front.inner_text() == here
    page.keyboard.press("Enter")
    shows(page, "histotitle", "^Histogram at " + re.escape(" ".join(here.split()[:2])))
    page.keyboard.press("Tab")
    playwright.expect(front).to_have_text(re.compile("of 256 points"))
    page.keyboard.press("ArrowUp")  # into the depth picture, whose mark goes with the keys
    assert page.evaluate(PIXELS, "depth") != plain
    page.keyboard.press("Tab")
    assert page.evaluate(PIXELS, "depth") == plain
    page.focus("#map")
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowRight")
    shows(page, "mapsay", r"^x -?\d\.\d+ m, y -?\d\.\d+ m: ")
    place = page.text_content("#mapsay").partition(" m:")[0].replace(" m,", ",")
    shows(page, "histotitle", "^Histogram at " + re.escape(place) + r" m \(kept")
    page.keyboard.press("Escape")
    shows(page, "histotitle", "last point")
    while page.evaluate("document.activeElement.id") != "scale":
        page.keyboard.press("Tab")
    page.keyboard.press("Space")  # a button that one came to is pressed, and does not play the scan
    shows(page, "scale", "linear")
    page.keyboard.press("3")
    page.wait_for_selector("#volume")
    page.wait_for_timeout(500)
    seen = [page.evaluate("document.getElementById('volume').toDataURL()")]
    page.focus("#volume")
    for key in ("ArrowLeft", "+", "Shift+ArrowUp", "Home"):
        page.keyboard.press(key)
        page.wait_for_timeout(100)
        seen.append(page.evaluate("document.getElementById('volume').toDataURL()"))
    assert len(set(seen)) == 4
    assert seen[0] == seen[-1]
    assert complaints == []
    page.close()


def test_depth_is_told_from_nothing_by_who_sees_no_colours(viewer: str, browser: Any) -> None:
    """The near end of the colours is as light as the paper: a line goes around what is seen."""
    page, complaints = opened(browser, viewer)
    page.wait_for_selector('body[data-picture="256"]')
    page.keyboard.press("2")
    page.wait_for_selector("#depth")
    darkest = page.evaluate(
        """() => { const c = document.createElement("canvas"); c.width = c.height = 64; const g = c.getContext("2d");
        g.fillStyle = `rgb(${PAPER})`; g.fillRect(0, 0, 64, 64);
        const p = {albedo: new Float32Array(16), depth_m: new Float32Array(16).fill(.5)}; p.albedo[5] = 1;
        outline(g, p, 4, 4, [0, 0, 64, 64]); const grey = (x, y) => g.getImageData(x, y, 1, 1).data[1];
        return [grey(24, 16), grey(16, 24), grey(24, 31), grey(31, 24)].concat([grey(24, 24), grey(48, 16)]); }"""
    )
    assert max(min(a, b) for a, b in (darkest[0:2], darkest[2:4])) < 160  # the paper is 224
    assert min(darkest[4:]) > 220
    assert complaints == []
    page.close()


def test_a_wall_is_as_wide_as_it_is_high_where_it_is_shown_larger_than_it_was_drawn(viewer: str, browser: Any) -> None:
    """On paper, for which no browser asks a page to draw anew: there the wall was stretched."""
    page, _ = opened(browser, viewer)
    page.wait_for_selector('body[data-picture="256"]')
    page.evaluate("map.draw = () => {}; $('map').style.cssText = 'width: 400px; height: 700px; max-height: none'")
    with Image.open(io.BytesIO(page.locator("#map").screenshot())) as shown:
        rgb = np.asarray(shown.convert("RGB")).astype(int)
    rows, cols = np.nonzero(np.ptp(rgb, axis=2) > 60)  # the colours of the wall and of the bar beside it
    assert np.ptp(cols) > 0.9 * np.ptp(rows)
    page.close()


def test_a_browser_without_scripts_is_not_kept_waiting(viewer: str, browser: Any) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(viewer)
    playwright.expect(page.locator("noscript p")).to_be_visible()
    assert page.get_by_text("connecting").is_hidden()  # it will not
    assert page.get_by_role("button").count() == 0
    context.close()


def test_what_is_chosen_is_seen_in_a_systems_own_colours(viewer: str, browser: Any) -> None:
    page = browser.new_page(forced_colors="active")
    page.set_default_timeout(PATIENCE_MS)
    page.goto(viewer)
    page.wait_for_selector("body[data-picture]")
    ground = "name => getComputedStyle(document.querySelector(`[data-view=${name}]:not(body)`)).backgroundColor"
    assert page.evaluate(ground, "both") != page.evaluate(ground, "depth")
    page.close()


def test_pictures_have_room_in_a_low_window_and_beside_long_names(folder: Path, browser: Any) -> None:
    """A small laptop's screen, enlarged a little."""
    names = ["n" * 180 + ".h5", "a\u202e<b>.h5"]
    for name in names:
        shutil.copy(folder / "run.h5", folder / name)
    with viewed(folder, *names, "--method", "lct") as url:
        page = browser.new_page(viewport={"width": 1000, "height": 520})
        page.set_default_timeout(PATIENCE_MS)
        page.goto(url)
        page.wait_for_selector("body[data-picture]")
        heights = page.evaluate("[...document.querySelectorAll('.panel canvas')].map(c => c.clientHeight)")
        assert len(heights) == 4
        assert min(heights) > 100
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
        assert "\u202e" not in page.inner_text("body")  # else the words behind it are read backwards: of the laser, too
        page.close()
