"""Samples as they come add up to what the finished recording says, and a scan ends when that is good enough."""

import json
import logging
import subprocess
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.calibration.constants import load
from nlos.calibration.correct import correct_known, correct_points
from nlos.calibration.known_arrivals import common_bins
from nlos.calibration.raw_points import from_samples
from nlos.calibration.told import told_to
from nlos.chain import calibrate_scan, constants_for
from nlos.cli.exit_codes import UsageError
from nlos.drivers.clock import SystemClock
from nlos.drivers.tcspc.counter import HistogramFlag
from nlos.live.answers import ScanAnswers
from nlos.live.calibration import SampleCalibration
from nlos.live.file_seen import Seen
from nlos.live.gathered import nothing_yet
from nlos.live.goal import LEVELS, STABLE, SURE, Goal, parse_until
from nlos.live.good_enough import Enough
from nlos.live.pace import Pace
from nlos.live.process import state_file, write_state
from nlos.live.scan import LiveScan
from nlos.live.so_far import new_scan
from nlos.loaded import load_scan
from nlos.recipe import Recipe
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.live import LivePicture, LiveReconstruction
from nlos.recon.reconstruct import reconstruct
from nlos.response import AUTO
from nlos.said_once import SaidOnce
from nlos.time_left import TimeLeft
from tests.scan_texts import COARSE_TO_FINE, EIGHT_BY_EIGHT, recorded

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]

TWO_PASS = COARSE_TO_FINE + "exposure: {kind: two_pass, counts: 100000, again_ms: 20}\n"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return recorded(tmp_path, COARSE_TO_FINE)


def test_samples_corrected_one_by_one_add_up_to_all_corrected_at_once(nlos: Nlos, run: Path, tmp_path: Path) -> None:
    done = nlos("calibrate", "run.h5", "-o", "constants.h5")
    assert done.returncode == 0, done.stderr
    constants = load(tmp_path / "constants.h5")
    with Recording.open(run) as recording:
        plan, samples = recording.plan, list(recording.samples())
    each = SampleCalibration(plan, constants)
    for index in np.random.default_rng(3).permutation(len(samples)):
        each.add(samples[index])
    raw = from_samples(samples)
    at_once = correct_known(raw, constants, common_bins(constants, raw.x_m, raw.y_m, raw.time))
    rows, cols = [s.point.row for s in samples], [s.point.col for s in samples]
    came = each.transient()
    assert np.abs(came.counts[:, rows, cols].T - at_once.counts).max() <= 1e-5 * np.abs(at_once.counts).max()
    assert np.allclose(came.exposure_s[rows, cols], at_once.exposure_s, rtol=1e-9, atol=0)
    assert came.time == at_once.time


def test_samples_corrected_one_by_one_show_a_wall_as_even_as_the_finished_recording_will(
    nlos: Nlos, run: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    done = nlos("calibrate", "run.h5", "-o", "constants.h5")
    assert done.returncode == 0, done.stderr
    constants = load(tmp_path / "constants.h5")
    with Recording.open(run) as recording:
        plan, samples = recording.plan, list(recording.samples())
    assert constants.arrivals is not None
    axis, random = plan.axis, np.random.default_rng(4)
    time_s = axis.offset_s + np.arange(axis.bins) * axis.bin_width_s
    each, seen = SampleCalibration(plan, constants), []
    tiles = np.where((np.indices((plan.wall.rows, plan.wall.cols)) // 2).sum(axis=0) % 2, 1.0, 0.4)
    for sample in samples:
        point, histogram = sample.point, sample.histogram
        white, direct_s = tiles[point.row, point.col], float(constants.arrivals.at(point.x_m, point.y_m)) + 0.8e-9
        counts = random.binomial(histogram.counts, np.where(time_s < direct_s, white, white**2)).astype(np.uint32)
        seen.append(replace(sample, histogram=replace(histogram, counts=counts)))
        each.add(seen[-1])
    with caplog.at_level(logging.WARNING), told_to(SaidOnce()):
        pictures = [each.transient() for _ in range(3)]
    assert caplog.text.count("hidden light follows its square") == 1
    whole = correct_points(from_samples(seen))
    assert whole.light is not None
    rows, cols = [s.point.row for s in samples], [s.point.col for s in samples]
    now, then = (light / np.median(light) for light in (pictures[-1].exposure_s[rows, cols], whole.exposure_s))
    assert np.std(np.log(now / then)) < 0.12
    caplog.clear()
    with Recording.open(run) as recording:
        gathered = nothing_yet(recording, None, AUTO, False, lambda words: None)
    for sample in seen:
        gathered.add(sample)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            gathered.calibrated(whole=False)
    assert caplog.text.count("hidden light follows its square") == 1


@pytest.mark.sampled(2)
@pytest.mark.parametrize("constants", [False, True])
def test_the_last_picture_is_that_of_the_finished_recording(
    nlos: Nlos, run: Path, tmp_path: Path, constants: bool
) -> None:
    known = None
    if constants:
        assert nlos("calibrate", "run.h5", "-o", "constants.h5").returncode == 0
        known = tmp_path / "constants.h5"
    pictures: list[LivePicture] = []
    watched = LiveScan(run, [LiveReconstruction()], known, on_picture=pictures.append)
    watched.start()
    watched.wait()
    scan = load_scan(run)
    batch = reconstruct(calibrate_scan(scan, constants=constants_for(scan, known)), "nano")
    assert [picture.samples for picture in pictures] == [256]
    last = pictures[-1].reconstruction
    assert np.abs(last.albedo - batch.albedo).max() <= 1e-5 * batch.albedo.max()
    assert np.allclose(last.depth_m, batch.depth_m, rtol=0, atol=1e-5, equal_nan=True)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_pictures_that_break_off_say_so(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(self: LiveReconstruction, *given: object) -> LivePicture:
        raise SystemError("of a kind that nobody expects")

    monkeypatch.setattr(LiveReconstruction, "update", broken)
    watched = LiveScan(run, [LiveReconstruction("lct")])
    watched.start()
    with pytest.raises(ReconstructionFailed, match=r"run.h5: the pictures stopped"):
        watched.wait()
    deadline_s = time.monotonic() + 240
    while not watched.read and time.monotonic() < deadline_s:  # the scan is read on, in a thread of its own
        time.sleep(0.02)
    state = ScanAnswers(watched).state()
    assert (state["over"], state["lost"], state["samples"]) == (False, True, 256)
    assert "the pictures stopped because of a bug" in state["message"]


@pytest.mark.parametrize(
    ("said", "age_s", "status", "light"),
    [("closed", 0, "paused", "off"), ("closed", 60, "unread", "maybe"), ("opened", 60, "unread", "maybe")],
)
def test_of_a_file_that_does_not_answer_any_more_nobody_knows_whether_its_laser_is_off(
    run: Path, tmp_path: Path, said: str, age_s: float, status: str, light: str
) -> None:
    """A network disk that hangs, say: what was read before the scan went on is not what is so."""
    with Recording.open(run) as recording:
        plan, header = recording.plan, recording.header
    with RecordingWriter.create(tmp_path / "paused.h5", plan, header) as writer:
        writer.log("shutter", said)
        writer.log("scan", "paused: Ctrl-C")
        writer.flush()
        watched = LiveScan(tmp_path / "paused.h5", [LiveReconstruction("lct")])
        with Recording.open(watched.run) as growing:
            watched.gathered = nothing_yet(growing, None, AUTO, False, print)
            watched.seen = replace(Seen.of(growing), looked_s=SystemClock().now() - age_s)
        state = ScanAnswers(watched).state()
    assert (state["status"], state["light"]) == (status, light)
    assert state["unread_s"] is None if age_s == 0 else state["unread_s"] >= age_s


def test_change_is_what_a_quarter_more_samples_did(run: Path) -> None:
    transient = calibrate_scan(load_scan(run))
    live = LiveReconstruction("lct", {"snr": 0.1})
    changes = [live.update(transient, samples).change for samples in (100, 110, 124, 125, 200)]
    assert changes[:3] == [1.0, 1.0, 1.0]
    assert changes[3:] == pytest.approx([0.0, 0.0], abs=1e-6)


def test_no_picture_is_begun_that_the_end_of_the_scan_would_overtake() -> None:
    pace = Pace()
    for hundredth in range(500):
        pace.saw(hundredth / 100)
    assert pace.left_s(100, 5.0) == pytest.approx(1.0, rel=0.02)
    assert pace.left_s(100, 8.0) == float("inf")  # the scan is paused


@pytest.mark.parametrize(
    "exposure",
    [
        "{kind: uniform}",
        "{kind: two_pass, counts: 100000, again_ms: 20}",
        "{kind: by_distance, x_m: 0.0, y_m: -0.5, z_m: 0.3}",
        "{kind: stop_at_counts, counts: 20, from_ns: 10.0, to_ns: 26.0}",
    ],
)
def test_after_a_quarter_of_the_points_a_page_knows_how_long_the_others_take(exposure: str, tmp_path: Path) -> None:
    """Whatever their dwells are: points to come may be ten times as long as those that came."""
    text = EIGHT_BY_EIGHT.replace("rows: 8, cols: 8", "rows: 24, cols: 24")
    run = recorded(tmp_path, text.replace("dwell_ms: 4", f"dwell_ms: 2\nexposure: {exposure}"))
    with Recording.open(run) as recording:
        held = nothing_yet(recording, None, AUTO, False, print)
        assert held.left_s is None
        expected_s = list[float]()
        for sample in recording.samples():
            held.add(sample)
            assert held.left_s is not None
            expected_s.append(held.elapsed_s + held.left_s)
    assert held.left_s == pytest.approx(0.0, abs=1e-9)
    assert expected_s[len(expected_s) // 4] == pytest.approx(held.elapsed_s, rel=0.3)


def test_a_scan_that_is_resumed_knows_how_long_the_points_it_still_has_take(tmp_path: Path) -> None:
    """Its first pass is taken, and the points of the second are five times as long."""
    run = recorded(tmp_path, TWO_PASS)
    with Recording.open(run) as recording:
        plan, samples = recording.plan, list(recording.samples())
    half = len(samples) // 2
    before, rest, quarter = samples[:half], samples[half:], half // 4
    ends_s = [sample.taken_s + sample.histogram.live_time_s for sample in samples[half - 1 :]]
    left = TimeLeft(plan, [sample.point.number for sample in before], ends_s[0])
    told = [left.times_as_long(sample) for sample in rest]
    expected = (ends_s[-1] - ends_s[quarter + 1]) / (ends_s[quarter + 1] - ends_s[0])
    assert told[quarter] == pytest.approx(expected, rel=0.3)
    assert told[-1] == pytest.approx(0.0, abs=1e-9)


def test_what_passes_before_the_first_point_is_no_pace(tmp_path: Path) -> None:
    """Minutes in which a lag was measured, or instruments were set up: 4096 points were said to take days."""
    with Recording.open(recorded(tmp_path, EIGHT_BY_EIGHT)) as recording:
        plan, samples = recording.plan, list(recording.samples())
    left, late = TimeLeft(plan), TimeLeft(plan)
    for sample in samples[:-1]:
        left.passed(sample)
        left.took(sample)
        late.passed(replace(sample, taken_s=sample.taken_s + 9.0))
        late.took(sample)
        assert late.left_s == pytest.approx(left.left_s)
        assert late.busy_s == pytest.approx(left.busy_s + 9.0)


@pytest.mark.parametrize("pattern", ["serpentine", "{kind: circle, radius_m: 0.2, points: 24}"])
def test_a_point_that_its_last_count_stopped_is_not_taken_for_too_bright(tmp_path: Path, pattern: str) -> None:
    """On the grid or off it, in the file or as samples come: twenty counts in the time of nineteen."""
    stop = "exposure: {kind: stop_at_counts, counts: 20, from_ns: 10.0, to_ns: 26.0}\n"
    run = recorded(tmp_path, EIGHT_BY_EIGHT.replace("pattern: serpentine", f"pattern: {pattern}") + stop)
    with Recording.open(run) as recording:
        held, samples = nothing_yet(recording, None, AUTO, False, print), list(recording.samples())
        for sample in samples:
            held.add(sample)
    early = [bool(s.histogram.flags & HistogramFlag.STOPPED_EARLY) for s in samples]
    assert any(early)
    expected_s = [s.histogram.live_time_s * (20 / 19 if e else 1.0) for s, e in zip(samples, early, strict=True)]
    for scan in (load_scan(run), held.so_far()):
        found_s = scan.transient.exposure_s if scan.points is None else scan.points.exposure_s
        assert sorted(np.ravel(found_s)) == pytest.approx(sorted(expected_s))


def test_a_first_pass_that_is_good_enough_makes_room_for_the_second(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(TWO_PASS)
    done = nlos("scan", "scan.yaml", "-o", "run.h5", "--reconstruct", "lct", "--until", "stable:0.5", "--json")
    assert done.returncode == 0, done.stderr
    with Recording.open(tmp_path / "run.h5") as recording:
        numbers = recording.records["number"]
        events = [(event.kind, event.text) for event in recording.events()]
    assert 0 < np.count_nonzero(numbers < 256) < 256
    assert np.count_nonzero(numbers >= 256)
    assert set(numbers[numbers >= 256] - 256) <= set(numbers[numbers < 256])
    assert ("scan", "the first pass is ended early: the second begins") in events
    verdicts = [text for kind, text in events if kind == "until" and "is good enough: change" in text]
    assert len(verdicts) == 2 or len(numbers) == 2 * np.count_nonzero(numbers < 256)
    assert json.loads(done.stdout)["points"] == len(numbers)
    assert sum(kind == "until" for kind, _ in events) > 2
    assert done.stderr.count("calibrated: ") == 2, "once while it is looked at, and once of the whole scan"


def test_a_real_bench_reads_the_figures_of_the_live_process(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nlos.live.good_enough.AGAIN_S", 0.0)
    said: list[str] = []
    with Recording.open(run) as recording:
        enough = Enough(
            recording.plan,
            new_scan(recording.plan, {}),
            Goal(STABLE, 0.1),
            Recipe("lct"),
            lambda kind, text: said.append(text),
            watched=run,
        )
    assert not enough()  # nobody has said anything
    live = LiveReconstruction("lct")
    picture = live.update(calibrate_scan(load_scan(run)), 200)
    write_state(state_file(run), picture)
    assert not enough()
    assert "not good enough yet: change 1.0000" in said[-1]
    write_state(state_file(run), live.update(calibrate_scan(load_scan(run)), 249))
    assert not enough()  # not a quarter more
    assert len(said) == 1
    state_file(run).write_text('{"samples": "many"')
    assert not enough()
    write_state(state_file(run), live.update(calibrate_scan(load_scan(run)), 256))
    assert enough()
    assert enough.reached


def test_a_scan_ends_once_its_error_is_surely_small_enough(nlos: Nlos, tmp_path: Path) -> None:
    (tmp_path / "scan.yaml").write_text(COARSE_TO_FINE)
    refused = nlos("scan", "scan.yaml", "-o", "lct.h5", "--until", "sure", "--reconstruct", "lct")
    assert refused.returncode == 2
    assert "do not say how far they may be off" in refused.stderr
    assert not (tmp_path / "lct.h5").exists()
    done = nlos("scan", "scan.yaml", "-o", "run.h5", "--until", "sure:0.95", "--json")
    assert done.returncode == 0, done.stderr
    answer = json.loads(done.stdout)
    assert answer["until"]["reached"]
    with Recording.open(tmp_path / "run.h5") as recording:
        assert len(recording) == answer["points"] < 256
        said = [event.text for event in recording.events() if event.kind == "until"]
    assert "is good enough: error below 0." in said[-1]
    assert said[-1].endswith("level 0.95")


def test_what_says_nothing_of_its_error_never_ends_a_scan_by_it() -> None:
    figures = {"change": 0.0, "error": 0.0, "bound": None}
    assert Goal(STABLE, 0.1).verdict(figures)[0]
    assert not Goal(SURE, 0.9).verdict(figures)[0]
    assert Goal(SURE, 0.2).verdict({**figures, "bound": 0.2}) == (True, "error below 0.2000")
    assert parse_until("sure") == Goal(SURE, LEVELS[SURE])
    assert parse_until("stable:0.3") == Goal(STABLE, 0.3)
    for word in ("sure:", "sure:1", "sure:-1", "surely", "sure:nan", ":0.2"):
        with pytest.raises(UsageError):
            parse_until(word)
