"""What would refuse a scan has its plan refused, with the same exit code and words."""

import shutil
from pathlib import Path

import pytest

from nlos.cli.benches import load_bench
from nlos.drivers.trip_latch import TripLatch
from tests.changed_bench import bench_file
from tests.nlos.conftest import SMALL, Nlos


@pytest.fixture(autouse=True)
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    (tmp_path / "scan.yaml").write_text(SMALL)


def refusals(nlos: Nlos, *words: str, scan: str = "scan.yaml") -> tuple[int, str, str]:
    """Exit code and last line of a scan, and all that its plan printed; the plan was refused by the same."""
    scanned = nlos("scan", scan, "-o", "run.h5", *words)
    planned = nlos("plan", scan, "-o", "run.h5", *words)
    last = [done.stderr.strip().rpartition("\n")[2] for done in (scanned, planned)]
    assert planned.returncode == scanned.returncode != 0, planned.stderr
    assert last[0] == last[1]
    return planned.returncode, last[1], planned.stdout


def test_a_trip_that_stands_refuses_the_plan(nlos: Nlos, tmp_path: Path) -> None:
    latch = TripLatch.of_bench(load_bench(None).settings)
    latch.trip("5e+06 counts/s.")
    code, said, told = refusals(nlos)
    assert code == 4
    assert "stays closed after a trip (5e+06 counts/s)" in said
    assert "--clear-trip" in said
    assert "duration " in told, "what there is to know is told all the same"
    latch.clear("Ada")
    assert nlos("plan", "scan.yaml").returncode == 0


def test_a_trip_of_a_real_bench_refuses_the_plan_although_only_its_twin_is_asked(nlos: Nlos) -> None:
    TripLatch.of_bench(load_bench("lab").settings).trip("an open door")
    done = nlos("plan", "scan.yaml", "--bench", "lab")
    assert done.returncode == 4
    assert "after a trip (an open door)" in done.stderr


def test_a_place_where_no_trip_could_be_written_down_refuses_the_plan(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "state").write_text("a file where the folder should be")
    assert refusals(nlos)[0] == 4


def test_a_disk_without_room_refuses_the_plan(nlos: Nlos, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)  # as it is now: others write on this disk, too
    monkeypatch.setattr("shutil.disk_usage", lambda folder: usage)
    (tmp_path / "scan.yaml").write_text(f"{SMALL}alarms: {{min_free_mb: {usage.free / 1e6 * 2:.0f}}}\n")
    code, said, told = refusals(nlos)
    assert code == 6
    assert "MB free beside it (alarms.min_free_mb)" in said
    assert "disk  " in told


def test_a_plan_is_made_for_where_the_scan_will_write(nlos: Nlos, tmp_path: Path) -> None:
    assert nlos("plan", "scan.yaml", "-o", "new/run.h5").returncode == 0
    assert not (tmp_path / "new").exists()
    assert nlos("plan", "scan.yaml", "-o", "no/such/run.h5").returncode == 2
    assert nlos("plan", "scan.yaml", "-o", "run.txt").returncode == 2
    dim = bench_file(tmp_path, {"safety.dry_run": True})
    assert nlos("plan", "scan.yaml", "--bench", dim).returncode == 0
