"""Signals, one to three of them and at any spacing, end a scan cleanly: the light is off before the mirror moves, by
the simulated table's own account; the file says how it ended; nothing is printed that only a programmer understands."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.verification import verify
from tests.acquisition.witnessed_bench import BENCHES as ALL
from tests.acquisition.witnessed_bench import bench_file, is_parked, witnessed

SOAK = os.environ.get("NLOS_SOAK") == "1"
SIGNALS = (signal.SIGTERM, signal.SIGTERM, signal.SIGINT)
SCAN = """\
wall: {width_m: 0.6, height_m: 0.6, rows: 32, cols: 32}
pattern: serpentine
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 40, offset_ns: 8}
"""
BENCHES = tuple(name for name in ALL if "no shutter" not in name)


def started(folder: Path, name: str) -> "subprocess.Popen[str]":
    (folder / "small.yaml").write_text(SCAN.replace("40", "32") if name != "S3" else SCAN)
    command = [sys.executable, "-m", "nlos", "scan", "small.yaml", "--bench", str(bench_file(folder, name))]
    return subprocess.Popen(
        [*command, "-o", "run.h5"], cwd=folder, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def tell(folder: Path, child: "subprocess.Popen[str]", number: signal.Signals) -> None:
    """Sends a signal, and writes into the table's own account that it is about to."""
    with (folder / "witness.txt").open("a") as file:
        file.write("0 signal\n")
    child.send_signal(number)


def check_light(lines: list[str]) -> None:
    """Dark at the end; never parked in the light; opened once more at most (by what was on its way) after a signal."""
    lit, told, opened_since = False, False, 0
    for line in lines:
        if line == "signal":
            told = True
        elif line.startswith("shutter"):
            lit = line == "shutter open"
            opened_since += lit and told
        elif told and is_parked(line):
            assert not lit, "parked with the light on"
    assert not lit
    assert opened_since <= 1


@pytest.mark.sampled(2)
@pytest.mark.soak
@pytest.mark.parametrize("seed", range(500 if SOAK else 7))
def test_a_scan_that_is_told_to_end_ends_cleanly(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)
    name = sorted(BENCHES)[seed % len(BENCHES)]
    child = started(tmp_path, name)
    try:
        deadline_s = time.monotonic() + 240
        while "shutter open" not in witnessed(tmp_path) and child.poll() is None and time.monotonic() < deadline_s:
            time.sleep(0.01)
        time.sleep(draw.uniform(0.0, 1.0))
        sent = [draw.choice(SIGNALS) for _ in range(draw.randint(1, 3))]
        for number in sent:
            if child.poll() is None:
                tell(tmp_path, child, number)
            time.sleep(draw.choice((0.0, 0.0005, 0.002, 0.01, 0.1)))
        said = child.communicate(timeout=240)[1]
    finally:
        child.kill()
    assert child.returncode in (0, 130, 143, -signal.SIGTERM), said
    assert "Traceback" not in said
    assert "Exception ignored" not in said
    check_light(witnessed(tmp_path))
    try:
        with Recording.open(tmp_path / "run.h5") as recording:
            status = recording.status
    except (InvalidData, FileNotFoundError):
        pytest.fail("light was on, and there is no recording")
    assert status is (Status.COMPLETE if verify(tmp_path / "run.h5").complete else Status.INTERRUPTED)
    assert not (tmp_path / "run.h5.lock").exists()
