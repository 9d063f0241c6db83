"""A trip outlasts the program: the next scan refuses until somebody clears it by name, and the log keeps all of it."""

import errno
import os
import resource
import tempfile
from collections.abc import Callable
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from nlos.configs.load import find
from nlos.drivers.errors import LimitError
from nlos.drivers.trip_latch import TripLatch
from tests.acquisition.killed_scans import FORK

if TYPE_CHECKING:
    import subprocess

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]
SCAN = """\
wall: {width_m: 0.5, height_m: 0.5, rows: 8, cols: 8}
pattern: serpentine
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 20, offset_ns: 10}
"""


@pytest.fixture
def multiharp(tmp_path: Path) -> Callable[[float], str]:
    def bench(trip_cps: float) -> str:
        text = find("bench", "multiharp").read_text()
        path = tmp_path / "bench.yaml"
        path.write_text(text.replace("safety:\n", f"safety:\n  trip_cps: {trip_cps}\n  trip_ms: 1.0\n"))
        return str(path)

    (tmp_path / "scan.yaml").write_text(SCAN)
    return bench


def test_a_trip_of_a_ttl_shutter_stands_until_it_is_cleared_by_name(
    nlos: Nlos, multiharp: Callable[[float], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    tripped = nlos("scan", "scan.yaml", "--bench", multiharp(20000), "-o", "run.h5")
    assert tripped.returncode == 5, tripped.stderr
    assert "--clear-trip YOUR-NAME` clears the trip, then `--resume` takes the others" in tripped.stderr
    bench = multiharp(5e6)  # the limit is corrected; the trip still stands
    for again in (("-o", "other.h5"), ("-o", "run.h5", "--resume")):
        refused = nlos("scan", "scan.yaml", "--bench", bench, *again)
        assert refused.returncode == 4, refused.stderr
        assert "--clear-trip" in refused.stderr
    assert not (tmp_path / "other.h5").exists()
    for nobody in ("", "  "):
        assert nlos("doctor", "--bench", bench, "--clear-trip", nobody).returncode != 0
    assert nlos("scan", "scan.yaml", "--bench", bench, "-o", "run.h5", "--resume").returncode == 4
    assert "in the name of Ada" in nlos("doctor", "--bench", bench, "--clear-trip", "Ada").stdout
    done = nlos("scan", "scan.yaml", "--bench", bench, "-o", "run.h5", "--resume")
    assert done.returncode == 0, done.stderr
    (log,) = (tmp_path / "state" / "trips").glob("*.log")
    trip, override = log.read_text().splitlines()
    assert "trip: " in trip
    assert "counts/s" in trip
    assert "override: Ada cleared" in override


def test_shutter_close_needs_only_what_drives_the_shutter(nlos: Nlos, tmp_path: Path) -> None:
    for name in ("simulated", "multiharp"):
        done = nlos("shutter", "close", "--bench", name)
        assert (done.returncode, done.stdout) == (0, "the shutter is closed\n")
    text = find("bench", "simulated").read_text().replace("model: tcspc488\ngeometry", "model: none\ngeometry")
    (tmp_path / "none.yaml").write_text(text)
    assert nlos("shutter", "close", "--bench", "none.yaml").returncode == 4
    assert nlos("shutter", "open").returncode == 2


def test_no_log_and_no_wrong_key_keep_the_shutter_from_being_told(nlos: Nlos, tmp_path: Path) -> None:
    for _ in range(2):  # the second time the log is there
        done = nlos("--wire-log", "wire.log", "shutter", "close", "--bench", "multiharp")
        assert done.returncode == 0, done.stderr
    assert "warning" in done.stderr
    assert "wire.log: exists" in done.stderr
    real = find("bench", "lab").read_text()
    (tmp_path / "lab.yaml").write_text(f"{real}\nnonsense_key: 3\n")
    asked = nlos("shutter", "close", "--bench", "lab.yaml")
    assert asked.returncode == 3, asked.stderr  # it looked for the instrument, which is not here
    assert "nonsense_key" in asked.stderr
    assert "NOT CONFIRMED CLOSED" in asked.stderr
    (tmp_path / "broken.yaml").write_text(real.replace("mirror:", "mirror_:"))
    broken = nlos("shutter", "close", "--bench", "broken.yaml")
    assert (broken.returncode, "mirror_" in broken.stderr) == (2, True), broken.stderr
    (tmp_path / "rehearsed.yaml").write_text(f"{find('bench', 'simulated').read_text()}\nnonsense_key: 3\n")
    rehearsed = nlos("shutter", "close", "--bench", "rehearsed.yaml")  # no light is out there
    assert (rehearsed.returncode, "nonsense_key" in rehearsed.stderr) == (2, True), rehearsed.stderr


@pytest.mark.parametrize(
    ("driven_by", "closes", "missing", "role"),
    [("tcspc488", "OUTP:SHUT CLOS", "G10", "mirror"), ("triggerscope_ttl", "SDO1-0", "U17", "counter")],
)
def test_the_light_goes_off_although_the_other_instrument_is_missing(
    nlos: Nlos, tmp_path: Path, driven_by: str, closes: str, missing: str, role: str
) -> None:
    """By what is said to the instrument that drives the shutter, and by the simulated table's own account."""
    bench = find("bench", "simulated").read_text()
    bench = bench.replace("shutter:\n  model: tcspc488", f"shutter:\n  model: {driven_by}")
    bench = bench.replace("mirror:\n  model: triggerscope\n", "mirror:\n  model: triggerscope\n  shutter_pin: 9\n")
    faults = f"faults: [{{name: {missing}, times: 999}}]\n  witness: table.log\n"
    (tmp_path / "bench.yaml").write_text(bench.replace("simulation:\n", f"simulation:\n  {faults}"))
    done = nlos("shutter", "close", "--bench", "bench.yaml", "--wire-log", "wire.log")
    assert done.returncode == 0, done.stdout + done.stderr
    assert closes in (tmp_path / "wire.log").read_text()
    done = nlos("doctor", "--bench", "bench.yaml")
    assert done.returncode == 3, done.stdout + done.stderr
    assert any(line.split()[:2] in (["PASS", "shutter"], ["WARN", "shutter"]) for line in done.stdout.splitlines())
    assert "shutter open" not in (tmp_path / "table.log").read_text()
    assert any(line.startswith("FAIL") and role in line for line in done.stdout.splitlines()), done.stdout


def test_a_trip_that_a_full_disk_cut_off_stands_and_so_does_the_one_after_it(tmp_path: Path) -> None:
    whole, latch = tmp_path / "whole.log", TripLatch(tmp_path / "latch.log")
    TripLatch(whole).trip("first")
    TripLatch(whole).clear("Ada")
    cleared = whole.read_bytes()
    TripLatch(whole).trip("5e+07 counts/s")
    text = whole.read_bytes()
    for size in range(len(text) + 1):
        latch.path.write_bytes(text[:size])
        assert (latch.standing() is None) == (size == len(cleared)), text[:size]
        latch.trip("another")
        assert latch.standing() == "another", text[:size]
        latch.clear("Grace")
        assert latch.standing() is None


@pytest.mark.parametrize("last", ["2026-11-30T19:00:00+00:00", "2026-11-30T19:00:00+00:00 overr", "\x00" * 40])
def test_a_last_line_that_is_neither_a_trip_nor_its_end_stands_for_a_trip(tmp_path: Path, last: str) -> None:
    latch = TripLatch(tmp_path / "bench.log")
    latch.trip("5e+06 counts/s")
    latch.clear("Ada")
    assert latch.standing() is None
    with latch.path.open("a") as log:
        log.write(f"{last}\n")
    assert "what was written down of it ends in" in (latch.standing() or "")
    latch.clear("Ada")
    assert latch.standing() is None


def test_a_trip_that_does_not_fit_the_disk_is_no_silent_one(tmp_path: Path) -> None:
    latch = TripLatch(tmp_path / "latch.log")

    def trips(raised: "Synchronized[int]") -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, resource.RLIM_INFINITY))
        try:
            latch.trip("5e+07 counts/s")
        except OSError:
            raised.value = 1
        os._exit(0)

    raised = FORK.Value("q", 0, lock=False)
    child = FORK.Process(target=trips, args=(raised,))
    child.start()
    child.join()
    assert raised.value == 1
    assert latch.standing() is not None


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a file system in which nobody may make a folder")
def test_there_is_no_light_where_a_trip_could_not_be_written_down(
    nlos: Nlos, multiharp: Callable[[float], str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is gone: by the table's own account it stays dark, and no recording is begun."""
    bench = Path(multiharp(5e6))
    bench.write_text(bench.read_text().replace("simulation:\n", f"simulation:\n  witness: {tmp_path}/table.log\n"))
    monkeypatch.setenv("NLOS_STATE", "/proc/no-such-disk")
    refused = nlos("scan", "scan.yaml", "--bench", str(bench), "-o", "run.h5")
    assert (refused.returncode, "a trip could not be written down" in refused.stderr) == (4, True), refused.stderr
    assert "shutter open" not in (tmp_path / "table.log").read_text()
    assert not (tmp_path / "run.h5").exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="takes on another user's number")
def test_a_trip_of_one_user_is_added_to_by_another_of_the_same_folder() -> None:
    """Two accounts of one bench, as the system tells them apart; where a log is read-only, there is no light."""
    place = tempfile.TemporaryDirectory()
    shared, own = Path(place.name) / "shared", Path(place.name) / "own"
    Path(place.name).chmod(0o755)
    for folder, mode in ((shared, 0o777), (own, 0o755)):
        folder.mkdir()
        folder.chmod(mode)  # whatever the mask of this session
        TripLatch(folder / "bench.log").trip("of the first user")

    def adds(done: "Synchronized[int]") -> None:
        os.setuid(65534)
        TripLatch(shared / "bench.log").check_place()
        TripLatch(shared / "bench.log").trip("of the second user")
        try:
            TripLatch(own / "bench.log").check_place()
        except LimitError:
            done.value = 1
        os._exit(0)

    done = FORK.Value("q", 0, lock=False)
    child = FORK.Process(target=adds, args=(done,))
    child.start()
    child.join()
    assert done.value == 1
    assert [line.partition("trip: ")[2] for line in (shared / "bench.log").read_text().splitlines()] == [
        "of the first user",
        "of the second user",
    ]
    assert (own / "bench.log").stat().st_mode & 0o777 == 0o644
    place.cleanup()


def test_a_trip_whose_clearing_cannot_be_written_down_stands_and_it_is_said_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    latch = TripLatch(tmp_path / "trips" / "bench.log")
    latch.trip("1e6 counts/s")

    def refused(*_: object) -> int:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    with monkeypatch.context() as patched:
        patched.setattr(os, "open", refused)
        with pytest.raises(LimitError, match="so it stands") as said:
            latch.clear("Ada")
    assert "clear the trip again" in str(said.value)
    assert latch.standing() == "1e6 counts/s"


def test_a_real_bench_is_never_said_to_be_dark_by_a_simulated_one(nlos: Nlos) -> None:
    """A valid file of real instruments, which are not plugged in here."""
    done = nlos("shutter", "close", "--bench", "lab")
    assert done.returncode == 3, done.stderr
    assert "the laser shutter is NOT CONFIRMED CLOSED" in done.stderr
    assert "closed" not in done.stdout
