"""Whatever happens to the processes that watch a scan, the scan takes the same samples in the same time."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]

SCAN = """\
wall: {{width_m: 1.0, height_m: 1.0, rows: {side}, cols: {side}}}
pattern: {{kind: coarse_to_fine, batch: {side}}}
dwell_ms: {dwell_ms}
histogram: {{bins: 512, bin_width_ps: 32, offset_ns: 10}}
"""
SOAK = bool(os.environ.get("NLOS_SOAK"))
STOPPED_S = 30.0 if SOAK else 0.3


@contextlib.contextmanager
def harmed(pid: int, harm: str) -> Iterator[None]:
    """The process killed at once, stopped for a while, or let run a tenth of the time."""
    over = threading.Event()

    def slow_down() -> None:
        with contextlib.suppress(ProcessLookupError):
            while not over.is_set():
                os.kill(pid, signal.SIGSTOP)
                over.wait(0.09)
                os.kill(pid, signal.SIGCONT)
                over.wait(0.01)

    def stop() -> None:
        os.kill(pid, signal.SIGSTOP)
        time.sleep(STOPPED_S)
        os.kill(pid, signal.SIGCONT)

    if harm == "killed":
        os.kill(pid, signal.SIGKILL)
        yield
        return
    thread = threading.Thread(target=slow_down if harm == "slow" else stop)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def same_samples(one: Path, other: Path) -> bool:
    with Recording.open(one) as a, Recording.open(other) as b:
        fields = ["number", "taken_s", "live_time_s", "sync_count", "total_count"]
        alike = np.array_equal(a.records[fields], b.records[fields]) and a.status == b.status
        return len(a) == len(a.plan) and alike and np.array_equal(a.counts_of(0, len(a)), b.counts_of(0, len(b)))


@pytest.mark.soak
@pytest.mark.parametrize("harm", ["killed", "stopped", "slow"])
def test_a_scan_loses_neither_samples_nor_time_when_its_page_is_harmed(nlos: Nlos, tmp_path: Path, harm: str) -> None:
    (tmp_path / "scan.yaml").write_text(SCAN.format(side=64, dwell_ms=1) if SOAK else SCAN.format(side=16, dwell_ms=20))
    alone = json.loads(nlos("scan", "scan.yaml", "-o", "alone.h5", "--json").stdout)
    watched = subprocess.Popen(
        [sys.executable, "-m", "nlos", "scan", "scan.yaml", "-o", "watched.h5", "--live", "--json"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert watched.stderr is not None
    while "live: http" not in (line := watched.stderr.readline()):
        assert line, "the scan ended without saying where its page is"
    children = Path(f"/proc/{watched.pid}/task/{watched.pid}/children")
    if not children.exists():
        watched.communicate(timeout=240)
        pytest.skip("this kernel does not say which process is whose child")
    with harmed(int(children.read_text().split()[0]), harm):
        out, err = watched.communicate(timeout=240)
    assert watched.returncode == 0, err
    answer = json.loads(out)
    with contextlib.suppress(ProcessLookupError):  # the one that was killed, once somebody has waited for it
        os.kill(answer["live"]["pid"], signal.SIGKILL)
    assert answer["bench_s"] == pytest.approx(alone["bench_s"], abs=1e-6)
    assert same_samples(tmp_path / "watched.h5", tmp_path / "alone.h5")


@pytest.mark.soak
@pytest.mark.parametrize("harm", ["killed", "stopped", "slow"] if SOAK else ["stopped"])
def test_a_harmed_follower_has_every_sample_in_the_end(nlos: Nlos, tmp_path: Path, harm: str) -> None:
    """The recording grows at a real bench's pace; a follower that was killed is restarted, as a person would."""
    (tmp_path / "scan.yaml").write_text(SCAN.format(side=16, dwell_ms=160 if SOAK else 10))
    assert nlos("scan", "scan.yaml", "-o", "run.h5").returncode == 0
    follow = [sys.executable, "-m", "nlos", "reconstruct", "grows.h5", "--follow", "-o", "live", "--json"]
    bench = subprocess.Popen(
        [sys.executable, "-m", "nlos", "replay", "run.h5", "-o", "grows.h5", "-q"], cwd=tmp_path, text=True
    )
    follower = subprocess.Popen(follow, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    with harmed(follower.pid, harm):
        assert bench.wait(240) == 0
    if harm == "killed":
        assert follower.wait(240) == -signal.SIGKILL
        follower = subprocess.Popen(
            [*follow, "--overwrite"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
    out, err = follower.communicate(timeout=240)
    assert follower.returncode == 0, err
    assert json.loads(out)["points"] == 256
    assert same_samples(tmp_path / "grows.h5", tmp_path / "run.h5")
