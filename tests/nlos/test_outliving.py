"""A command outlives its terminal: whatever happens to its streams, and whenever, it does what it would have done.
Where its results were sent to a file whose disk did not take them, its exit code says so."""

import errno
import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.verification import verify
from tests.acquisition.bad_disk_server import built_shim

SOAK = os.environ.get("NLOS_SOAK") == "1"
Nlos = Callable[..., "subprocess.CompletedProcess[str]"]
NLOS = f"{sys.executable} -m nlos"
SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 24, cols: 24}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 1024, bin_width_ps: 16, offset_ns: 10}
"""
STREAMS = {
    "no reader of stderr": "2> >(true)",
    "no reader of stdout": "> >(true)",
    "no reader of both": "2>&1 | true",
    "full stderr": "2> /dev/full",
    "full stdout": "> /dev/full",
    "both full": "> /dev/full 2> /dev/full",
    "closed stdin": "0<&-",
    "closed stdout": ">&-",
    "closed stderr": "2>&-",
    "all closed": "0<&- >&- 2>&-",
    "JSON to a full device": "--json > /dev/full",
}


def bash(command: str, folder: Path) -> int:
    """The exit code of the first command of the pipe; what it leaves open is its own business."""
    script = f"{command}\nexit ${{PIPESTATUS[0]}}"
    return subprocess.run(["bash", "-c", script], cwd=folder, timeout=240, env=os.environ | {"LANG": "C"}).returncode


def is_whole(path: Path) -> bool:
    found = verify(path)
    return found.complete and found.status is Status.COMPLETE


@pytest.mark.sampled(3)
@pytest.mark.parametrize("streams", STREAMS)
def test_a_scan_completes_whatever_its_streams_are(tmp_path: Path, streams: str) -> None:
    (tmp_path / "small.yaml").write_text(SCAN)
    lost = " > /dev/full" in f" {STREAMS[streams]}"
    assert bash(f"{NLOS} scan small.yaml -v -o run.h5 {STREAMS[streams]}", tmp_path) == (6 if lost else 0)
    assert is_whole(tmp_path / "run.h5")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "small.yaml").write_text(SCAN)
    assert bash(f"{NLOS} -q scan small.yaml -o run.h5 > /dev/null", folder) == 0
    return folder / "run.h5"


LONG_VERBS = {
    "replay": "replay {run} --speed max -o out.h5",
    "recover": "recover {run} -o out.h5",
    "export": "export {run} --to npz -o out.npz",
    "reconstruct": "reconstruct {run} -o out",
    "calibrate": "calibrate {run} -o out.h5",
    "report": "report {run} -o out.html",
    "doctor": "doctor",
    "plan": "plan small.yaml",
    "verify": "verify {run}",
    "info": "info {run}",
    "devices": "devices",
}


@pytest.mark.sampled(3)
@pytest.mark.soak
@pytest.mark.parametrize("verb", LONG_VERBS if SOAK else sorted(set(LONG_VERBS) - {"doctor", "report"}))
def test_other_verbs_end_with_the_code_that_they_would_have_ended_with(
    tmp_path: Path, recorded: Path, verb: str
) -> None:
    (tmp_path / "small.yaml").write_text(SCAN)
    command = f"{NLOS} {LONG_VERBS[verb].format(run=recorded)} -v"
    makes = next((word for word in command.split() if word.startswith("out")), None)
    if makes:
        command += " --overwrite"
    for streams in ("> /dev/full 2> /dev/full", "0<&- >&- 2>&-", "2>&1 | true")[: 3 if SOAK else 1]:
        assert bash(f"{command} {streams}", tmp_path) == (6 if "full" in streams else 0)
        assert makes is None or (tmp_path / makes).exists()


PRINTED = [
    "--version", "--help", "patterns", "patterns --json", "schema scan", "completion bash", "plan nothing --json",
]  # fmt: skip
"""Printed in every way that there is; the last has an error of its own."""


@pytest.mark.parametrize("words", PRINTED)
def test_results_that_their_disk_did_not_take_are_not_called_printed(tmp_path: Path, words: str) -> None:
    with open("/dev/full", "w") as full:
        ended = subprocess.run([*NLOS.split(), *words.split()], stdout=full, stderr=subprocess.PIPE, cwd=tmp_path)
    assert ended.returncode == (2 if "nothing" in words else 6)
    assert (
        ended.stderr.decode()
        .splitlines()[-1]
        .startswith("nlos: standard output: write error: No space left on device. What was printed there is not whole")
    )


@pytest.mark.parametrize("words", PRINTED[:-1])
def test_a_reader_that_has_seen_enough_is_no_error(tmp_path: Path, words: str) -> None:
    ended = subprocess.run(
        ["bash", "-c", f"{NLOS} {words} | true; exit ${{PIPESTATUS[0]}}"], stderr=subprocess.PIPE, cwd=tmp_path
    )
    assert (ended.returncode, ended.stderr) == (0, b"")


@pytest.mark.skipif(sys.platform == "win32", reason="its terminals do not hang up")
@pytest.mark.parametrize("words", ["patterns", "schema scan --json"])
def test_a_terminal_that_hung_up_before_the_command_began_is_no_full_disk(tmp_path: Path, words: str) -> None:
    """What was begun in the background, to come after something else."""
    ours, theirs = os.openpty()
    os.close(ours)
    ended = subprocess.run([*NLOS.split(), *words.split()], stdout=theirs, stderr=subprocess.PIPE, cwd=tmp_path)
    os.close(theirs)
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_a_document_that_a_limit_cut_is_not_called_printed(tmp_path: Path) -> None:
    script = f"ulimit -f 1; {NLOS} schema scan > scan.json"
    ended = subprocess.run(["bash", "-c", script], stderr=subprocess.PIPE, cwd=tmp_path)
    assert ended.returncode == 6
    assert b"write error: File too large." in ended.stderr
    assert (tmp_path / "scan.json").stat().st_size <= 1024


@pytest.mark.parametrize("words", ["patterns", "patterns --json"])
def test_a_network_share_says_only_at_the_end_what_it_did_not_take(tmp_path: Path, words: str) -> None:
    bad = {"LD_PRELOAD": str(built_shim(tmp_path)), "BAD_DISK": f"/said.txt|close|{errno.EDQUOT}|1|1000"}
    with open(tmp_path / "said.txt", "w") as share:
        ended = subprocess.run(
            [*NLOS.split(), *words.split()],
            stdout=share,
            stderr=subprocess.PIPE,
            cwd=tmp_path,
            env={**os.environ, **bad},
        )
    assert ended.returncode == 6
    assert ended.stderr.decode().startswith("nlos: standard output: write error: Disk quota exceeded.")
    assert b"error" not in (tmp_path / "said.txt").read_bytes()


def test_a_pipe_that_another_program_set_not_to_wait_gets_all(tmp_path: Path) -> None:
    """Who shares it decides for all: Node.js sets its own so, and hands it to the programs that it starts."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with subprocess.Popen([*NLOS.split(), "schema", "bench"], stdout=writing, cwd=tmp_path) as child:
        os.close(writing)
        first = os.read(reading, 1)
        time.sleep(1.0)  # the pipe fills
        document = first
        while more := os.read(reading, 1 << 16):
            document += more
    os.close(reading)
    assert child.returncode == 0
    assert len(document) > 1 << 16  # more than a pipe holds
    assert "properties" in json.loads(document)


@pytest.mark.sampled(3)
@pytest.mark.soak
@pytest.mark.parametrize("seed", range(100 if SOAK else 6))
def test_a_scan_outlives_the_reader_of_its_progress(tmp_path: Path, seed: int) -> None:
    """The reader of one stream or both goes away at a random moment."""
    draw = random.Random(seed)
    (tmp_path / "small.yaml").write_text(SCAN)
    json = ["--json"] if draw.random() < 0.3 else []
    both = draw.random() < 0.5
    child = subprocess.Popen(
        [sys.executable, "-m", "nlos", "scan", "small.yaml", "-v", "-o", "run.h5", *json],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT if both else subprocess.PIPE, cwd=tmp_path,
    )  # fmt: skip
    time.sleep(draw.uniform(0.0, 2.0))
    streams = [child.stdout, child.stderr]
    draw.shuffle(streams)
    for stream in streams if draw.random() < 0.7 else streams[:1]:
        if stream is not None:
            stream.close()
    try:
        assert child.wait(timeout=240) == 0
    finally:
        for stream in streams:
            if stream is not None:
                stream.close()
    assert is_whole(tmp_path / "run.h5")
