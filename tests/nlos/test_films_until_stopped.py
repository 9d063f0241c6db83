"""Films whose number of frames nobody says beforehand: stopped by hand, killed, gone on with, served, on a full disk.
Read back by h5py, which knows nothing of them."""

import json
import multiprocessing
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
import yaml

import nlos
from nlos import scan_ending
from nlos.acquisition.errors import PlanRefused, StorageError
from nlos.acquisition.planning import frames as frames_module
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording import rescue
from nlos.acquisition.recording.frames import frame_table
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import Resumed, end_film, recover
from nlos.acquisition.recording.same_scan import ResumeRefused
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.alarms import free_bytes
from nlos.acquisition.served.served_copy import copy_served
from nlos.configs.load import find
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.film import film_of
from nlos.live.film import LiveFilm
from nlos.recipe import Recipe
from nlos.response import AUTO
from nlos.scan_preparation import PreparedScan, free_to_end
from tests.acquisition.serving import serving
from tests.command import nlos as command
from tests.nlos.bench_films import WORDS, plan_of, taken_by_hand

UNTIL = {**WORDS, "frames": "until_stopped"}
EACH = 144
HISTOGRAM = {"bin_width_ps": 4}


@pytest.fixture(autouse=True)
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A film that is not stopped would end after 40 frames."""
    monkeypatch.setattr(frames_module, "MOST_VISITS", 40 * EACH)


@pytest.fixture
def film(tmp_path: Path) -> Path:
    path = tmp_path / "film.yaml"
    path.write_text(yaml.safe_dump(UNTIL))
    return path


def taken(film: Path, run: Path, samples: int, resume: bool = False) -> list[Sample]:
    return taken_by_hand("moving", film, run, samples, resume)


def plan_in(run: Path) -> ScanPlan:
    with Recording.open(run) as recording:
        return recording.plan


def held_by_h5py(run: Path) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and counts of all rows that there are."""
    with h5py.File(run) as file:
        return file["samples/records"]["number"], file["samples/counts"][:]


def test_a_plan_lists_whole_rounds_as_a_recording_holds(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = plan_of(UNTIL)
    assert (plan.until_stopped, plan.frames, plan.cycle) == (True, 40, 1)
    assert plan != plan_of({**WORDS, "frames": 40})
    assert plan.ended_after(8 * EACH) == plan_of(WORDS)
    interleaved = plan_of({**UNTIL, "interleave": 16})
    assert (interleaved.frames, interleaved.cycle) == (40 * 16, 16)
    monkeypatch.undo()
    fine = {**UNTIL, "wall": {**WORDS["wall"], "rows": 64, "cols": 64}, "histogram": {**HISTOGRAM, "bins": 4096}}
    assert plan_of(fine).frames == (8 << 30) // (4 * 4096 * 4096) == 128
    large = {**UNTIL, "wall": {**WORDS["wall"], "rows": 150, "cols": 150}, "histogram": {**HISTOGRAM, "bins": 65536}}
    with pytest.raises(PlanRefused, match="a single frame of 22500 points"):
        plan_of(large)


@pytest.mark.parametrize("frames", ["until stopped", "forever", 0, 1.5])
def test_words_that_are_no_number_of_frames_are_refused(frames: object) -> None:
    with pytest.raises(ValueError, match="frames"):
        ScanSettings.model_validate({**WORDS, "frames": frames})


@pytest.mark.parametrize(("parts", "points"), [(1, EACH + 16), (4, EACH + 6), (16, EACH + 2), (1, 2 * EACH + 1)])
def test_a_part_of_a_frame_is_known_by_the_frame_a_round_before(parts: int, points: int) -> None:
    """Also where it is the first that comes again."""
    plan = plan_of({**UNTIL, "interleave": parts}).ended_after(points)
    assert plan.cycle == parts
    assert (plan.frame_points == EACH // parts).all()
    assert plan.first_round == EACH


@pytest.mark.parametrize("rest", [0, 50])
def test_a_film_that_is_stopped_is_a_recording_of_its_frames(film: Path, tmp_path: Path, rest: int) -> None:
    run = tmp_path / "run.h5"
    got = taken(film, run, 5 * EACH + rest)
    found = verify(run)
    assert (found.status, found.complete) == (Status.COMPLETE, True)
    number, counts = held_by_h5py(run)
    assert number.tolist() == list(range(len(number)))  # what was taken and not handed on any more is kept as well
    assert len(got) <= len(number) < len(got) + EACH
    for sample in got:
        assert np.array_equal(counts[sample.point.number], sample.histogram.counts)
    with Recording.open(run) as recording:
        table = frame_table(recording.plan, recording.intact_records())
        events = [(event.kind, event.text) for event in recording.events()]
    assert table.complete == len(number) // EACH
    assert (table.planned == EACH).all()
    assert ("film", f"ended in frame {recording.plan.frames - 1}: {len(number)} samples") in events
    pictures = film_of(run, Recipe("lct"))
    assert pictures.frame.tolist() == list(range(len(number) // EACH))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["film.yaml", "run.h5"]


AXIS = {"bins": 64, "bin_width_ps": 256, "offset_ns": 9.6}
SMALL = {**UNTIL, "wall": {**WORDS["wall"], "rows": 8, "cols": 8}, "histogram": AXIS}
WAYS = {
    "stepped by the host": ("optotune", {}),
    "the counter's clock": ("zero_latency", {"interleave": 4}),
    "sorted out of photons": ("multiharp", {"histogram": {**AXIS, "bin_width_ps": 320}}),
    "the mirror's own clock": ("helios", {}),
    "continuous lines": (
        "zero_latency", {"wall": {**WORDS["wall"], "rows": 4, "cols": 24}, "dwell_ms": 0.2, "continuous": {}}
    ),
    "off the grid": ("zero_latency", {"pattern": {"kind": "circle", "points": 48, "radius_m": 0.4}}),
    "stopped at counts": ("zero_latency", {"exposure": {
        "kind": "stop_at_counts", "counts": 20, "from_ns": 11.0, "to_ns": 24.0}}),
}  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
def test_it_ends_well_in_every_scheme_with_every_point_where_the_beam_was(way: str, tmp_path: Path) -> None:
    bench, words = WAYS[way]
    film, run = tmp_path / "film.yaml", tmp_path / "run.h5"
    film.write_text(yaml.safe_dump({**SMALL, **words}))
    beams: dict[int | None, MirrorAngles] = {}
    with nlos.open_bench(bench) as there:
        assert there.simulated is not None
        there.simulated.on_gate = lambda gate, beam: beams.setdefault(gate.number, beam)
        coming = nlos.scan(film, there, output=run)
        each = plan_of({**SMALL, **words}).first_round
        for _ in range(2 * each + 5):
            next(coming)
        coming.close()
        plan = plan_in(run)
        angles = checked_angles(plan, there, aim_of(there))
    assert (verify(run).complete, plan.until_stopped) == (True, False)
    number, _ = held_by_h5py(run)
    assert sorted(number.tolist()) == list(range(len(plan)))
    assert len(plan) >= 2 * each + 5
    pitch_rad = np.ptp([one.x_rad for one in angles]) / 23
    within_rad = pitch_rad / 2 if "lines" in way else 2e-3
    for one in number.tolist():
        beam = beams[one]
        assert abs(beam.x_rad - angles[one].x_rad) < within_rad, one
        assert abs(beam.y_rad - angles[one].y_rad) < within_rad, one


def test_it_takes_place_as_it_goes(film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    run = tmp_path / "run.h5"
    with nlos.open_bench("moving") as bench:
        coming = nlos.scan(film, bench, output=run)
        for _ in range(3 * EACH):
            next(coming)
        held = run.stat()
        coming.close()
    assert held.st_size > 4e9
    assert held.st_blocks * 512 < 0.05 * held.st_size
    assert run.stat().st_size < 1e7
    assert verify(run).complete


def test_a_film_that_was_stopped_goes_on(film: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    first = taken(film, run, 2 * EACH + 30)
    before, _ = held_by_h5py(run)
    more = taken(film, run, 2 * EACH, resume=True)
    number, counts = held_by_h5py(run)
    assert number.tolist() == list(range(len(number)))
    assert len(number) >= len(before) + len(more)
    assert more[0].point.number == len(before)
    for sample in (*first, *more):
        assert np.array_equal(counts[sample.point.number], sample.histogram.counts)
    assert verify(run).complete
    with pytest.raises(StorageError, match="exists"):
        taken(film, run, 1)


def test_a_second_frame_that_is_cut_off_is_none(film: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    taken(film, run, EACH + 10)
    found = verify(run)
    assert (found.complete, found.frames, found.complete_frames) == (True, 2, 1)
    assert film_of(run, Recipe("lct")).frame.tolist() == [0]


def test_another_film_is_refused_by_what_differs(film: Path, tmp_path: Path) -> None:
    run, other = tmp_path / "run.h5", tmp_path / "other.yaml"
    taken(film, run, 2 * EACH)
    other.write_text(yaml.safe_dump({**UNTIL, "dwell_ms": 2}))
    with pytest.raises(ResumeRefused, match=r"dwell_s of point 0: 0\.001 then, 0\.002 now"):
        taken(other, run, 1, resume=True)


def test_a_film_is_resumed_where_its_link_leads(film: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    real, link = tmp_path / "elsewhere" / "real.h5", tmp_path / "link.h5"
    taken(film, real, 2 * EACH)
    before = len(held_by_h5py(real)[0])
    link.symlink_to(real)
    taken(film, link, EACH, resume=True)
    assert link.is_symlink()
    assert len(held_by_h5py(real)[0]) > before
    assert verify(real).complete


def test_less_than_a_frame_is_no_film(film: Path, tmp_path: Path) -> None:
    """It stays what it was to be, and goes on; what is told of it is of the first frame, not of all that could come."""
    run = tmp_path / "run.h5"
    taken(film, run, 20)
    assert plan_in(run) == plan_of(UNTIL)
    found = verify(run)
    assert (found.status, found.frames, len(found.missing)) == (Status.INTERRUPTED, 1, EACH - found.written)
    taken(film, run, 3 * EACH, resume=True)
    assert verify(run).complete
    assert plan_in(run).frames >= 3


def test_a_film_that_nobody_stops_ends_where_the_recording_is_full(tmp_path: Path) -> None:
    (tmp_path / "film.yaml").write_text(yaml.safe_dump({**UNTIL, "wall": {**WORDS["wall"], "rows": 24, "cols": 24}}))
    run = tmp_path / "run.h5"
    with nlos.open_bench("moving") as bench:
        assert sum(1 for _ in nlos.scan(tmp_path / "film.yaml", bench, output=run)) == 10 * 576
    found = verify(run)
    assert (found.status, found.complete, found.complete_frames) == (Status.COMPLETE, True, 10)


def test_in_a_series_nobody_would_stop_it(film: Path, tmp_path: Path) -> None:
    refused = command(tmp_path, "scan", film.name, "--sweep", "dwell_ms=1,2", "-o", "series")
    assert refused.returncode == 2
    assert "nobody stops the scans of a series" in refused.stderr
    assert not (tmp_path / "series").exists()


def test_what_a_copy_that_was_killed_left_is_cleared_by_recovering(film: Path, tmp_path: Path) -> None:
    run, left = tmp_path / "run.h5", tmp_path / f"run.h5.{'0' * 16}.new"
    taken(film, run, 20)
    left.write_bytes(b"half a copy")
    recover(run, tmp_path / "saved.h5")
    assert not left.exists()


def test_room_for_the_end_is_kept_free(film: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    taken(film, run, 20)
    here = free_to_end(run, tmp_path)
    assert here <= free_bytes(tmp_path) - 512 * run.stat().st_blocks + (1 << 20)
    assert free_to_end(tmp_path / "other.h5", tmp_path) > here


def _killed(film: Path, run: Path) -> None:
    with nlos.open_bench("moving") as bench:
        for number, _ in enumerate(nlos.scan(film, bench, output=run)):
            if number == 3 * EACH + 100:
                os.kill(os.getpid(), signal.SIGKILL)


def test_a_killed_film_goes_on_or_is_recovered(film: Path, tmp_path: Path) -> None:
    run, saved = tmp_path / "run.h5", tmp_path / "saved.h5"
    child = multiprocessing.get_context("fork").Process(target=_killed, args=(film, run))
    child.start()
    child.join(240)
    assert child.exitcode == -signal.SIGKILL
    samples = recover(run, saved)
    assert plan_in(run).until_stopped
    assert plan_in(saved) == plan_of(UNTIL).ended_after(samples)
    assert verify(saved).complete
    assert verify(saved).complete_frames == 3
    taken(film, run, EACH, resume=True)
    assert verify(run).complete
    assert np.array_equal(held_by_h5py(run)[1][:samples], held_by_h5py(saved)[1])


def test_a_disk_without_room_for_the_end_leaves_the_film_as_it_is(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Path:
        raise StorageError("no room")

    run = tmp_path / "run.h5"
    monkeypatch.setattr(rescue, "lay_out", full)
    with nlos.open_bench("moving") as bench:
        coming = nlos.scan(film, bench, output=run)
        for _ in range(2 * EACH + 20):
            next(coming)
        coming.close()
    found = verify(run)
    assert (found.status, found.intact, plan_in(run).until_stopped) == (Status.INTERRUPTED, True, True)
    with pytest.raises(StorageError, match=r"was not cut .* `nlos recover .*run\.h5 -o NEW\.h5`, on a disk with room"):
        end_film(run)
    monkeypatch.undo()
    monkeypatch.setattr(frames_module, "MOST_VISITS", 40 * EACH)
    shorter = tmp_path / "shorter.yaml"
    shorter.write_text(yaml.safe_dump({**UNTIL, "frames": 2}))
    with pytest.raises(ResumeRefused, match="its plan"):  # more than its frames is taken
        taken(shorter, run, 1, resume=True)
    taken(film, run, EACH, resume=True)
    assert verify(run).complete


@pytest.mark.parametrize("takes_long", [False, True])
@pytest.mark.parametrize("when", ["before", "after"])
def test_a_signal_while_the_file_is_finished_leaves_no_film_uncut(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, when: str, takes_long: bool
) -> None:
    """A second Ctrl-C waits until the last of the file is written: a film is ended before it goes on, unless copying
    it takes long; then it is as it was, and recovered later."""
    finish, run = RecordingWriter.finish, tmp_path / "run.h5"
    if takes_long:
        monkeypatch.setattr(scan_ending, "LONG_BYTES", 0)

    def finish_and_interrupt(writer: RecordingWriter, status: Status) -> None:
        if when == "before":
            signal.raise_signal(signal.SIGINT)
        finish(writer, status)
        if when == "after":
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(RecordingWriter, "finish", finish_and_interrupt)
    with pytest.raises(KeyboardInterrupt):
        taken(film, run, 2 * EACH + 20)
    assert plan_in(run).until_stopped == takes_long
    if takes_long:
        assert verify(run).status is Status.INTERRUPTED
        recover(run, run := tmp_path / "saved.h5")
    found = verify(run)
    assert (found.complete, found.complete_frames) == (True, plan_in(run).frames - (len(plan_in(run)) % EACH > 0))


def test_a_film_that_is_stopped_in_its_first_frame_is_not_called_full(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = RecordingWriter.write

    def write_and_interrupt(writer: RecordingWriter, sample: Sample) -> None:
        write(writer, sample)
        if sample.point.number == 20:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(RecordingWriter, "write", write_and_interrupt)
    done = command(tmp_path, "scan", film.name, "--bench", "moving", "-o", "run.h5")
    assert done.returncode == 130, done.stderr
    assert re.match(r"run\.h5: \d+ of 5760 points in [\d.]+ s of bench time \([\d.]+ s predicted\)\n", done.stdout)
    assert "--resume" in done.stderr


def test_ctrl_c_after_the_very_last_sample_ends_a_film_as_any_other(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frames_module, "MOST_VISITS", 2 * EACH)
    write = RecordingWriter.write

    def write_and_interrupt(writer: RecordingWriter, sample: Sample) -> None:
        write(writer, sample)
        if sample.point.number == 2 * EACH - 1:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(RecordingWriter, "write", write_and_interrupt)
    done = command(tmp_path, "scan", film.name, "--bench", "moving", "-o", "run.h5", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["status"], told["points"], told["frames"]) == ("complete", 2 * EACH, 2)
    assert verify(tmp_path / "run.h5").complete


def test_ctrl_c_while_a_film_is_opened_to_go_on_ends_it_as_any_other(
    film: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Opening a long film takes a while. What is there is a film already: the command says so and makes its picture."""
    begin, run = PreparedScan.begin, tmp_path / "run.h5"
    taken(film, run, 2 * EACH + 30)
    before = len(held_by_h5py(run)[0])

    def begin_and_interrupt(prepared: PreparedScan) -> Resumed:
        begun = begin(prepared)
        signal.raise_signal(signal.SIGINT)
        return begun

    monkeypatch.setattr(PreparedScan, "begin", begin_and_interrupt)
    again = ("scan", film.name, "--bench", "moving", "-o", "run.h5", "--resume", "--reconstruct", "lct", "--json")
    done = command(tmp_path, *again)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["status"], told["taken"], told["points"]) == ("complete", 0, before)
    assert (tmp_path / "run" / "reconstruction.h5").exists()
    assert verify(run).complete


def test_a_copy_of_a_served_film_ends_with_it(film: Path, tmp_path: Path) -> None:
    run, far = tmp_path / "run.h5", tmp_path / "far.h5"
    with nlos.open_bench("moving") as bench:
        coming = nlos.scan(film, bench, output=run)
        for _ in range(2 * EACH):
            next(coming)
        with serving(run) as server:
            ticket = server.ticket
            copied = multiprocessing.get_context("fork").Process(target=copy_served, args=(ticket, far))
            copied.start()
            coming.close()
            copied.join(240)
            assert copied.exitcode == 0
            assert copy_served(ticket, far) == len(plan_in(run))  # once more: there is nothing left to copy
    assert plan_in(far) == plan_in(run)
    for one, other in zip(held_by_h5py(far), held_by_h5py(run), strict=True):
        assert np.array_equal(one, other)


def test_a_part_of_its_last_frame_is_no_picture_in_replay(film: Path, tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    taken(film, run, 3 * EACH + 40)
    with Recording.open(run) as recording:
        live = LiveFilm(recording.plan, None, AUTO)
        for sample in recording.samples():
            live.add(sample)
        live.finish()
        assert recording.plan.frames == 4
    assert live.over == 2


@pytest.fixture(params=[1, 2])
def stopped(film: Path, tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[tuple[int, str, str]]:
    """The command, told to stop once some frames are taken, once or twice in a hurry."""
    witness = tmp_path / "witness.txt"
    bench = find("bench", "moving").read_text()
    (tmp_path / "bench.yaml").write_text(bench.replace("simulation:\n", f"simulation:\n  witness: {witness}\n"))
    child = subprocess.Popen(
        [sys.executable, "-m", "nlos", "scan", film, "--bench", "bench.yaml", "-o", "run.h5", "--reconstruct", "lct"],
        cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    )  # fmt: skip
    try:
        until_s = time.monotonic() + 240
        while not (witness.exists() and witness.read_text().count("beam to") > 9 * EACH) and time.monotonic() < until_s:
            time.sleep(0.01)
        for _ in range(request.param):
            child.send_signal(signal.SIGINT)
            time.sleep(0.02)
        told, said = child.communicate(timeout=240)
        yield child.returncode, told, said
    finally:
        child.kill()
        child.wait()


@pytest.mark.sampled(2)
def test_the_command_ends_well_when_it_is_stopped(stopped: tuple[int, str, str], tmp_path: Path) -> None:
    """Exit 0, and on to the picture: that is how such a film ends."""
    code, told, said = stopped
    assert code == 0, said
    assert "until stopped, at most" in said
    plan = plan_in(tmp_path / "run.h5")
    assert f"run.h5: {len(plan) // EACH} frames{' and a part of one' if len(plan) % EACH else ''}, " in told
    assert (tmp_path / "run" / "reconstruction.h5").exists()
    witness = (tmp_path / "witness.txt").read_text()
    assert witness.rindex("shutter closed") > witness.rindex("shutter open")
