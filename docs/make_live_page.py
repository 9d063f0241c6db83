"""Makes the screenshots of docs/live-page/ with Chromium: `python docs/make_live_page.py [FOLDER]`, minutes.

A recorded scan is written anew, at its own pace, into files that `nlos live` follows; every state is taken at three
widths, light and dark. Look at each picture before it is kept.
"""

import contextlib
import io
import itertools
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.cli.interrupts import BY_HAND

FOLDER = Path(__file__).parent / "live-page"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SIZES = {1280: 800, 1920: 1080, 420: 860}
SCHEMES = ("dark", "light")
PATIENCE_MS = 120_000.0
SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 64, cols: 64}
pattern: {kind: coarse_to_fine, batch: 64}
dwell_ms: 8
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""
DARK_SAMPLES = 1  # 8 ms without a photon where hundreds are expected are enough for the alarm


class Bench:
    """Hands out a recorded scan's samples at the pace at which they were taken, events with them."""

    def __init__(self, recording: Recording, grows: Path) -> None:
        self._samples = iter(recording.samples())
        self._total = len(recording)
        self._writer = RecordingWriter.create(grows, recording.plan, recording.header)
        self.count, self._now_s = 0, 0.0
        self.says("shutter", "opened")

    def takes(self, part: float) -> None:
        """Samples up to this part of the points, at their own pace."""
        began_s, before_s = time.monotonic(), self._now_s
        while self.count < part * self._total:
            sample = next(self._samples)
            self._writer.write(sample)
            self.count, self._now_s = self.count + 1, sample.taken_s
            time.sleep(max(0.0, began_s + self._now_s - before_s - time.monotonic()))
        self._writer.flush()

    def goes_dark(self) -> None:
        """Samples without a photon, until the alarm that a scan raises of them has paused it."""
        expected = 0.0
        for sample in itertools.islice(self._samples, DARK_SAMPLES):
            counted = sample.histogram
            expected += counted.total_count
            dark = replace(counted, counts=np.zeros_like(counted.counts), total_count=0)
            self._writer.write(replace(sample, histogram=dark))
            self.count, self._now_s = self.count + 1, sample.taken_s
        trouble = f"no photon where {expected:.0f} were expected"
        self.says("alarm", f"blank: {trouble}. The light is off and the scan is paused.")
        self.says("shutter", "closed: alarm: blank")
        self.says("scan", f"paused: alarm: {trouble}")

    def says(self, kind: str, text: str) -> None:
        self._writer.log(kind, text, self._now_s)
        self._writer.flush()

    def ends(self, recording: Recording) -> None:
        self.says("shutter", "closed: the scan is complete")
        self.says("scan", "complete")
        self._writer.finish(recording.status)


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name, sync_playwright() as started:
        there = Path(name)
        (there / "scan.yaml").write_text(SCAN)
        subprocess.run([sys.executable, "-m", "nlos", "scan", "scan.yaml", "-o", "run.h5", "-q"], cwd=there, check=True)
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        with Recording.open(there / "run.h5") as recording:
            with viewer(there / "scan.h5") as (_, url):
                watched(recording, there / "scan.h5", pages(browser, url), folder)
            with viewer(there / "dark.h5") as (_, url):
                bench, shown = Bench(recording, there / "dark.h5"), pages(browser, url)
                bench.takes(0.5)
                bench.goes_dark()
                seen(shown, bench.count)
                taken(shown, folder, "alarm")
            with viewer(there / "lamp.h5") as (process, url):
                bench, shown = Bench(recording, there / "lamp.h5"), pages(browser, url)
                bench.takes(0.3)
                seen(shown, 1)
                process.kill()
                time.sleep(4)
                taken(shown, folder, "killed")
        browser.close()


def watched(recording: Recording, grows: Path, shown: dict[tuple[int, str], Page], folder: Path) -> None:
    """One scan from its first points to its end."""
    bench = Bench(recording, grows)
    bench.takes(0.02)
    going_on = threading.Thread(target=bench.takes, args=(0.085,))
    going_on.start()
    taken(shown, folder, "before")
    going_on.join()
    bench.takes(0.11)
    seen(shown, 2)  # NANO's: LCT's would be replaced while the widths are taken one by one
    taken(shown, folder, "tenth")
    bench.takes(0.3)
    bench.says("signal", "SIGINT")
    bench.says("shutter", "closed: SIGINT")
    bench.says("scan", f"paused by {BY_HAND}")
    seen(shown, bench.count)
    taken(shown, folder, "paused")
    bench.says("scan", "resumed")
    bench.says("shutter", "opened")
    bench.takes(1.0)
    bench.ends(recording)
    seen(shown, len(recording))
    for page in shown.values():
        page.wait_for_selector("#slider", state="visible")
        while "ready" in page.locator("#first").inner_text():
            time.sleep(0.5)
    taken(shown, folder, "end")
    few = {which: page for which, page in shown.items() if which == (1280, "dark")}
    for key, name in (("3", "3d"), ("v", "3d-surface"), ("v", "3d-slices")):
        for page in few.values():
            page.keyboard.press(key)
        taken(few, folder, name)


@contextlib.contextmanager
def viewer(run: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """`nlos live` on a recording that is still to come, and its page's address."""
    process = subprocess.Popen(
        [sys.executable, "-m", "nlos", "live", str(run)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    try:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        time.sleep(8)  # its libraries are loaded
        yield process, url
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def pages(browser: Browser, url: str) -> dict[tuple[int, str], Page]:
    """The page at every width in every scheme."""
    shown = {}
    for (width, height), scheme in product(SIZES.items(), SCHEMES):
        page: Any = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
        page.set_default_timeout(PATIENCE_MS)
        page.goto(url)
        shown[width, scheme] = page
    return shown


def seen(shown: dict[tuple[int, str], Page], samples: int) -> None:
    """Returns when every page shows a picture of so many samples."""
    for page in shown.values():
        page.wait_for_selector("body[data-picture]")
        while int(page.evaluate("document.body.dataset.picture")) < samples:
            time.sleep(0.1)
        while samples > 1 and page.evaluate("document.body.dataset.method") != "nano":
            time.sleep(0.1)


def taken(shown: dict[tuple[int, str], Page], folder: Path, state: str) -> None:
    """Screenshots of what every page shows now; written once all are taken, as that takes longer than they do."""
    time.sleep(1)
    made = {which: page.screenshot(full_page=which[0] < 900) for which, page in shown.items()}
    for (width, scheme), picture in made.items():
        with Image.open(io.BytesIO(picture)) as image:
            image.convert("RGB").save(folder / f"{state}-{width}-{scheme}.webp", lossless=True, quality=100, method=6)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
