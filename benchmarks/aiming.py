"""Aiming by hand: updates a second on the screen of `nlos jog` and `nlos monitor`, and how late a photon is there.

One JSON line a figure. The bench is the simulated one at the computer's pace, its screen a pseudo-terminal. Late: from
the moment at which the light begins, by the simulated table's own account, to the first screen that shows its counts.
"""

import json
import os
import pty
import re
import select
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from nlos.configs.load import find

_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
_DETECTOR = re.compile(r"detector\s+([0-9.]+) (k?)counts/s")
_BRIGHT_CPS = 5e3
_BEGINNINGS = 12


def main() -> None:
    for verb in ("jog", "monitor"):
        with tempfile.TemporaryDirectory() as folder:
            pace_hz, late_ms = measured(Path(folder), verb)
        figure(f"{verb}_updates_per_s", pace_hz, "1/s", 10, at_least=True)
        figure(f"{verb}_photon_to_screen_ms", late_ms, "ms", 150, at_least=False)


def measured(folder: Path, verb: str) -> tuple[float, float]:
    """Updates a second over all screens, and the 95th percentile of how late light is seen, in ms."""
    text = find("bench", "simulated").read_text()
    text = text.replace("simulation:\n", f"simulation:\n  witness: {folder / 'witness.txt'}\n")
    (folder / "bench.yaml").write_text(text)
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "nlos", verb, "--bench", "bench.yaml"], cwd=folder, stdin=theirs, stdout=theirs,
        stderr=theirs, start_new_session=True, env={**os.environ, "COLUMNS": "110", "LINES": "36"},
    )  # fmt: skip
    os.close(theirs)
    frames: list[tuple[float, float | None]] = []
    late_ms: list[float] = []
    read_until(ours, frames, lambda: len(frames) >= 10)
    for _ in range(_BEGINNINGS):
        before = len(frames)
        os.write(ours, b" ")
        read_until(ours, frames, lambda seen=before: any((f[1] or 0) > _BRIGHT_CPS for f in frames[seen:]))
        shown_s = next(when for when, cps in frames[before:] if (cps or 0) > _BRIGHT_CPS)
        late_ms.append((shown_s - light_began_s(folder, child.pid)) * 1e3)
        ends_s = time.monotonic() + 1.5  # the key's time is over, and what was summed is gone
        read_until(ours, frames, lambda until_s=ends_s: time.monotonic() > until_s)
    os.write(ours, b"q")
    read_until(ours, frames, lambda: child.poll() is not None)
    os.close(ours)
    pace_hz = (len(frames) - 1) / (frames[-1][0] - frames[0][0])
    return pace_hz, statistics.quantiles(late_ms, n=20)[-1]


def light_began_s(folder: Path, pid: int) -> float:
    """When the shutter opened last, on this computer's clock: the witness's file was written then."""
    lines = (folder / "witness.txt").read_text().splitlines()
    _when, last = lines[-1].split(" ", 1)
    assert last == "shutter open", last
    return os.stat(folder / "witness.txt").st_mtime - time.time() + time.monotonic()


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
