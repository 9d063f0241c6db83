"""The pages that are files - reports, runs, archives, examinations - on a narrow screen, on paper, without a script."""

from collections.abc import Callable
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from nlos.__main__ import run
from nlos.acquisition.recording.recording import Status
from nlos.cli.archive_page import page as archive_page
from nlos.cli.benches import load_bench
from nlos.doctor.findings import passed
from nlos.doctor.page import write_page as write_examination
from nlos.drivers.identity import DeviceIdentity
from nlos.live.web import Request
from nlos.runs.index import RunsIndex
from nlos.runs.page import write_page as write_runs
from nlos.series.journal import ALARM, Journal
from nlos.status_page import OLD_S, StatusPage, body
from tests.chromium import needs_chromium
from tests.nlos.test_status_page import growing

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
pytestmark = needs_chromium

SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
LONG = "a-name-without-any-room-" * 4
LUMA = """name => { const [r, g, b] = getComputedStyle(document.body)[name].match(/[\\d.]+/g).map(Number);
  return (.299 * r + .587 * g + .114 * b) / 255; }"""
BROKEN = """() => [...document.querySelectorAll("td:not(:last-child), th")].filter(cell => { // words on two lines
  const range = document.createRange(); return [...cell.textContent.matchAll(/\\S+/g)].some(word => {
    if (word[0].length > 40) return false;
    range.setStart(cell.firstChild, word.index); range.setEnd(cell.firstChild, word.index + word[0].length);
    return range.getClientRects().length > 1; }); }).map(cell => cell.textContent)"""


def an_archive(folder: Path) -> Path:
    done = {"file": "a.h5", "folder": "a", "outcome": "partial", "reason": LONG, "seconds": 1.0, "method": "lct"}
    missing = {"file": f"{LONG}.h5", "outcome": "failed", "reason": f"{LONG}.h5: of no format that is read here"}
    (folder / "index.html").write_text(archive_page([done, missing]), encoding="utf-8")
    return folder / "index.html"


def runs(folder: Path) -> Path:
    growing(folder / f"{LONG}.h5", 30).finish(Status.COMPLETE)
    with RunsIndex(folder, folder / "index.sqlite") as index:
        index.update()
        write_runs(folder / "runs.html", folder, index.search(), "")
    return folder / "runs.html"


def an_examination(folder: Path) -> Path:
    met = {
        role: DeviceIdentity("triggerscope", "ARC", "TriggerScope 16 R4 Board 4B", "not told", "v.620-MM")
        for role in ("mirror", "counter")
    }
    findings = [passed("reconstruction", f"lct in 0.02 s of {LONG}")]
    write_examination(folder / "day.html", load_bench(None), findings, met, True)
    return folder / "day.html"


def the_corridor(folder: Path) -> Path:
    (folder / "night").mkdir()
    journal = Journal(folder / "night")
    journal.plan({f"1-{LONG}": 10.0, "2-cap": 10.0})
    journal.add("2-cap", ALARM, message=f"{LONG}: too bright")
    style = (files("nlos.runs") / "page.css").read_text(encoding="utf-8")
    (folder / "corridor.html").write_text(
        f'<!doctype html><meta name="viewport" content="width=device-width, initial-scale=1"><style>{style}</style>'
        f"<body>{body(folder)}</body>"
    )
    return folder / "corridor.html"


@pytest.mark.parametrize("made", [an_archive, runs, an_examination, the_corridor])
def test_a_page_fits_a_telephone_and_is_printed_dark_on_white(
    made: Callable[[Path], Path], browser: Any, tmp_path: Path
) -> None:
    page = browser.new_page(viewport={"width": 320, "height": 640}, color_scheme="dark")
    page.goto(made(tmp_path).as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= 320
    assert page.evaluate(BROKEN) == []
    assert page.evaluate(LUMA, "color") > 0.8
    page.emulate_media(media="print")
    assert page.evaluate(LUMA, "color") < 0.2
    page.emulate_media(media="screen", color_scheme="light")
    assert page.evaluate(LUMA, "color") < 0.2
    page.close()


def test_the_page_in_the_corridor_says_that_it_is_old_where_no_newer_one_comes(browser: Any, tmp_path: Path) -> None:
    """A browser that asks a computer which hangs shows what it had: it said for ever that no scan was under way."""
    corridor = StatusPage(tmp_path, "corridor-corridor", {"here"})
    for query, is_told in (({}, True), ({"still": "1"}, False)):
        answer = corridor(Request("/corridor-corridor/", query, "here"))
        (tmp_path / "corridor.html").write_bytes(answer.body.replace(b"http-equiv", b"data-held"))
        page = browser.new_page()
        page.goto((tmp_path / "corridor.html").as_uri())
        assert not page.get_by_text("No answer").is_visible()
        assert page.evaluate("document.getAnimations().map(each => each.effect.getTiming().delay)") == (
            [1000 * OLD_S] if is_told else []
        )
        page.evaluate("document.getAnimations().forEach(each => each.finish())")
        assert page.get_by_text("No answer: what is below is old").is_visible() == is_told
        page.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    (folder / "scan.yaml").write_text(SCAN)
    with pytest.MonkeyPatch.context() as here:
        here.chdir(folder)
        assert run(["scan", "scan.yaml", "-o", "run.h5"]) == 0
        assert run(["report", "run.h5", "-o", "run.html", "--methods", "lct"]) == 0
    return folder / "run.html"


def test_a_report_breaks_no_word_and_leaves_its_figures_room_on_paper(report: Path, browser: Any) -> None:
    page = browser.new_page(viewport={"width": 680, "height": 900})
    page.goto(report.as_uri())
    assert page.evaluate(BROKEN) == []
    page.emulate_media(media="print")
    narrowest = page.evaluate(
        "Math.min(...[...document.querySelectorAll('th + td')].map(c => c.offsetWidth / c.parentNode.offsetWidth))"
    )
    assert narrowest > 0.4
    page.close()


def test_a_report_shows_its_points_in_space_without_a_script(report: Path, browser: Any) -> None:
    context = browser.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(report.as_uri())
    assert page.locator(".still img").is_visible()
    assert page.locator("iframe").is_hidden()
    context.close()


def sent(file: Path, headers: dict[str, str], route: Any) -> None:
    route.fulfill(path=file, headers=headers)


def test_a_view_in_space_says_why_it_is_empty_where_scripts_are_kept_from_running(report: Path, browser: Any) -> None:
    """By a policy of whoever sends a page: its scripts then count as running, and no noscript is shown."""
    policy = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"
    for headers, drawn in (({}, True), ({"Content-Security-Policy": policy}, False)):
        page = browser.new_page()
        page.route("**/*", partial(sent, report, headers))
        page.goto("http://sent.example/run.html")
        view = page.frame_locator("iframe")
        playwright.expect(view.get_by_text("drawn by a script")).to_be_visible(visible=not drawn)
        playwright.expect(view.get_by_role("button", name="Save as PNG")).to_be_visible(visible=drawn)
        page.close()
