"""A scan that ends by its picture and is resumed: what was decided stands, and what broke it off changes nothing."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from nlos.acquisition.recording.ended_as_asked import AS_ASKED, status_word
from nlos.acquisition.recording.recording import Recording
from nlos.live.goal import Goal
from nlos.live.good_enough import Enough
from nlos.live.looks_before import ended_before, looks_before
from nlos.live.process import state_file, write_state
from nlos.live.resumed import picture_before
from nlos.live.so_far import new_scan
from nlos.recipe import Recipe
from nlos.recon.live import LiveReconstruction
from nlos.response import AUTO
from tests.changed_bench import bench_file
from tests.command import nlos

GRID = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: coarse_to_fine, batch: 16}
dwell_ms: 8
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
TWO_PASS = GRID + "exposure: {kind: two_pass, counts: 1150, again_ms: 40}\n"
ADAPTIVE = GRID.replace("coarse_to_fine, batch: 16", "adaptive, seconds: 1.0, step_ms: 0.7")


@pytest.fixture(autouse=True)
def without_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """There the picture that is looked at is LCT's, also where none is asked for at the end."""
    monkeypatch.setattr("nlos.live.process.torch_is_installed", lambda: False)


def scan(folder: Path, name: str, level: str | None, *words: str, faults: object = ()) -> tuple[int, dict[str, Any]]:
    """The exit code of `nlos scan` until the picture by LCT is that stable, and its document."""
    bench = bench_file(folder, {"simulation.faults": list(faults)})  # type: ignore[call-overload]
    until = () if level is None else ("--until", f"stable:{level}")
    done = nlos(folder, "--json", "scan", "scan.yaml", "--bench", bench, "-o", name, *until, *words)
    return done.returncode, json.loads(done.stdout)


def held(path: Path) -> dict[int, bytes]:
    with Recording.open(path) as recording:
        return {sample.point.number: sample.histogram.counts.tobytes() for sample in recording.samples()}


@pytest.mark.sampled(3)
@pytest.mark.parametrize("text", [GRID, TWO_PASS, ADAPTIVE], ids=["grid", "two_pass", "adaptive"])
def test_a_scan_that_ended_by_its_picture_takes_nothing_more_unless_more_is_asked(tmp_path: Path, text: str) -> None:
    (tmp_path / "scan.yaml").write_text(text)
    code, first = scan(tmp_path, "run.h5", "0.3")
    assert (code, first["status"]) == (0, AS_ASKED)
    before = (tmp_path / "run.h5").read_bytes()
    for level in ("0.3", "0.4"):
        code, said = scan(tmp_path, "run.h5", level, "--resume")
        assert (code, said["taken"], said["status"], said["until"]["reached"]) == (0, 0, AS_ASKED, True)
    assert (tmp_path / "run.h5").read_bytes() == before
    code, more = scan(tmp_path, "run.h5", "0.07", "--resume")
    assert (code, more["status"]) == (0, AS_ASKED)
    assert first["points"] < more["points"] < more["planned"]
    code, everything = scan(tmp_path, "run.h5", None, "--resume")
    assert (code, everything["status"]) == (0, "complete")


def test_its_picture_is_left_where_it_is_or_made_where_there_is_none(tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(GRID)
    assert scan(tmp_path, "run.h5", "0.3")[0] == 0
    for _ in range(2):
        code, said = scan(tmp_path, "run.h5", "0.3", "--resume", "--reconstruct", "lct")
        assert (code, said["taken"]) == (0, 0)
        assert (tmp_path / "run" / "reconstruction.h5").exists()


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("text", "level", "after_s", "again"),
    [(GRID, "0.1", 0.35, 0), (TWO_PASS, "0.3", 0.6, 0), (TWO_PASS, "0.3", 0.8, 3)],
    ids=["grid", "between two passes", "second pass"],
)
def test_a_scan_that_was_broken_off_ends_at_the_same_point_when_it_is_resumed(
    tmp_path: Path, text: str, level: str, after_s: float, again: int
) -> None:
    """In a second pass, too: the first, which was ended early, is not taken up again."""
    (tmp_path / "scan.yaml").write_text(text)
    assert scan(tmp_path, "whole.h5", level)[0] == 0
    fault = {"name": "U13", "after_s": after_s, "parameters": {"errors": 1}}
    assert scan(tmp_path, "run.h5", level, faults=[fault])[0] == 3
    there, whole = held(tmp_path / "run.h5"), held(tmp_path / "whole.h5")
    assert 0 < len(there) < len(whole)
    assert sum(number >= 256 for number in there) == again
    code, said = scan(tmp_path, "run.h5", level, "--resume")
    assert (code, said["status"]) == (0, AS_ASKED)
    assert list(held(tmp_path / "run.h5")) == list(whole)
    assert held(tmp_path / "run.h5") == whole


def test_what_another_time_axis_hides_from_the_first_look_is_seen_before_the_light(tmp_path: Path) -> None:
    """A plan that the counter has to fit is known once the bench is open."""
    (tmp_path / "scan.yaml").write_text(GRID.replace("bin_width_ps: 32", "bin_width_ps: 32.1"))
    code, first = scan(tmp_path, "run.h5", "0.3")
    assert (code, first["status"]) == (0, AS_ASKED)
    code, said = scan(tmp_path, "run.h5", "0.3", "--resume")
    assert (code, said["taken"], said["points"], said["status"]) == (0, 0, first["points"], AS_ASKED)
    with Recording.open(tmp_path / "run.h5") as recording:
        assert status_word(recording) == AS_ASKED
        assert [event.text for event in recording.events() if event.text.startswith("open")] == ["opened"], "more light"


def test_pictures_of_another_kind_decide_nothing(tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(GRID)
    assert scan(tmp_path, "run.h5", "0.3")[0] == 0
    with Recording.open(tmp_path / "run.h5") as recording:
        plan = recording.plan
        stable, sure = Goal("stable", 0.3), Goal("sure", 0.9)
        looks = looks_before(recording, stable, "lct")
        assert [look.enough for look in looks] == [False] * (len(looks) - 1) + [True]
        assert looks_before(recording, stable, "nano") == looks_before(recording, sure, "lct") == []
    assert ended_before(tmp_path / "run.h5", plan, stable, "lct") == looks[-1]
    assert ended_before(tmp_path / "run.h5", plan, stable, "nano") is None
    assert ended_before(tmp_path / "none.h5", plan, stable, "lct") is None


def test_a_real_bench_takes_its_decisions_from_the_recording_alone(tmp_path: Path) -> None:
    """Its pictures are the live process's, which begins anew: nothing is judged before a quarter more points."""
    (tmp_path / "scan.yaml").write_text(GRID)
    assert scan(tmp_path, "run.h5", "0.3")[0] == 0
    run = tmp_path / "run.h5"
    with Recording.open(run) as recording:
        plan, held_now = recording.plan, len(recording)
    said: list[str] = []
    for level, decided in ((0.3, [held_now]), (0.07, [])):
        enough = Enough(
            plan, new_scan(plan, {}), Goal("stable", level), Recipe("lct"), lambda kind, text: said.append(text), run
        )
        enough.catch_up(run)
        assert enough.decided == decided
        assert enough.reached == bool(decided)
        figures = {"change": 0.01, "error": 0.01, "bound": None}
        state_file(run).write_text(json.dumps({"samples": held_now + 1, **figures}))
        assert not enough()
        assert said == []
        assert enough.wait_in_the_dark(lambda: False)
        state_file(run).write_text(json.dumps({"samples": 1, **figures}))
        assert enough.wait_in_the_dark(lambda: False) == bool(decided), "nothing to wait for, or it does not come"


@pytest.fixture
def page_at_once(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Scans as of a real bench, whose live process has made its pictures by the time it is looked for; of how many
    samples each is."""
    made: list[int] = []

    def start(run: Path, method: object, weights: object, response: str, constants: object, before: int) -> object:
        live = LiveReconstruction("lct")
        with Recording.open(run) as recording:
            held = len(recording)
        for samples in dict.fromkeys((before, held)) if before else ():
            picture = picture_before(run, samples, live, None, AUTO)
            assert picture is not None
            write_state(state_file(run), picture)
            made.append(picture.samples)
        return SimpleNamespace(poll=lambda: None, pid=1)

    monkeypatch.setattr("nlos.cli.taking.start_live", start)
    monkeypatch.setattr("nlos.cli.taking._Watching._watched", staticmethod(lambda scan: scan.request.target))
    return made


def test_a_real_bench_whose_picture_was_good_enough_when_it_was_broken_off_takes_no_more_light(
    tmp_path: Path, page_at_once: list[int]
) -> None:
    """The picture that is due is compared with one of a quarter fewer points, as it would have been; both are made
    before the light."""
    (tmp_path / "scan.yaml").write_text(GRID)
    fault = {"name": "U13", "after_s": 0.8, "parameters": {"errors": 1}}
    assert scan(tmp_path, "run.h5", None, faults=[fault])[0] == 3
    before = held(tmp_path / "run.h5")
    code, said = scan(tmp_path, "run.h5", "0.3", "--resume", "--live")
    assert page_at_once == [int(len(before) / 1.25), len(before)]
    assert (code, said["status"], said["taken"]) == (0, AS_ASKED, 0)
    assert held(tmp_path / "run.h5") == before
    code, said = scan(tmp_path, "run.h5", "0.001", "--resume", "--live")
    assert (code, said["status"]) == (0, "complete")
    assert page_at_once[2:] == [len(before)], "which was judged, and is what the next one is compared with"
