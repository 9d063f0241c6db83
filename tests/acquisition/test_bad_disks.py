"""A disk that goes bad under a scan: exit 6 with the light off, and not one acknowledged sample lost or wrong."""

import errno
import json
import os
import random
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from nlos.acquisition.network.server import SampleServer
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import verify

SOAK = os.environ.get("NLOS_SOAK") == "1"
HERE = Path(__file__).parent
BENCHES = {"S1": "optotune", "S2": "zero_latency", "S3": "multiharp"}
SCAN = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 16, cols: 16}
pattern: serpentine
dwell_ms: 1
histogram: {bins: 64, bin_width_ps: %s}
"""
STEP_PS = {"S1": "256, offset_ns: 10", "S2": "256, offset_ns: 10", "S3": "320, offset_ns: 9.6"}
POINTS = 256
FAILING = {
    "write fails (EIO)": ("write", errno.EIO), "disk full": ("write", errno.ENOSPC),
    "read-only": ("write", errno.EROFS),
    "sync fails (EIO)": ("sync", errno.EIO), "read fails (EIO)": ("read", errno.EIO),
}  # fmt: skip
HARMING = {
    "deleted": ("delete", 0),
    "cut": ("truncate", 60),
    "replaced": ("replace", 0),
    "overwritten": ("overwrite", 900),
}
Run = Callable[..., int | None]


@pytest.fixture(scope="module")
def nlos(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """nlos(folder, bad, *arguments): a command on a disk that goes bad; its exit code."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("a disk that goes bad needs Linux and a C compiler (apt-get install gcc)")
    shim = tmp_path_factory.mktemp("shim") / "bad_disk.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-O1", "-o", shim, HERE / "bad_disk.c", "-ldl"], check=True)
    runs = subprocess.Popen(
        [sys.executable, HERE / "bad_disk_runs.py"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        env={**os.environ, "LD_PRELOAD": str(shim)},
    )  # fmt: skip
    assert runs.stdin is not None
    assert runs.stdout is not None
    ask, answers = runs.stdin, runs.stdout

    def run(folder: Path, bad: str, *arguments: str) -> int | None:
        ask.write(json.dumps({"bad": bad, "arguments": arguments, "folder": str(folder)}) + "\n")
        ask.flush()
        code: int | None = json.loads(answers.readline())["code"]
        return code

    yield run
    ask.close()
    runs.wait(30)


@pytest.fixture(scope="module")
def undisturbed(nlos: Run, tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[int, bytes]]:
    """Scheme -> what an undisturbed scan holds."""
    found = {}
    for scheme, bench in BENCHES.items():
        folder = tmp_path_factory.mktemp(scheme)
        (folder / "scan.yaml").write_text(SCAN % STEP_PS[scheme])
        assert nlos(folder, "", "scan", "scan.yaml", "--bench", bench, "-o", "run.h5") == 0, said(folder)
        found[scheme] = held(folder / "run.h5")
        assert len(found[scheme]) == POINTS
    return found


def said(folder: Path) -> str:
    return (folder / "stderr").read_text()


def held(path: Path) -> dict[int, bytes]:
    with Recording.open(path) as recording:
        return {s.point.number: s.histogram.counts.tobytes() for s in recording.samples()}


CALLS = {"write": 82, "sync": 2, "read": 60}
"""A call of each kind in the midst of the scan: 66 writes lay the file out, some 30 fill it."""


def cases() -> list[tuple[str, str, int, int]]:
    """(scheme, what goes wrong, at which call, for how many): every kind in every scheme first, then at random."""
    draw = random.Random(0)
    kinds = FAILING | HARMING
    call_of = {kind: CALLS.get(what, CALLS["write"]) for kind, (what, _) in kinds.items()}
    every = [(scheme, kind, call_of[kind], 1 << 30) for kind in kinds for scheme in BENCHES]
    if not SOAK:
        return [every[3 * i + i % 3] for i in range(len(kinds))]
    while len(every) < 500:
        scheme, kind = draw.choice(list(BENCHES)), draw.choice(list(kinds))
        every.append((scheme, kind, draw.randint(1, round(1.2 * call_of[kind])), draw.choice([1, 1, 3, 1 << 30])))
    return every


@pytest.mark.soak
@pytest.mark.parametrize(("scheme", "kind", "call", "times"), cases())
def test_nothing_acknowledged_is_lost_on_a_disk_that_goes_bad(
    nlos: Run, undisturbed: dict[str, dict[int, bytes]], tmp_path: Path, scheme: str, kind: str, call: int, times: int
) -> None:
    what, number = (FAILING | HARMING)[kind]
    run, expected = tmp_path / "run.h5", undisturbed[scheme]
    (tmp_path / "scan.yaml").write_text(SCAN % STEP_PS[scheme])
    scan = ("scan", "scan.yaml", "--bench", BENCHES[scheme], "-o", "run.h5")
    bad = f"/run.h5|{what}|{number}|{call}|{min(call + times, 1 << 40)}"
    code = nlos(tmp_path, bad, *scan, "--wire-log", "wire.log")
    words = said(tmp_path)
    assert code in (0, 6), f"{code}: {words}"
    assert code == 6 or (run.exists() and verify(run).complete and held(run) == expected)
    shut = [
        line for line in (tmp_path / "wire.log").read_text().splitlines() if "OUTP:SHUT" in line and "?" not in line
    ]
    assert not shut or "CLOS" in shut[-1]
    if promised := re.search(r"(\d+) samples are safe in (?:it|(\S+run\.h5\.rescued\S*?))[.:]", words):
        lies = run if promised[2] is None else tmp_path / Path(promised[2]).name
        kept = held(lies)
        assert len(kept) >= int(promised[1])
        assert kept.items() <= expected.items()
        if promised[2] is not None:
            lies.replace(run)
    elif run.exists() and kind not in HARMING:
        assert held(run).items() <= expected.items()
    before = held(run) if run.exists() and b"stranger" not in run.read_bytes()[:1000] else {}
    assert nlos(tmp_path, "", *scan, "--resume") == 0, said(tmp_path)
    assert before.items() <= held(run).items()
    assert held(run) == expected
    assert verify(run).status is Status.COMPLETE


def test_rows_that_cannot_be_read_are_unknown_and_nothing_is_changed(
    nlos: Run, undisturbed: dict[str, dict[int, bytes]], tmp_path: Path
) -> None:
    (tmp_path / "scan.yaml").write_text(SCAN % STEP_PS["S2"])
    scan = ("scan", "scan.yaml", "--bench", BENCHES["S2"], "-o", "run.h5")
    assert nlos(tmp_path, "", *scan) == 0
    run, size = tmp_path / "run.h5", (tmp_path / "run.h5").stat().st_size
    before, inode = run.read_bytes(), run.stat().st_ino
    places = {"rows": (size - 20_000, size - 15_000), "status": (0, 1), "head": (2000, 4000), "all": (0, size)}
    for where, (first, end) in places.items():
        bad = f"/run.h5|bytes|{errno.EIO}|{first}|{end}"
        assert nlos(tmp_path, bad, *scan, "--resume") == 6, (where, said(tmp_path))
        assert nlos(tmp_path, bad, "verify", "run.h5") == 6, (where, said(tmp_path))
        assert "corrupt" not in said(tmp_path)
        assert (run.read_bytes(), run.stat().st_ino) == (before, inode), where
        assert not list(tmp_path.glob("run.h5.*"))
    assert (
        nlos(
            tmp_path, f"/run.h5|bytes|{errno.EIO}|{size - 20_000}|{size - 15_000}", "recover", "run.h5", "-o", "new.h5"
        )
        == 0
    )
    assert 230 < len(held(tmp_path / "new.h5")) < POINTS
    assert held(tmp_path / "new.h5").items() <= undisturbed["S2"].items()
    assert verify(run).complete


@pytest.mark.soak
@pytest.mark.parametrize("scheme", BENCHES if SOAK else ["S2"])
@pytest.mark.parametrize("resumed", [False, True], ids=["new scan", "resumed scan"])
def test_a_scan_killed_at_any_write_loses_nothing_and_is_resumed(
    nlos: Run, undisturbed: dict[str, dict[int, bytes]], tmp_path: Path, scheme: str, resumed: bool
) -> None:
    run, half, expected = tmp_path / "run.h5", tmp_path / "half", undisturbed[scheme]
    (tmp_path / "scan.yaml").write_text(SCAN % STEP_PS[scheme])
    scan = ("scan", "scan.yaml", "--bench", BENCHES[scheme], "-o", "run.h5", "--resume")
    for write in range(CALLS["write"] - 8, CALLS["write"] + 14):
        if resumed and not half.exists():
            run.unlink(missing_ok=True)
            assert nlos(tmp_path, f"/run.h5|kill|0|{write}|{write}", *scan) in (-9, 0)
            if 0 < len(held(run)) < POINTS:
                run.replace(half)
    kills = 0
    for write in range(1, 400, 1 if SOAK else 9 if resumed else 40):
        if resumed:
            shutil.copy(half, run)
        code = nlos(tmp_path, f"/run.h5|kill|0|{write}|{write}", *scan)
        if code == 0:
            break
        assert code == -9, said(tmp_path)
        kills += 1
        if run.exists():
            with Recording.open(run) as recording:
                acknowledged = recording.acknowledged
            assert len(held(run)) >= acknowledged
            assert not verify(run).corrupt
        assert nlos(tmp_path, "", *scan) == 0, said(tmp_path)
        assert held(run) == expected, f"killed at write {write}"
        assert verify(run).status is Status.COMPLETE
        assert {path.name for path in tmp_path.glob("run.h5*")} == {"run.h5"}
        run.unlink()
    assert kills > 1


@pytest.mark.soak
@pytest.mark.parametrize("write", range(1, 90) if SOAK else [72])
def test_a_killed_mirror_of_a_served_scan_keeps_what_it_had_and_goes_on(
    nlos: Run, undisturbed: dict[str, dict[int, bytes]], tmp_path: Path, write: int
) -> None:
    (tmp_path / "scan.yaml").write_text(SCAN % STEP_PS["S2"])
    assert nlos(tmp_path, "", "scan", "scan.yaml", "--bench", BENCHES["S2"], "-o", "run.h5") == 0
    server, stop = SampleServer(tmp_path / "run.h5"), threading.Event()
    thread = threading.Thread(target=server.serve, args=(lambda: not stop.is_set(),))
    thread.start()
    try:
        server.ticket.save(tmp_path / "run.ticket")
        follow = ("reconstruct", "run.ticket", "--follow", "-o", "far", "--overwrite")
        assert nlos(tmp_path, f"/far/run.h5|kill|0|{write}|{write}", *follow) in (-9, 0)
        copy = tmp_path / "far" / "run.h5"
        before = held(copy) if copy.exists() else {}
        if copy.exists():
            with Recording.open(copy) as recording:
                assert len(before) >= recording.acknowledged
        for _ in range(2):  # the second time over a complete copy
            assert nlos(tmp_path, "", *follow) == 0, said(tmp_path)
            assert before.items() <= held(copy).items()
            assert held(copy) == undisturbed["S2"]
            assert verify(copy).status is Status.COMPLETE
    finally:
        stop.set()
        thread.join()
        server.close()
