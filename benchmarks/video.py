"""A film watched as it is scanned: pictures a second, how late they are, and how many were dropped.

One JSON line a figure, for NANO and for LCT. 16 x 16 of 64 x 64 points a frame, another sixteenth each, are written at
0.4 ms a point, 9.8 frames a second, and `nlos live` shows them on two cores in Chromium, with the light of earlier
frames and trails. A picture's latency is from the moment at which its frame's last photons were written to the moment
at which the page has drawn it. `cpu_s` is processor time of the viewer, `browser_cpu_s` that of Chromium, which draws
without a GPU here: other programs change them less. The browser and what writes the samples have all processors that
this program may use, the viewer the first two of them: under `taskset -c 2,3` all share two.
"""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter

FRAMES, POINTS, DWELL_S = 96, 256, 0.4e-3
SCAN = f"""\
wall: {{width_m: 2.0, height_m: 2.0, rows: 64, cols: 64}}
pattern: serpentine
dwell_ms: {DWELL_S * 1e3}
histogram: {{bins: 512, bin_width_ps: 32, offset_ns: 10}}
frames: {FRAMES}
interleave: 16
"""
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
NOTED = """() => {
  window.noted = [];
  const shown = document.body.dataset;
  new MutationObserver(() => window.noted.push([+shown.picture, shown.method, Date.now()]))
    .observe(document.body, {attributeFilter: ["data-picture"]});
}"""


def main() -> None:
    if CHROMIUM is None or find_spec("playwright") is None:
        print("no Chromium, or no Playwright (pip install playwright): films are not watched", file=sys.stderr)
        return
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder) / "run.h5"
        run.with_suffix(".yaml").write_text(SCAN)
        subprocess.run(
            [sys.executable, "-m", "nlos", "scan", str(run.with_suffix(".yaml")), "--bench", "moving", "-o", str(run),
             "-q"], check=True, timeout=1800,
        )  # fmt: skip
        for method in ("nano", "lct"):
            shown = watched(run, Path(folder) / f"{method}.h5", method)
            figure("frames_per_s", method, shown["frames_per_s"], "1/s", 10.0, shown["frames_per_s"] >= 9.7)
            for name, unit, most in (
                ("latency_ms", "ms", 300.0),
                ("dropped", "frames", 0),
                ("cpu_s", "s a picture", 0.2),
                ("browser_cpu_s", "s a picture", 0.1),
            ):
                figure(name, method, shown[name], unit, most, shown[name] is not None and shown[name] <= most)


def watched(run: Path, grows: Path, method: str) -> dict[str, Any]:
    """What a page showed of a film that grew at the pace of its dwells."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    viewer = subprocess.Popen(
        [sys.executable, "-m", "nlos", "live", str(grows), "--method", method, "--constants", "none"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, preexec_fn=lambda: os.sched_setaffinity(0, cores),
    )  # fmt: skip
    assert viewer.stdout is not None
    url = viewer.stdout.readline().strip()
    written_s: dict[int, float] = {}

    def bench() -> None:
        with Recording.open(run) as recording:
            samples = list(recording.samples())
            writer = RecordingWriter.create(grows, recording.plan, recording.header)
            began_s = time.time()
            for count, sample in enumerate(samples, 1):
                time.sleep(max(0.0, began_s + count * DWELL_S - time.time()))
                writer.write(sample)
                written_s[count] = time.time()
            writer.finish(Status.COMPLETE)

    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        page.evaluate(NOTED)
        time.sleep(8)  # its libraries are loaded before a scan's first points are there, as they are on a lab's machine
        busy_s, drawing_s = cpu_s(viewer.pid), browser_s()
        thread = threading.Thread(target=bench)
        thread.start()
        while thread.is_alive():
            page.wait_for_timeout(200)
        busy_s, drawing_s = cpu_s(viewer.pid) - busy_s, browser_s() - drawing_s
        page.wait_for_timeout(1500)
        noted = [(int(count), float(at_ms) / 1e3) for count, of, at_ms in page.evaluate("window.noted") if of == method]
        page.screenshot(path=os.environ.get("NLOS_VIDEO_PICTURE", str(grows.with_suffix(".png"))))
        browser.close()
    viewer.send_signal(signal.SIGINT)
    viewer.wait(60)
    first_s = dict(reversed(noted))  # a picture is drawn again as the page changes
    running = [(count, first_s[count]) for count in sorted(first_s) if count < FRAMES * POINTS]
    if not running:
        return {
            "frames_per_s": 0.0,
            "latency_ms": None,
            "dropped": FRAMES,
            "due": FRAMES,
            "cpu_s": None,
            "browser_cpu_s": None,
        }
    due = FRAMES - running[0][0] // POINTS  # from the first picture by this method on
    late_ms = [1e3 * (at_s - written_s[count]) for count, at_s in running]
    took_s = (FRAMES * POINTS - running[0][0]) * DWELL_S
    return {
        "frames_per_s": round(len(running) / took_s, 2), "latency_ms": round(float(np.median(late_ms)), 1),
        "dropped": due - len(running), "due": due, "cpu_s": round(busy_s / max(len(running), 1), 3),
        "browser_cpu_s": round(drawing_s / max(len(running), 1), 3),
    }  # fmt: skip


def cpu_s(process: int) -> float:
    """Processor time that it has taken."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def browser_s() -> float:
    """Processor time that all processes of the browser have taken."""
    parents: dict[int, int] = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # one that has just ended
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
    ours = {os.getpid()}
    while more := {child for child, parent in parents.items() if parent in ours} - ours:
        ours |= more
    drawing = []
    for process in ours:
        with contextlib.suppress(OSError):
            if "chrom" in Path(f"/proc/{process}/comm").read_text():
                drawing.append(cpu_s(process))
    return sum(drawing)


def figure(name: str, method: str, value: float | None, unit: str, target: float, met: bool) -> None:
    print(json.dumps({"figure": name, "method": method, "value": value, "unit": unit, "target": target, "met": met}))


if __name__ == "__main__":
    main()
