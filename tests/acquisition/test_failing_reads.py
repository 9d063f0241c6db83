"""A disk that gives one part of a recording and not another: it cannot be read, which is said; the process lives."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.writer import RecordingWriter
from tests.acquisition.failing_reads import OPENED, REFUSED

PROGRAM = Path(__file__).with_name("failing_reads.py")
pytestmark = pytest.mark.skipif(not hasattr(os, "pread"), reason="it is pread that fails here")


def test_a_recording_of_which_any_one_read_fails_is_refused_and_the_process_lives(
    run_path: Path, small_plan: Callable[..., ScanPlan]
) -> None:
    """For good, or until it is asked for again."""
    RecordingWriter.create(run_path, small_plan(4, 4), Header()).finish(Status.INTERRUPTED)
    ended = subprocess.run([sys.executable, "-P", PROGRAM, run_path], capture_output=True, text=True, timeout=240)
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert len(found["for_good"]) > 3
    assert set(found["for_good"].values()) == {REFUSED}, found
    assert set(found["once"]) == {REFUSED}, found
    assert found["sound"] == OPENED


KEPT = """\
import itertools, os, sys
from pathlib import Path
from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.open_file import open_scan_file

reads, pread, good = itertools.count(), os.pread, int(sys.argv[2])

def fails(fd, size, place):
    if next(reads) >= good:
        raise OSError(5, "Input/output error")
    return pread(fd, size, place)

os.pread = fails
try:
    open_scan_file(Path(sys.argv[1]))
except StorageError as error:
    sys.kept = error
"""


@pytest.mark.parametrize("good", [1, 3])
def test_an_error_that_is_kept_until_the_process_ends_does_not_crash_it(
    run_path: Path, small_plan: Callable[..., ScanPlan], good: int
) -> None:
    RecordingWriter.create(run_path, small_plan(4, 4), Header()).finish(Status.INTERRUPTED)
    ended = subprocess.run(
        [sys.executable, "-c", KEPT, run_path, str(good)], capture_output=True, text=True, timeout=240
    )
    assert (ended.returncode, ended.stderr) == (0, "")
