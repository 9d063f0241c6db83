"""Where an adaptive scan looks next: dwell by the light, place by intervals, and nobody is waited for."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nlos.acquiring import open_bench, scan
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.advice import Reason, reasons
from nlos.configs.load import load
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag
from nlos.live.process import state_file
from nlos.live.where_next import WhereNext
from nlos.recon.wall_doubt import Wanted
from tests import command
from tests.scan_texts import recorded

pytestmark = pytest.mark.usefixtures("one_child_reads")

ADAPTIVE = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: adaptive, seconds: 1.5, step_ms: 1, lengths: 2}
dwell_ms: 4
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
SECOND_LOOK = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: serpentine
dwell_ms: 2
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
exposure: {kind: second_look, again_ms: 8, share: 0.25}
"""


def plan_of(side: int = 32, seconds: float = 4.0, **more: Any) -> ScanPlan:
    pattern = {"kind": "adaptive", "seconds": seconds, "step_ms": 1.0, "lengths": 4, "batch": 32}
    settings = {
        "wall": {"width_m": 1.0, "height_m": 1.0, "rows": side, "cols": side},
        "pattern": pattern,
        "dwell_ms": 2,
        "histogram": {"bins": 256, "bin_width_ps": 64},
        **more,
    }
    return ScanSettings.model_validate(settings).plan()


def sample_of(plan: ScanPlan, number: int, indirect_hz: float) -> Sample:
    """With direct light in one bin, and the expected indirect light spread over a hundred."""
    counts = np.zeros(plan.axis.bins, dtype=np.uint32)
    counts[10] = 50
    photons = round(indirect_hz * plan.dwell_s[number])
    counts[60 : 60 + photons % 100] = 1
    counts[60:160] += np.uint32(photons // 100)
    histogram = Histogram(
        counts, plan.axis.bin_width_s, 0.0, float(plan.dwell_s[number]), 1, int(counts.sum()), HistogramFlag(0), 0.0
    )
    return Sample(plan[number], histogram, 0.0)


def fed(plan: ScanPlan, indirect_hz: float, count: int = 32, adviser: WhereNext | None = None) -> WhereNext:
    adviser = adviser or WhereNext(plan)
    for number in range(count):
        adviser.add(sample_of(plan, number, indirect_hz))
    return adviser


@pytest.mark.parametrize(("indirect_hz", "dwell_ms"), [(100.0, 16.0), (2_000.0, 4.0), (200_000.0, 2.0)])
def test_the_less_light_the_longer_the_dwell(indirect_hz: float, dwell_ms: float) -> None:
    plan = plan_of(seconds=1.0)
    advice = fed(plan, indirect_hz).advise(range(32), plan.left_us(range(32)))
    assert advice is not None
    assert set(plan.dwell_s[list(advice.numbers)].tolist()) == {dwell_ms * 1e-3}
    assert "photons a point, expected error" in advice.why


def test_nothing_is_advised_before_there_is_light_to_judge_by() -> None:
    plan = plan_of()
    assert WhereNext(plan).advise([], plan.left_us([])) is None


def test_without_pictures_new_places_come_coarse_to_fine_none_of_them_twice() -> None:
    plan = plan_of()
    advice = fed(plan, 20_000.0).advise(range(32), plan.left_us(range(32)))
    assert advice is not None
    places = [(plan[number].row, plan[number].col) for number in advice.numbers]
    assert places == [(plan[number].row, plan[number].col) for number in range(32, 64)]
    assert advice.why.startswith("spread evenly: ")


def test_places_lie_denser_where_intervals_are_wide(tmp_path: Path) -> None:
    plan, run = plan_of(), tmp_path / "run.h5"
    left = np.where(np.arange(32) < 16, 4.0, 0.25)[None].repeat(32, axis=0)
    state_file(run).write_text(json.dumps({"wanted": {"new": left.tolist(), "again": left.T.tolist()}}))
    advice = fed(plan, 20_000.0, adviser=WhereNext(plan, watched=run)).advise(range(32), plan.left_us(range(32)))
    assert advice is not None
    assert advice.why.startswith("where intervals are wide: ")
    on_left = sum(plan[number].x_m < 0 for number in advice.numbers)
    assert on_left > 24


@pytest.mark.parametrize(
    "written",
    ["", "{", "[]", '{"wanted": 3}', '{"wanted": {"new": [[1]], "again": [[1]]}}', '{"wanted": {"new": "x"}}',
     json.dumps({"wanted": {"new": [[-1.0] * 32] * 32, "again": [[1.0] * 32] * 32}}),
     json.dumps({"wanted": {"new": [[1.0] * 32] * 32, "again": [[float("inf")] * 32] * 32}})],
)  # fmt: skip
def test_a_viewer_that_says_nothing_that_makes_sense_changes_nothing(tmp_path: Path, written: str) -> None:
    plan, run = plan_of(), tmp_path / "run.h5"
    state_file(run).write_text(written)
    advice = fed(plan, 20_000.0, adviser=WhereNext(plan, watched=run)).advise(range(32), plan.left_us(range(32)))
    assert advice is not None
    assert advice.why.startswith("spread evenly: ")


def test_a_viewer_that_falls_silent_leaves_what_it_said_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nlos.live.where_next.AGAIN_S", 0.0)
    plan, run = plan_of(), tmp_path / "run.h5"
    even = np.ones((32, 32)).tolist()
    state_file(run).write_text(json.dumps({"wanted": {"new": even, "again": even}}))
    adviser = fed(plan, 20_000.0, adviser=WhereNext(plan, watched=run))
    for said in ("as it is", "{", None):
        if said == "{":
            state_file(run).write_text(said)
        elif said is None:
            state_file(run).unlink()
        advice = adviser.advise(range(32), plan.left_us(range(32)))
        assert advice is not None
        assert advice.why.startswith("where intervals are wide: "), said


def test_nothing_is_advised_that_the_time_left_does_not_hold() -> None:
    plan = plan_of()
    adviser = fed(plan, 20_000.0)
    shortest_us = round(float(plan.dwell_s.min()) * 1e6)
    assert adviser.advise(range(32), shortest_us - 1) is None
    assert adviser.advise(range(32), 2 * shortest_us + 100_000) is not None


class Sees:
    """Pictures, whose map a test gives; how often one was asked for."""

    reconstruction = None

    def __init__(self, none: bool = False) -> None:
        self.none, self.asked = none, 0

    def add(self, sample: Sample) -> None: ...

    def picture(self, kind: str) -> "Sees | None":
        self.asked += 1
        return None if self.none else self


def test_a_picture_is_made_once_at_its_time_and_where_enough_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    plan, sees, even = plan_of(seconds=34.0), Sees(), np.ones((32, 32), dtype=np.float32)
    monkeypatch.setattr("nlos.live.where_next.wanted_on_wall", lambda made: Wanted(even, even))
    adviser = fed(plan, 20_000.0, adviser=WhereNext(plan, sees))  # type: ignore[arg-type]
    for left_s, pictures in ((21.0, 0), (19.0, 0), (20.2, 1), (20.1, 1)):
        assert adviser.advise(range(32), round(left_s * 1e6)) is not None
        assert sees.asked == pictures, left_s


def test_second_looks_are_not_advised_without_a_picture() -> None:
    plan = plan_of(side=16, exposure={"kind": "second_look", "again_ms": 8, "share": 0.125}, pattern="serpentine")
    adviser = fed(plan, 20_000.0, 256, WhereNext(plan, Sees(none=True)))  # type: ignore[arg-type]
    assert adviser.advise(range(256), plan.left_us(range(256))) is None


def test_second_looks_go_where_intervals_are_wide_once_everything_was_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = {"exposure": {"kind": "second_look", "again_ms": 8, "share": 0.125}, "pattern": "serpentine"}
    plan = plan_of(side=16, **settings)
    again = np.full((16, 16), 0.1, dtype=np.float32)
    again[5] = 10.0
    monkeypatch.setattr("nlos.live.where_next.wanted_on_wall", lambda made: Wanted(again.T, again))
    adviser = fed(plan, 20_000.0, 256, WhereNext(plan, Sees()))  # type: ignore[arg-type]
    advice = adviser.advise(range(256), plan.left_us(range(256)))
    assert advice is not None
    assert advice.why == "where intervals are wide: a second visit"
    assert all(plan[number].pass_ == 1 for number in advice.numbers)
    assert sum(plan[number].row == 5 for number in advice.numbers) == 16  # of 32: all of that row
    taken = [*range(256), *advice.numbers]
    later = adviser.advise(taken, plan.left_us(range(256)))
    assert later is not None
    assert not set(taken) & set(later.numbers)


def why(path: Path) -> list[Reason]:
    with Recording.open(path) as recording:
        return reasons([(event.kind, event.text) for event in recording.events()], len(recording))


def nlos(folder: Path, *words: str) -> str:
    return command.nlos(folder, *words, check=True).stdout


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded(tmp_path_factory.mktemp("adaptive"), ADAPTIVE)


def test_an_adaptive_scan_is_planned_taken_shown_verified_and_replayed(run: Path) -> None:
    folder = run.parent
    planned = nlos(folder, "plan", "scan.yaml")
    assert "at most 280 of 512 candidates" in planned
    assert "coarse to fine at 4 ms" in planned
    said = why(run)
    assert said[0].why == "coarse to fine: no advice in time"
    assert any(each.word == "spread evenly" for each in said)
    told = nlos(folder, "info", "run.h5")
    assert "points by reason" in told
    assert "spread evenly at" in told
    assert "; " in nlos(folder, "verify", "run.h5")
    nlos(folder, "replay", "run.h5", "--speed", "max", "-o", "again.h5")
    assert why(folder / "again.h5") == said
    with Recording.open(run) as first, Recording.open(folder / "again.h5") as second:
        pairs = list(zip(first.samples(), second.samples(), strict=True))
        assert all(a.point == b.point and (a.histogram.counts == b.histogram.counts).all() for a, b in pairs)


def test_a_scan_that_replaces_another_is_advised_by_its_own_light_alone(run: Path, tmp_path: Path) -> None:
    again = Path(shutil.copy(run, tmp_path / "run.h5"))
    nlos(tmp_path, "scan", str(run.parent / "scan.yaml"), "-o", "run.h5", "--overwrite")
    with Recording.open(run) as first, Recording.open(again) as second:
        assert [each.point for each in second.samples()] == [each.point for each in first.samples()]
    assert why(again) == why(run)


def test_every_other_verb_opens_it(run: Path) -> None:
    folder = run.parent
    nlos(folder, "report", "run.h5", "-o", "page.html")
    assert "Why each point was taken" in (folder / "page.html").read_text()
    nlos(folder, "export", "run.h5", "--to", "npz", "-o", "out.npz")
    with Recording.open(run) as recording, np.load(folder / "out.npz") as held:
        transient = recording.transient()
        assert (held["histograms"] == np.moveaxis(transient.counts, 0, 2)).all()
        assert np.allclose(held["exposure_s"], transient.exposure_s)
    nlos(folder, "reconstruct", "run.h5", "--method", "lct", "-o", "seen")
    nlos(folder, "calibrate", "run.h5", "-o", "constants.h5")


def test_resuming_a_complete_one_takes_nothing(run: Path) -> None:
    before = run.read_bytes()
    assert "nothing was left to take" in nlos(run.parent, "scan", "scan.yaml", "-o", "run.h5", "--resume")
    assert run.read_bytes() == before


def test_a_second_look_is_taken_by_width(tmp_path: Path) -> None:
    path = recorded(tmp_path, SECOND_LOOK)
    said = why(path)
    assert (said[0].why, said[0].count) == ("the first pass", 256)
    assert {each.word for each in said[1:]} == {"where intervals are wide"}
    assert sum(each.count for each in said[1:]) == 64
    with Recording.open(path) as recording:
        points = [sample.point for sample in recording.samples()]
    assert [point.number for point in points[:256]] == list(range(256))
    assert {point.pass_ for point in points[256:]} == {1}
    assert len({point.number for point in points}) == 320


def test_the_scan_that_ships_is_adaptive() -> None:
    plan = load("scan", "adaptive", ScanSettings).settings.plan()
    assert plan.budget is not None
    assert plan.most_samples < len(plan)


def test_killed_and_resumed_it_goes_on_within_its_time(tmp_path: Path) -> None:
    text = ADAPTIVE.replace("rows: 16, cols: 16", "rows: 48, cols: 48").replace("seconds: 1.5", "seconds: 12")
    (tmp_path / "scan.yaml").write_text(text)
    run, words = tmp_path / "run.h5", [sys.executable, "-m", "nlos", "scan", "scan.yaml", "-o", "run.h5"]
    with subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as scanning:
        held = 0
        while held < 200 and scanning.poll() is None:
            time.sleep(0.01)
            if run.exists():
                with Recording.open(run) as recording:
                    held = recording.acknowledged
        scanning.kill()
    assert scanning.returncode == -signal.SIGKILL
    with Recording.open(run) as recording:
        before, plan = [sample.point.number for sample in recording.samples()], recording.plan
        assert recording.missing()
    nlos(tmp_path, "scan", "scan.yaml", "-o", "run.h5", "--resume")
    with Recording.open(run) as recording:
        after = [sample.point.number for sample in recording.samples()]
        assert recording.status.name == "COMPLETE"
    assert after[: len(before)] == before
    assert len(set(after)) == len(after) > len(before)
    assert 0 <= plan.left_us(after) < 5000 + 4000
    assert sum(each.count for each in why(run)) == len(after)


def test_from_python_the_light_advises(tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(ADAPTIVE)
    with open_bench("simulated") as bench:
        samples = list(scan(tmp_path / "scan.yaml", bench, output=tmp_path / "run.h5"))
    assert {each.word for each in why(tmp_path / "run.h5")} == {"coarse to fine", "spread evenly"}
    assert len({sample.point.number for sample in samples}) == len(samples)
