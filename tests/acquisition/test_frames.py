"""Frames: a pattern scanned again and again, each frame with points, times and light of its own."""

import multiprocessing
import os
import signal
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from nlos.acquisition.errors import InvalidData, PlanRefused
from nlos.acquisition.planning import schemes
from nlos.acquisition.planning.frames import bayer
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of, checked_angles
from nlos.acquisition.planning.schemes import Scheme, forecast
from nlos.acquisition.recording.frames import frame_table
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.acquisition.scanning.gathering import Gathering
from nlos.acquisition.scanning.lag import Lag
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.mirror import MirrorAngles

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


def _places(plan: ScanPlan, frame: int) -> list[tuple[float, float]]:
    of = plan.pass_ == frame
    return list(zip(plan.positions.x_m[of].tolist(), plan.positions.y_m[of].tolist(), strict=True))


def test_frames_take_the_same_points_there_and_back(small_plan: Plans) -> None:
    once, plan = small_plan(4, 5), small_plan(4, 5, frames=3)
    assert (plan.frames, plan.cycle, len(plan)) == (3, 1, 60)
    assert _places(plan, 0) == _places(once, 0) == _places(plan, 1)[::-1] == _places(plan, 2)
    assert once.frames == 1


@pytest.mark.parametrize("parts", [2, 4, 8, 16, 64])
def test_interleaved_frames_share_the_points_evenly(small_plan: Plans, parts: int) -> None:
    plan = small_plan(16, 16, frames=2 * parts, interleave=parts)
    assert plan.cycle == parts
    seen = [place for frame in range(parts) for place in _places(plan, frame)]
    assert sorted(seen) == sorted(_places(small_plan(16, 16), 0))
    pitch = 1.0 / 16
    for frame in range(parts):
        places = np.array(_places(plan, frame))
        assert len(places) == 256 // parts
        assert set(_places(plan, frame)) == set(_places(plan, frame + parts))
        apart = np.abs(places[:, None] - places[None]).max(axis=2) + 9 * np.eye(len(places))
        # Evenly spread: no two of a part are nearer than a lattice of so many points allows, but for rounding.
        assert (apart.min(axis=1) > pitch * (2 ** (np.log2(parts) // 2) - 1e-6)).all() or parts == 2


@pytest.mark.parametrize("pattern", ["fermat_spiral", "random", "circle", "subgrid"])
def test_every_kind_of_pattern_has_parts(small_plan: Plans, pattern: str) -> None:
    words: dict[str, object] = {
        "fermat_spiral": {"kind": "fermat_spiral", "dr_m": 0.05},
        "random": {"kind": "random", "points": 40},
        "circle": {"kind": "circle", "points": 40, "radius_m": 0.4},
        "subgrid": {"kind": "subgrid", "rows": 8, "cols": 8},
    }
    plan = small_plan(16, 16, pattern=words[pattern], frames=16, interleave=16)
    once = small_plan(16, 16, pattern=words[pattern])
    seen = sorted(place for frame in range(16) for place in _places(plan, frame))
    assert seen == sorted(_places(once, 0))
    assert min(len(_places(plan, frame)) for frame in range(16)) > 0


def test_bayer_is_the_published_matrix() -> None:
    assert bayer(4).tolist() == [[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ({"frames": 4, "interleave": 16}, "raise frames"),
        ({"frames": 64, "interleave": 64}, "cannot be divided into 64 parts"),
        ({"frames": 2, "exposure": {"kind": "two_pass", "counts": 5, "again_ms": 1}}, "no second pass"),
        ({"frames": 100_000, "histogram": {"bins": 4096, "bin_width_ps": 16}}, "fewer frames"),
    ],
)
def test_frames_that_cannot_be_are_refused(small_plan: Plans, words: dict[str, object], why: str) -> None:
    with pytest.raises(PlanRefused, match=why):
        small_plan(6, 6, **words)


@pytest.mark.parametrize("words", [{"frames": 0}, {"frames": 1.5}, {"frames": 16, "interleave": 3}])
def test_words_that_are_no_frames_are_refused(small_plan: Plans, words: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        small_plan(6, 6, **words)


@pytest.mark.parametrize(("bench", "mode"), [("zero_latency", "hist"), ("zero_latency", "t3"), ("helios", "hist")])
@pytest.mark.parametrize("scheme", [None, Scheme.STEPPED])
@pytest.mark.parametrize("interleave", [1, 4])
def test_every_frame_has_its_own_samples_where_the_beam_was(
    bench_settings: Benches,
    small_plan: Plans,
    run_path: Path,
    bench: str,
    mode: str,
    scheme: Scheme | None,
    interleave: int,
) -> None:
    plan = small_plan(4, 4, frames=8, interleave=interleave, dwell_ms=1, histogram={"bins": 64, "bin_width_ps": 1024})
    settings = bench_settings(name=bench)
    settings = settings.model_copy(update={"counter": settings.counter.model_copy(update={"mode": mode})})
    beams: dict[int | None, MirrorAngles] = {}
    with open_bench(settings) as there:
        plan = plan.on_axis(there.counter.nearest_axis(plan.axis))
        angles = checked_angles(plan, there, aim_of(there))
        assert there.simulated is not None
        there.simulated.on_gate = lambda gate, beam: beams.__setitem__(gate.number, beam)
        gathered = Gathering(plan)
        with RecordingWriter.create(run_path, plan, Header(), clock=there.clock) as writer:
            record(scan(plan, there, scheme=scheme), writer, gathered.add)
    for number, aimed in enumerate(angles):
        beam = beams[number]
        assert max(abs(beam.x_rad - aimed.x_rad), abs(beam.y_rad - aimed.y_rad)) < 1e-3
    assert verify(run_path).complete_frames == verify(run_path).frames == 8
    with Recording.open(run_path) as recording:
        table = frame_table(plan, recording.intact_records())
        assert (table.points == table.planned).all()
        assert (table.points == 16 // interleave).all()
        assert (table.start_s[1:] >= table.end_s[:-1] - 1e-6).all()
        assert ((table.start_s < table.mean_s) & (table.mean_s < table.end_s)).all()
        assert table.pulses / table.live_s == pytest.approx(settings.laser.repetition_hz, rel=0.01)
        whole = recording.transient()
        parts = [recording.transient(range(frame, frame + 1)) for frame in range(8)]
        assert np.array_equal(sum(part.counts for part in parts), whole.counts)
        assert sum(part.exposure_s for part in parts) == pytest.approx(whole.exposure_s)
        assert np.array_equal(gathered.transient().counts, whole.counts)
        for frame, part in enumerate(parts):
            taken = [
                (each.taken_s, each.histogram.live_time_s) for each in recording.samples() if each.point.pass_ == frame
            ]
            assert table.end_s[frame] == pytest.approx(max(begun_s + live_s for begun_s, live_s in taken))
            middle_s = sum((begun_s + live_s / 2) * live_s for begun_s, live_s in taken)
            assert table.mean_s[frame] == pytest.approx(middle_s / sum(live_s for _, live_s in taken))
            expected = np.zeros((64, 4, 4))
            for sample in recording.samples():
                if sample.point.pass_ == frame:
                    expected[:, sample.point.row, sample.point.col] += sample.histogram.counts
            assert np.array_equal(part.counts, expected)


def test_frames_in_continuous_lines_run_there_and_back(
    bench_settings: Benches, small_plan: Plans, run_path: Path
) -> None:
    plan = small_plan(4, 64, frames=3, dwell_ms=0.122, continuous={})
    with open_bench(bench_settings(name="simulated")) as there:
        lag = Lag(1e-4, 0.01)
        with RecordingWriter.create(run_path, plan, Header(), clock=there.clock) as writer:
            record(scan(plan, there, scheme=Scheme.SWEPT, lag=lag), writer)
    with Recording.open(run_path) as recording:
        table = frame_table(plan, recording.intact_records())
        assert table.complete == 3
        assert all(later > earlier for earlier, later in pairwise(table.mean_s.tolist()))


def _take(path: Path, plan: ScanPlan, settings: BenchSettings, killed_after: int | None = None) -> None:
    with open_bench(settings) as there:
        resumed = resume(path, plan, Header(), clock=there.clock)
        assert resumed.writer is not None
        with resumed.writer as writer:
            for sample in scan(plan, there, taken=resumed.taken, elapsed_s=resumed.elapsed_s):
                writer.write(sample)
                if sample.point.number == killed_after:
                    writer.flush()
                    os.kill(os.getpid(), signal.SIGKILL)


def test_frames_cut_off_by_a_kill_are_resumed_with_the_same_photons(
    bench_settings: Benches, small_plan: Plans, tmp_path: Path
) -> None:
    plan, settings = small_plan(4, 4, frames=6, interleave=4), bench_settings(name="simulated")
    whole, killed = tmp_path / "whole.h5", tmp_path / "killed.h5"
    child = multiprocessing.get_context("fork").Process(target=_take, args=(killed, plan, settings, 9))
    child.start()
    child.join(240)
    assert child.exitcode == -signal.SIGKILL
    found = verify(killed)
    assert (found.intact, found.complete_frames, len(found.missing)) == (True, 2, 14)
    _take(killed, plan, settings)
    _take(whole, plan, settings)
    assert verify(killed).complete_frames == 6
    with Recording.open(whole) as one, Recording.open(killed) as other:
        for frame in range(6):
            frames = range(frame, frame + 1)
            assert np.array_equal(one.transient(frames).counts, other.transient(frames).counts)
        assert frame_table(plan, other.intact_records()).start_s[3] > frame_table(plan, other.intact_records()).end_s[2]


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("bench", "scheme"),
    [("simulated", Scheme.STEPPED), ("simulated", Scheme.CLOCKED), ("multiharp", Scheme.LISTED),
     ("helios", Scheme.PLAYED)],
)  # fmt: skip
@pytest.mark.parametrize("interleave", [1, 4])
def test_films_take_as_long_as_predicted(
    bench_settings: Benches, small_plan: Plans, bench: str, scheme: Scheme, interleave: int
) -> None:
    axis = {"bins": 64, "bin_width_ps": 320 if bench == "multiharp" else 256, "offset_ns": 9.6}
    plan = small_plan(14, 14, dwell_ms=2, histogram=axis, frames=4, interleave=interleave)
    with open_bench(bench_settings(name=bench)) as there:
        predicted = forecast(scheme, plan, there, checked_angles(plan, there, aim_of(there)))
        started_s = there.clock.now()
        assert sum(1 for _ in scan(plan, there, scheme=scheme)) == len(plan)
        actual_s = there.clock.now() - started_s
    low_s, high_s = predicted.band_s
    assert low_s <= actual_s <= high_s


@pytest.mark.parametrize(
    ("bench", "scheme", "words"),
    [("simulated", Scheme.STEPPED, {}), ("simulated", Scheme.CLOCKED, {"interleave": 4, "frames": 160}),
     ("multiharp", Scheme.LISTED, {}), ("helios", Scheme.PLAYED, {}),
     ("simulated", Scheme.SWEPT, {"continuous": {}, "dwell_ms": 0.122})],
)  # fmt: skip
def test_a_long_film_is_forecast_from_its_beginning(
    bench_settings: Benches, small_plan: Plans, monkeypatch: pytest.MonkeyPatch, bench: str, scheme: Scheme,
    words: dict[str, object],
) -> None:  # fmt: skip
    axis = {"bins": 64, "bin_width_ps": 320 if bench == "multiharp" else 256, "offset_ns": 9.6}
    plan = small_plan(8, 64, **{"dwell_ms": 2, "histogram": axis, "frames": 40, **words})
    with open_bench(bench_settings(name=bench)) as there:
        angles = checked_angles(plan, there, aim_of(there))
        whole = forecast(scheme, plan, there, angles)
        monkeypatch.setattr(schemes, "FORECAST_POINTS", 2500)
        from_beginning = forecast(scheme, plan, there, angles)
    assert from_beginning != whole
    assert from_beginning.dwell_s == pytest.approx(whole.dwell_s)
    low_s, high_s = whole.band_s
    assert low_s <= from_beginning.total_s <= high_s


def test_a_frame_that_is_not_there_is_refused(bench_settings: Benches, small_plan: Plans, run_path: Path) -> None:
    plan = small_plan(2, 2, frames=2)
    with open_bench(bench_settings()) as there, RecordingWriter.create(run_path, plan, Header()) as writer:
        record(scan(plan, there), writer)
    with Recording.open(run_path) as recording:
        assert recording.plan == plan
        assert recording.plan.frames == 2
        for frame in (-1, 2):
            with pytest.raises(InvalidData, match=r"the recording has 2, from 0 to 1"):
                recording.transient(range(frame, frame + 1))
