"""Aiming by hand: updates a second on the screen of `nlos jog` and `nlos monitor`, and how late a photon is there.

One JSON line a figure. The bench is the simulated one at the computer's pace, its screen a pseudo-terminal, and with
`--live` a page in Chromium as well. Late: from the moment at which the light begins, by the simulated table's own
account, to the first screen that shows its counts; in the browser, to the frame after the one that draws them.
"""

import json
import os
import pty
import re
import select
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from nlos.configs.load import find

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
_DETECTOR = re.compile(r"detector\s+([0-9.]+) (k?)counts/s")
_ADDRESS = re.compile(rb"http://[^ \r\n\x1b]+/")
_RECORD = """() => { window.seen = []; let last = 0; const look = () => {
  if (has !== last && now && now.detector_hz !== undefined) { const number = last = has, cps = now.detector_hz;
    requestAnimationFrame(() => seen.push([performance.timeOrigin + performance.now(), cps, number])); }
  requestAnimationFrame(look); }; look(); }"""
"""Every update at the beginning of the frame after the one that drew it: then it is on the screen."""
_BRIGHT_CPS = 5e3
_BEGINNINGS = 21
"""The first is not counted: the simulated table computes then what is seen of that place."""


def main() -> None:
    for verb in ("jog", "monitor"):
        with tempfile.TemporaryDirectory() as folder:
            pace_hz, late_ms = measured(Path(folder), verb)
        figure(f"{verb}_updates_per_s", pace_hz, "1/s", 10, at_least=True)
        figure(f"{verb}_photon_to_screen_ms", late_ms, "ms", 150, at_least=False)
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        print("no Chromium: the page is not measured", file=sys.stderr)
        return
    for verb in ("jog", "monitor"):
        with tempfile.TemporaryDirectory() as folder:
            pace_hz, late_ms = measured_in(chromium, Path(folder), verb)
        figure(f"{verb}_page_updates_per_s", pace_hz, "1/s", 10, at_least=True)
        figure(f"{verb}_page_photon_to_screen_ms", late_ms, "ms", 150, at_least=False)


@contextmanager
def at_a_terminal(folder: Path, verb: str, *words: str) -> Iterator[tuple[int, "subprocess.Popen[bytes]"]]:
    """The verb on a bench that keeps an account of its light, and the other end of its terminal."""
    text = find("bench", "simulated").read_text()
    text = text.replace("simulation:\n", f"simulation:\n  witness: {folder / 'witness.txt'}\n")
    (folder / "bench.yaml").write_text(text)
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "nlos", verb, "--bench", "bench.yaml", *words], cwd=folder, stdin=theirs, stdout=theirs,
        stderr=theirs, start_new_session=True, env={**os.environ, "COLUMNS": "110", "LINES": "36"},
    )  # fmt: skip
    os.close(theirs)
    try:
        yield ours, child
    finally:
        child.kill()
        child.wait()
        os.close(ours)


def measured(folder: Path, verb: str) -> tuple[float, float]:
    """Updates a second over all screens, and the 95th percentile of how late light is seen, in ms."""
    frames: list[tuple[float, float | None]] = []
    late_ms: list[float] = []
    with at_a_terminal(folder, verb) as (ours, child):
        read_until(ours, frames, lambda: len(frames) >= 10)
        for _ in range(_BEGINNINGS):
            before = len(frames)
            os.write(ours, b" ")
            read_until(ours, frames, lambda seen=before: any((f[1] or 0) > _BRIGHT_CPS for f in frames[seen:]))
            shown_s = next(when for when, cps in frames[before:] if (cps or 0) > _BRIGHT_CPS)
            late_ms.append((shown_s + time.time() - time.monotonic() - light_began_s(folder)) * 1e3)
            ends_s = time.monotonic() + 1.5  # the key's time is over, and what was summed is gone
            read_until(ours, frames, lambda until_s=ends_s: time.monotonic() > until_s)
        os.write(ours, b"q")
        read_until(ours, frames, lambda: child.poll() is not None)
    pace_hz = (len(frames) - 1) / (frames[-1][0] - frames[0][0])
    return pace_hz, statistics.quantiles(late_ms[1:], n=20, method="inclusive")[-1]


def measured_in(chromium: str, folder: Path, verb: str) -> tuple[float, float]:
    """The same two figures for the page in a browser, while the terminal is drawn as well."""
    from playwright.sync_api import sync_playwright

    late_ms: list[float] = []
    screens: list[tuple[float, float | None]] = []
    said = bytearray()
    with at_a_terminal(folder, verb, "--live") as (ours, _child), sync_playwright() as started:
        until_s = time.monotonic() + 30
        while not (found := _ADDRESS.search(said)):
            assert time.monotonic() < until_s, said
            if select.select([ours], [], [], 0.02)[0]:
                said += os.read(ours, 65536)
        browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(found.group().decode())
        page.evaluate(_RECORD)
        read_for(ours, screens, 2.0)
        for _ in range(_BEGINNINGS):
            os.write(ours, b" ")
            read_for(ours, screens, 2.3)
            began_s = light_began_s(folder, ended=True)
            late_ms.append(
                next(when for when, bright in shown(page) if bright and when > began_s * 1e3) - began_s * 1e3
            )
        pace_hz = float(
            page.evaluate("(seen[seen.length - 1][2] - seen[0][2]) * 1e3 / (seen[seen.length - 1][0] - seen[0][0])")
        )
        os.write(ours, b"q")
        read_for(ours, screens, 0.5)
        browser.close()
    return pace_hz, statistics.quantiles(late_ms[1:], n=20, method="inclusive")[-1]


def shown(page: Any) -> list[tuple[float, bool]]:
    """Frames of the page: ms since 1970, and whether the detector's rate there is one of light."""
    frames = page.evaluate("seen")
    return [(when, cps > _BRIGHT_CPS) for when, cps, _ in frames]


def read_for(terminal: int, frames: list[tuple[float, float | None]], seconds: float) -> None:
    """What the terminal says in that time."""
    ends_s = time.monotonic() + seconds
    read_until(terminal, frames, lambda: time.monotonic() > ends_s)


def light_began_s(folder: Path, ended: bool = False) -> float:
    """When the shutter opened last, in seconds since 1970: the table's file was written then, or when it closed."""
    lines = (folder / "witness.txt").read_text().splitlines()
    said = [(float(when), what) for when, what in (line.split(" ", 1) for line in lines) if what.startswith("shutter")]
    assert said[-1][1] == ("shutter closed" if ended else "shutter open"), said
    lit_s = said[-1][0] - max(when for when, what in said if what == "shutter open")
    return os.stat(folder / "witness.txt").st_mtime - lit_s


def read_until(terminal: int, frames: list[tuple[float, float | None]], over: "object") -> None:
    """Screens as they come, each with its time and the detector's rate that it shows."""
    until_s = time.monotonic() + 30
    while not over():  # type: ignore[operator]
        assert time.monotonic() < until_s, "no screen that was waited for"
        if not select.select([terminal], [], [], 0.02)[0]:
            continue
        try:
            data = os.read(terminal, 65536)
        except OSError:
            return
        if b"\x1b[H" in data:
            found = _DETECTOR.findall(_CONTROL.sub("", data.decode("utf-8", "replace")))
            cps = float(found[-1][0]) * (1e3 if found[-1][1] else 1.0) if found else None
            frames.append((time.monotonic(), cps))


def figure(name: str, value: float, unit: str, target: float, *, at_least: bool) -> None:
    met = value >= target if at_least else value <= target
    print(
        json.dumps({"figure": name, "value": round(value, 2), "unit": unit, "target": target, "met": met}), flush=True
    )


if __name__ == "__main__":
    main()
