"""A disk that goes bad under a scan: exit 6 with the light off, and not one acknowledged sample lost or wrong."""

import errno
import os
import random
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.served.server import SampleServer
from tests.acquisition.bad_disk_server import Run, bad_disks
from tests.acquisition.witnessed_bench import BENCHES, bench_file, is_parked, witnessed

SOAK = os.environ.get("NLOS_SOAK") == "1"
SCAN = """\
wall: {width_m: 0.3, height_m: 0.3, rows: 16, cols: 16}
pattern: serpentine
dwell_ms: 1
histogram: {bins: 64, bin_width_ps: %s}
"""
AXIS = dict.fromkeys(BENCHES, "256, offset_ns: 10") | {"S3": "320, offset_ns: 9.6"}
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
Counts = dict[int, bytes]


@pytest.fixture(scope="module")
def nlos(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """nlos(folder, bad, *arguments): a command on a disk that goes bad; its exit code."""
    with bad_disks(tmp_path_factory.mktemp("shim")) as run:
        yield run


@pytest.fixture(scope="module")
def undisturbed(nlos: Run, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Counts]:
    """undisturbed(bench): what an undisturbed scan on it holds."""

    @cache
    def of(bench: str) -> Counts:
        folder = tmp_path_factory.mktemp("undisturbed")
        assert nlos(folder, "", *scan_on(bench, folder)) == 0, said(folder)
        check_light(folder)
        assert len(held(folder / "run.h5")) == POINTS
        return held(folder / "run.h5")

    return of


def scan_on(bench: str, folder: Path) -> tuple[str, ...]:
    """The command that scans into run.h5; its files are laid into the folder, and the table's own account begins."""
    (folder / "scan.yaml").write_text(SCAN % AXIS[bench])
    shutter = ["--no-shutter"] if "no shutter" in bench else []
    return ("scan", "scan.yaml", "--bench", str(bench_file(folder, bench)), "-o", "run.h5", *shutter)


def check_light(folder: Path) -> None:
    """By the table's own account: dark, and the mirror parked. Begins that account anew."""
    seen = witnessed(folder)
    (folder / "witness.txt").unlink(missing_ok=True)
    light = [line for line in seen if line.startswith("shutter")]
    beam = [line for line in seen if line.startswith("beam")]
    assert light[-1:] in ([], ["shutter closed"])
    assert all(is_parked(line) for line in beam[-1:])


def said(folder: Path) -> str:
    return (folder / "stderr").read_text()


def held(path: Path) -> Counts:
    with Recording.open(path) as recording:
        return {s.point.number: s.histogram.counts.tobytes() for s in recording.samples()}


CALLS = {"write": 82, "sync": 2, "read": 60}
"""A call of each kind in the midst of the scan: 66 writes lay the file out, some 30 fill it."""


def cases() -> list[tuple[str, str, int, int]]:
    """(bench, what goes wrong, at which call, for how many): every kind on every bench first, then at random."""
    draw = random.Random(0)
    kinds = FAILING | HARMING
    call_of = {kind: CALLS.get(what, CALLS["write"]) for kind, (what, _) in kinds.items()}
    benches = list(BENCHES)
    if not SOAK:
        return [(benches[i % len(benches)], kind, call_of[kind], 1 << 30) for i, kind in enumerate(kinds)]
    every = [(bench, kind, call_of[kind], 1 << 30) for kind in kinds for bench in benches]
    while len(every) < 500:
        bench, kind = draw.choice(benches), draw.choice(list(kinds))
        every.append((bench, kind, draw.randint(1, round(1.2 * call_of[kind])), draw.choice([1, 1, 3, 1 << 30])))
    return every


@pytest.mark.soak
@pytest.mark.parametrize(("bench", "kind", "call", "times"), cases())
def test_nothing_acknowledged_is_lost_on_a_disk_that_goes_bad(
    nlos: Run, undisturbed: Callable[[str], Counts], tmp_path: Path, bench: str, kind: str, call: int, times: int
) -> None:
    what, number = (FAILING | HARMING)[kind]
    run, expected = tmp_path / "run.h5", undisturbed(bench)
    scan = scan_on(bench, tmp_path)
    bad = f"/run.h5|{what}|{number}|{call}|{min(call + times, 1 << 40)}"
    code = nlos(tmp_path, bad, *scan)
    words = said(tmp_path)
    assert code in (0, 6), f"{code}: {words}"
    assert code == 6 or (run.exists() and verify(run).complete and held(run) == expected)
    check_light(tmp_path)
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
    nlos: Run, undisturbed: Callable[[str], Counts], tmp_path: Path
) -> None:
    scan = scan_on("S2", tmp_path)
    assert nlos(tmp_path, "", *scan) == 0
    run, size = tmp_path / "run.h5", (tmp_path / "run.h5").stat().st_size
    before, inode = run.read_bytes(), run.stat().st_ino
    places = {"rows": (size - 20_000, size - 15_000), "status": (0, 1), "head": (2000, 4000), "all": (0, size)}
    for where, (first, end) in places.items() if SOAK else [("rows", places["rows"])]:
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
    assert held(tmp_path / "new.h5").items() <= undisturbed("S2").items()
    assert verify(run).complete


EVERY_CALL = [("S2", first, 4) for first in range(1, 5)] + [(bench, 1, 12) for bench in BENCHES if bench != "S2"]


@pytest.mark.soak
@pytest.mark.parametrize(("bench", "first", "step"), EVERY_CALL if SOAK else [("S2", 2, 40)])
@pytest.mark.parametrize("resumed", [False, True], ids=["new scan", "resumed scan"])
def test_a_scan_killed_at_any_write_loses_nothing_and_is_resumed(
    nlos: Run, undisturbed: Callable[[str], Counts], tmp_path: Path, bench: str, first: int, step: int, resumed: bool
) -> None:
    run, half, expected = tmp_path / "run.h5", tmp_path / "half", undisturbed(bench)
    scan = (*scan_on(bench, tmp_path), "--resume")
    for write in range(CALLS["write"] - 8, CALLS["write"] + 24):
        if resumed and not half.exists():
            run.unlink(missing_ok=True)
            assert nlos(tmp_path, f"/run.h5|kill|0|{write}|{write}", *scan) in (-9, 0)
            if run.exists() and 0 < len(held(run)) < POINTS:
                run.replace(half)
    kills = 0
    for write in range(first, 400, step if SOAK or not resumed else 9):
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


@pytest.fixture
def served(nlos: Run, tmp_path: Path) -> Iterator[Path]:
    """A folder with a scan and the ticket under which it is served."""
    (tmp_path / "scan.yaml").write_text((SCAN % "32, offset_ns: 10").replace("64", "512"))
    assert nlos(tmp_path, "", "scan", "scan.yaml", "--bench", "zero_latency", "-o", "run.h5") == 0
    server, stop = SampleServer(tmp_path / "run.h5"), threading.Event()
    thread = threading.Thread(target=server.serve, args=(lambda: not stop.is_set(),))
    thread.start()
    try:
        server.ticket.save(tmp_path / "run.ticket")
        yield tmp_path
    finally:
        stop.set()
        thread.join()
        server.close()


def check_begun(copy: Path) -> Counts:
    """What a copy holds that was killed: all that was acknowledged."""
    if not copy.exists():
        return {}
    with Recording.open(copy) as recording:
        assert len(held(copy)) >= recording.acknowledged
    return held(copy)


@pytest.mark.soak
def test_a_mirror_killed_at_any_write_keeps_what_it_had_and_goes_on(nlos: Run, served: Path) -> None:
    copy, expected, begun = served / "copy.h5", held(served / "run.h5"), 0
    for call in range(1, 400, 1 if SOAK else 40):
        code = nlos(served, f"/copy.h5|kill|0|{call}|{call}", "copy", "run.ticket", "copy.h5")
        if code == 0:
            break
        assert code == -9, said(served)
        before = check_begun(copy)
        begun += 0 < len(before) < POINTS
        for _ in range(2):  # the second time over a complete copy
            assert nlos(served, "", "copy", "run.ticket", "copy.h5") == 0, said(served)
            assert before.items() <= held(copy).items()
            assert held(copy) == expected
            assert verify(copy).status is Status.COMPLETE
        assert {path.name for path in served.glob("copy.h5*")} == {"copy.h5"}
        copy.unlink()
    assert call > 40
    assert begun or not SOAK


@pytest.mark.soak
@pytest.mark.parametrize("call", range(4, 110, 8) if SOAK else [88])
def test_who_follows_a_mirror_that_is_killed_is_told_and_may_follow_again(nlos: Run, served: Path, call: int) -> None:
    follow = ("reconstruct", "run.ticket", "--follow", "-o", "far", "--overwrite")
    code = nlos(served, f"/far/run.h5|kill|0|{call}|{call}", *follow)
    assert code in (0, 6), said(served)  # 0: the copy was whole before so many calls
    assert code == 0 or "the copying process stopped (signal 9)" in said(served)
    before = check_begun(served / "far" / "run.h5")
    assert nlos(served, "", *follow) == 0, said(served)
    assert "Fatal" not in said(served)
    assert before.items() <= held(served / "far" / "run.h5").items()
    assert held(served / "far" / "run.h5") == held(served / "run.h5")
    assert verify(served / "far" / "run.h5").status is Status.COMPLETE
