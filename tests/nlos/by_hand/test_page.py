"""The page of `nlos monitor` and `nlos jog`: what the terminal shows, to whoever has its address; it can do nothing."""

import base64
import http.client
import json
import os
import re
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest

from tests.nlos.by_hand.at_a_terminal import AtATerminal, at_a_terminal
from tests.nlos.by_hand.witness import account, bench_file

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PATIENCE_S = 30.0


@pytest.fixture
def monitor(tmp_path: Path) -> Iterator[AtATerminal]:
    words = ["monitor", "--bench", str(bench_file(tmp_path)), "--live", "--at", "0.2", "-0.1"]
    with at_a_terminal(tmp_path, *words) as child:
        yield child


def address(child: AtATerminal) -> str:
    child.wait_for("page        http")
    found = re.search(r"http://127\.0\.0\.1:\d+/[\w-]+/", child.said)
    assert found is not None
    return found.group()


def asked(url: str, what: str = "newest", method: str = "GET", host: str | None = None) -> tuple[int, bytes]:
    there = urlsplit(url)
    line = http.client.HTTPConnection("127.0.0.1", there.port or 0, timeout=10)
    try:
        line.request(method, there.path + what, headers={} if host is None else {"Host": host})
        answer = line.getresponse()
        return answer.status, answer.read()
    finally:
        line.close()


def newest(url: str, holds: Callable[[dict[str, Any]], bool] = lambda update: True) -> dict[str, Any]:
    """The first update of which that holds."""
    until_s, has = time.monotonic() + PATIENCE_S, 0
    while time.monotonic() < until_s:
        update = json.loads(asked(url, f"newest?has={has}")[1])
        has = update.get("number", has)
        if update and holds(update):
            return dict(update)
    raise AssertionError("never said what was waited for")


def pages_of(child: AtATerminal) -> list[int]:
    """Processes that it has started."""
    return [
        int(pid) for pid in Path(f"/proc/{child.process.pid}/task/{child.process.pid}/children").read_text().split()
    ]


def is_there(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_it_shows_what_the_terminal_shows_and_says_when_it_is_over(tmp_path: Path, monitor: AtATerminal) -> None:
    url = address(monitor)
    dark = newest(url, lambda update: "sync_hz" in update)
    assert dark["sync_hz"] == pytest.approx(10e6, rel=1e-3)
    assert (dark["x_m"], dark["y_m"]) == pytest.approx((0.2, -0.1))
    assert not dark["lit"]
    assert not account(tmp_path).lit
    monitor.press(" ")
    lit = newest(url, lambda update: update["lit"] and update["direct_ns"] is not None)
    counts = np.frombuffer(base64.b64decode(lit["counts"]["f4"]), "<f4")
    assert lit["start_ns"] + counts.argmax() * lit["bin_ns"] == pytest.approx(lit["direct_ns"], abs=0.05)
    assert lit["direct_ns"] == pytest.approx(13.77, abs=0.05)
    assert lit["light"].startswith("LIGHT ON")
    newest(url, lambda update: not update["lit"])
    monitor.press("q")
    assert newest(url, lambda update: "over" in update)["over"] == ["It has ended", "The light is off.", "good"]
    assert monitor.ends() == 0


def test_only_who_has_the_address_may_look_and_nobody_can_do_anything(tmp_path: Path, monitor: AtATerminal) -> None:
    url = address(monitor)
    newest(url)
    port = urlsplit(url).port
    stranger = url[:-3] + ("AA/" if not url.endswith("AA/") else "BB/")
    assert asked(stranger)[0] == 403
    assert asked(url, host="rebound.example")[0] == 403
    for method in ("POST", "PUT", "DELETE"):
        assert asked(url, method=method)[0] == 405
    for what in ("light?seconds=5", "open", "../etc/passwd", "newest?has=-1", f"newest?has={'9' * 300}"):
        assert asked(url, what)[0] in (200, 403, 404)
    status, body = asked(url, "")
    assert status == 200
    assert b"http" not in body.replace(b"http-equiv", b"")  # nothing is loaded from elsewhere
    assert port is not None
    monitor.press("q")
    assert monitor.ends() == 0
    assert not account(tmp_path).lit


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_page_that_ends_or_hangs_changes_nothing(tmp_path: Path, monitor: AtATerminal, how: signal.Signals) -> None:
    newest(address(monitor))
    (page,) = pages_of(monitor)
    os.kill(page, how)
    shown = len(monitor.frames)
    monitor.wait_until(lambda: len(monitor.frames) > shown + 20, "twenty more screens")
    monitor.press(" ")
    monitor.wait_for("light       ON")
    monitor.wait_until(lambda: account(tmp_path).ends_dark and bool(account(tmp_path).lit), "the light off again")
    monitor.press("q")
    assert monitor.ends() == 0
    assert not is_there(page)


def test_a_program_that_was_killed_is_said_to_have_been(monitor: AtATerminal) -> None:
    url = address(monitor)
    newest(url)
    (page,) = pages_of(monitor)
    monitor.signal(signal.SIGKILL)
    assert "the light may be on" in newest(url, lambda update: "over" in update)["over"][0]
    until_s = time.monotonic() + PATIENCE_S
    while is_there(page) and time.monotonic() < until_s:
        time.sleep(0.05)
    assert not is_there(page)


def test_a_page_without_visitors_ends_with_the_program(monitor: AtATerminal) -> None:
    address(monitor)
    monitor.wait_until(lambda: bool(pages_of(monitor)), "the page's process")
    (page,) = pages_of(monitor)
    monitor.press("q")
    assert monitor.ends() == 0
    assert not is_there(page)


def test_what_jog_does_is_on_its_page(tmp_path: Path) -> None:
    with at_a_terminal(tmp_path, "jog", "--bench", str(bench_file(tmp_path)), "--live") as child:
        url = address(child)
        newest(url)
        child.press("right", "up")
        moved = newest(url, lambda update: update["y_deg"] > 0)
        assert (moved["x_deg"], moved["y_deg"]) == pytest.approx((0.1, 0.1))
        child.press("q")
        assert child.ends() == 0


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_a_person_sees_it_in_a_browser(tmp_path: Path, monitor: AtATerminal) -> None:
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    url = address(monitor)
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page, complaints = browser.new_page(viewport={"width": 1200, "height": 800}), []
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        page.set_default_timeout(PATIENCE_S * 1e3)
        page.goto(url)

        def shows(name: str, pattern: str) -> None:
            found = playwright.expect(page.locator(f"#{name}"))
            found.to_have_text(re.compile(pattern), timeout=PATIENCE_S * 1e3)

        shows("sync", r"10\.00 MHz")
        shows("light", "light off")
        shows("place", r"\+0\.200 −0\.100 m")
        page.keyboard.press(" ")  # a page has no key for light
        monitor.press(" ")
        shows("light", "LIGHT ON")
        shows("detector", r"kcounts/s")
        shows("fwhm", r"\d\d ps")
        shows("at", r"at 13\.7\d\d ns")
        shows("light", "light off")
        page.keyboard.press("l")
        shows("scale", "linear")
        monitor.signal(signal.SIGSTOP)
        shows("banner", "No update")
        monitor.signal(signal.SIGCONT)
        playwright.expect(page.locator("#banner")).to_be_hidden(timeout=PATIENCE_S * 1e3)
        page.route("**/newest*", lambda route: None)  # a line that was cut, of which nobody hears
        page.wait_for_timeout(300)
        page.evaluate("heard_s -= SILENT_S")
        shows("banner", "The page is no longer told")
        shows("light", "no answer")
        page.unroute("**/newest*")
        playwright.expect(page.locator("#banner")).to_be_hidden(timeout=PATIENCE_S * 1e3)
        monitor.press("q")
        assert monitor.ends() == 0
        shows("banner", r"It has ended.*The light is off")
        assert complaints == []
        browser.close()
    assert len(account(tmp_path).lit) == 1


@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="stops a process")
def test_light_that_was_on_when_last_seen_is_not_taken_for_off(tmp_path: Path) -> None:
    """Of a program that hangs with its light on the page hears nothing: it is as loud as before."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    words = ["monitor", "--bench", str(bench_file(tmp_path)), "--live", "--light", "60"]
    with playwright.sync_playwright() as started, at_a_terminal(tmp_path, *words) as child:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page()
        page.set_default_timeout(PATIENCE_S * 1e3)
        page.goto(address(child))
        light, banner = (playwright.expect(page.locator(f"#{name}")) for name in ("light", "banner"))
        light.to_have_text(re.compile("LIGHT ON"), timeout=PATIENCE_S * 1e3)
        child.signal(signal.SIGSTOP)
        light.to_have_text("LIGHT MAY BE ON: no update", timeout=PATIENCE_S * 1e3)
        light.to_have_class("on")
        banner.to_have_text(re.compile("No update.*treat it as on"))
        assert page.title().startswith("LIGHT MAY BE ON")
        page.route("**/newest*", lambda route: route.abort())
        light.to_have_text("LIGHT MAY BE ON: no answer", timeout=PATIENCE_S * 1e3)
        light.to_have_class("on")
        banner.to_have_text(re.compile("no longer told.*treat it as on"))
        browser.close()
