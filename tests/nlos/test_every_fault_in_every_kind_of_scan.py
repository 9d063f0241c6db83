"""A fault in a scan of any kind, by the command line: it ends dark, with the exit code that its row of `docs/faults.md`
says; what was acknowledged stays, and `--resume` takes the rest as if nothing had been."""

import os
import random
import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import yaml

from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.verification import verify
from nlos.cli.exit_codes import exit_code
from nlos.drivers import errors
from nlos.drivers.simulated.bench import SimulatedBench
from nlos.drivers.simulated.fault_catalogue import tables
from nlos.drivers.simulated.faults import Fault, FaultPlan
from nlos.drivers.trip_latch import TripLatch
from tests.acquisition.fault_cases import BENCHES, acknowledged, cuts_off_the_shutter, settings
from tests.command import nlos

pytestmark = pytest.mark.usefixtures("one_child_reads")
SOAK = os.environ.get("NLOS_SOAK") == "1"
SCANS = 600 if SOAK else 8
GRID = {"wall": {"width_m": 0.6, "height_m": 0.6, "rows": 6, "cols": 6}, "pattern": "serpentine", "dwell_ms": 2}
LINES = {"wall": {"width_m": 0.5, "height_m": 0.5, "rows": 12, "cols": 12}, "dwell_ms": 0.2, "continuous": {}}
KINDS: dict[str, dict[str, Any]] = {
    "listed points": {"pattern": {"kind": "list", "file": "points.csv"}},
    "batches": {"pattern": {"kind": "coarse_to_fine", "batch": 8}},
    "two passes": {"exposure": {"kind": "two_pass", "counts": 300, "again_ms": 2}},
    "stop at counts": {"exposure": {"kind": "stop_at_counts", "counts": 60, "from_ns": 12.0, "to_ns": 22.0}},
    "adaptive": {"pattern": {"kind": "adaptive", "seconds": 0.1, "step_ms": 0.5, "lengths": 2, "batch": 8}},
    "film": {"frames": 4, "interleave": 2},
    "sweeps": LINES,
}
ROWS = {row.name: row.seen for rows in tables().values() for row in rows}


def written(folder: Path, kind: str, name: str, *faults: Fault) -> tuple[str, ...]:
    """The words of the command that scans it."""
    width_ps = 40.0 if name == "multiharp" else 32.0
    scan = {**GRID, "histogram": {"bins": 512, "bin_width_ps": width_ps, "offset_ns": 8.0}, **KINDS[kind]}
    (folder / "scan.yaml").write_text(yaml.safe_dump(scan))
    (folder / "points.csv").write_text(
        "x_m,y_m\n" + "".join(f"{k % 5 * 0.1 - 0.2},{k // 5 * 0.1 - 0.2}\n" for k in range(25))
    )
    document = settings(name, *faults).model_dump(mode="json")
    (folder / "bench.yaml").write_text(yaml.safe_dump(document))
    return "scan", "scan.yaml", "--bench", "bench.yaml"


def codes(word: str) -> set[int]:
    """What a scan may end with that such a fault struck, as its row says it."""
    seen = ROWS[word]
    kinds = [getattr(errors, each) for each in re.findall(r"`([A-Z]\w+)`", seen) if hasattr(errors, each)]
    found = {5 if issubclass(kind, errors.SafetyTrip) else int(exit_code(kind("device", "what"))) for kind in kinds}
    continues = not kinds or re.search(r"nothing|a warning|flagged|asked again", seen)
    return found | ({0} if continues else set())


class Struck:
    """Whether the fault did, and whether it did so once there was a recording: benches are opened before that."""

    def __init__(self, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.at_all = self.in_the_scan = False
        self.tables: list[SimulatedBench] = []
        strikes, begin = FaultPlan.strikes, SimulatedBench.__init__

        def watched(plan: FaultPlan, *occasion: Any) -> Fault | None:
            found = strikes(plan, *occasion)
            self.at_all |= found is not None
            self.in_the_scan |= found is not None and run.exists()
            return found

        def kept(table: SimulatedBench, *parts: Any, **named: Any) -> None:
            begin(table, *parts, **named)
            self.tables.append(table)

        monkeypatch.setattr(FaultPlan, "strikes", watched)
        monkeypatch.setattr(SimulatedBench, "__init__", kept)

    def may_end_with(self, word: str) -> set[int]:
        """A bench that is opened may ask again, or not open at all."""
        return {0} if not self.at_all else codes(word) | (set() if self.in_the_scan else {0, 3, 9})


def drawn(seed: int) -> tuple[str, str, Fault]:
    """A bench, a kind of scan that it can make, and what goes wrong."""
    chance = random.Random(f"kinds {seed}")
    name = chance.choice(sorted(BENCHES))
    counts_itself = name in ("stepped", "clocked", "optotune", "played")
    kind = chance.choice([each for each in sorted(KINDS) if counts_itself or each != "stop at counts"])
    word, parameters = chance.choice(BENCHES[name][2])
    return name, kind, Fault(name=word, skip=chance.choice((1, 3, 10, 30, 60)), parameters=parameters)


@cache
def undisturbed(name: str, kind: str, folder: Path) -> dict[int, bytes]:
    nlos(folder, *written(folder, kind, name), "-o", f"{name} {kind}.h5", check=True)
    return acknowledged(folder / f"{name} {kind}.h5")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("undisturbed")


@pytest.mark.parametrize("seed", range(SCANS))
def test_a_fault_ends_a_scan_as_its_row_says_and_resume_finishes_it(
    seed: int, tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NLOS_STATE", str(tmp_path / "state"))
    name, kind, fault = drawn(seed)
    whole, run = undisturbed(name, kind, folder), tmp_path / "run.h5"
    with monkeypatch.context() as watching:
        struck = Struck(run, watching)
        words = (*written(tmp_path, kind, name, fault), "-o", "run.h5")
        done = nlos(tmp_path, *words)
    assert done.returncode in struck.may_end_with(fault.name), done.stderr
    assert cuts_off_the_shutter(name, fault) or not struck.tables[-1].shutter_open
    safe = acknowledged(run)
    if done.returncode:
        assert "--resume" in done.stderr or not run.exists()
        written(tmp_path, kind, name)
        latch = TripLatch.of_bench(settings(name))
        assert (latch.standing() is not None) == (fault.name == "U14" and done.returncode == 5)
        if latch.standing() is not None:
            latch.clear("Ada")
        nlos(tmp_path, *words, "--resume", check=True)
    now = acknowledged(run)
    assert safe.items() <= now.items()
    if kind == "adaptive":  # what comes next depends on what there was when it was asked
        assert verify(run).complete
        assert {number: now[number] for number in now.keys() & whole} == {n: whole[n] for n in now.keys() & whole}
    else:
        assert now == whole


@pytest.mark.parametrize(
    ("name", "changed", "fault", "said"),
    [
        ("clocked", {}, Fault(name="A7", after_s=0.02), "another program changed the range of a DAC"),
        ("optotune", {"readback": True}, Fault(name="B6", skip=5, times=2, parameters={"off_by": 0.01}), "was sent to"),
    ],
)
def test_what_a_mirror_warns_of_in_a_scan_is_told_at_once_and_kept(
    tmp_path: Path, name: str, changed: dict[str, Any], fault: Fault, said: str
) -> None:
    words = written(tmp_path, "batches", name, fault)
    bench = yaml.safe_load((tmp_path / "bench.yaml").read_text())
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(bench | {"mirror": bench["mirror"] | changed}))
    done = nlos(tmp_path, *words, "-o", "run.h5", check=True)
    told = [line for line in done.stderr.splitlines() if said in line]
    assert [line.startswith("warning: ") for line in told] == [True]  # once, although the mirror stays off
    with Recording.open(tmp_path / "run.h5") as recording:
        assert [event.kind for event in recording.events() if said in event.text and event.kind == "warning"]
