"""Replayed and followed samples cannot be told from live ones."""

import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.follow import follow
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.replay import replay
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.engine import record, scan
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.clock import VirtualClock

Benches = Callable[..., BenchSettings]
Plans = Callable[..., ScanPlan]


def everything(sample: Sample) -> list[object]:
    """All that a consumer can see of a sample: values and their types."""
    seen: list[object] = [sample.taken_s, type(sample.taken_s)]
    for part in (sample.point, sample.histogram):
        for field in fields(part):
            value = getattr(part, field.name)
            seen.append((type(value), value.tobytes(), value.dtype) if isinstance(value, np.ndarray) else value)
            seen.append(type(value))
    return seen


@pytest.fixture
def live(bench_settings: Benches, small_plan: Plans, run_path: Path) -> list[Sample]:
    """A scan, as it came, recorded at `run_path`."""
    samples: list[Sample] = []
    with open_bench(bench_settings()) as bench, RecordingWriter.create(run_path, small_plan(), Header()) as writer:
        record(scan(small_plan(), bench), writer, samples.append)
    return samples


def test_replayed_samples_are_the_live_ones_to_the_last_type(live: list[Sample], run_path: Path) -> None:
    with Recording.open(run_path) as recording:
        replayed = list(replay(recording, speed=None))
    assert [everything(sample) for sample in replayed] == [everything(sample) for sample in live]


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_replay_keeps_the_recorded_pace(live: list[Sample], run_path: Path, speed: float) -> None:
    clock, moments = VirtualClock(), []
    with Recording.open(run_path) as recording:
        for _ in replay(recording, speed, clock):
            moments.append(clock.now())
    recorded = np.array([sample.taken_s + sample.histogram.live_time_s for sample in live])
    assert np.allclose(np.array(moments) * speed, recorded)


def test_a_replay_speed_of_nothing_is_refused(live: list[Sample], run_path: Path) -> None:
    with Recording.open(run_path) as recording, pytest.raises(ValueError, match="above 0"):
        replay(recording, 0.0)


def test_a_finished_file_is_followed_to_its_end_at_once(live: list[Sample], run_path: Path) -> None:
    assert [everything(sample) for sample in follow(run_path)] == [everything(sample) for sample in live]


def written_by_another_process(samples: list[Sample], plan: ScanPlan, path: Path) -> None:
    time.sleep(0.1)
    with RecordingWriter.create(path, plan, Header()) as writer:
        for sample in samples:
            writer.write(sample)
            if sample.point.number % 10 == 9:
                writer.flush()
                time.sleep(0.1)


def test_a_file_that_another_process_writes_is_followed(live: list[Sample], run_path: Path, small_plan: Plans) -> None:
    path = run_path.with_name("followed.h5")
    process = multiprocessing.get_context("fork").Process(
        target=written_by_another_process, args=(live, small_plan(), path)
    )
    process.start()
    followed = list(follow(path))
    process.join()
    assert [everything(sample) for sample in followed] == [everything(sample) for sample in live]


def test_the_file_is_looked_at_more_often_once_little_of_its_scan_is_left(
    live: list[Sample], run_path: Path, small_plan: Plans
) -> None:
    """Whoever waits for the last sample does not wait for a look as well."""
    path, slept_s = run_path.with_name("followed.h5"), []
    writer = RecordingWriter.create(path, small_plan(), Header())
    steps = [live[:10], [], live[10:-3], [], live[-3:]]

    class Between(VirtualClock):
        def sleep(self, seconds: float) -> None:
            slept_s.append(seconds)
            super().sleep(seconds)
            if steps:
                for sample in steps.pop(0):
                    writer.write(sample)
                writer.flush()
            else:
                writer.finish(Status.COMPLETE)

    followed = list(follow(path, clock=Between()))
    assert [everything(sample) for sample in followed] == [everything(sample) for sample in live]
    assert len(live) > 30
    assert slept_s == [0.2] * 3 + [0.05] * 3


def test_a_writer_that_dies_ends_the_following(live: list[Sample], run_path: Path, small_plan: Plans) -> None:
    path, clock = run_path.with_name("followed.h5"), VirtualClock()
    writer = RecordingWriter.create(path, small_plan(), Header())
    for sample in live[:7]:
        writer.write(sample)
    writer.flush()
    samples = follow(path, clock=clock)
    assert len([next(samples) for _ in range(7)]) == 7
    path.with_name("followed.h5.lock").unlink()
    with pytest.raises(StorageError, match="gone after 7 samples"):
        next(samples)
    writer.finish(Status.INTERRUPTED)


def test_a_link_to_a_file_is_followed_through_the_pauses_of_its_scan(
    live: list[Sample], run_path: Path, small_plan: Plans
) -> None:
    path, link, slept_s = run_path.with_name("followed.h5"), run_path.with_name("latest.h5"), [0.0]
    writer = RecordingWriter.create(path, small_plan(), Header())
    link.symlink_to(path.name)
    writer.write(live[0])
    writer.flush()

    class Paused(VirtualClock):
        def sleep(self, seconds: float) -> None:
            super().sleep(seconds)
            slept_s[0] += seconds
            if slept_s[0] > 60 and writer.acknowledged == 1:
                for sample in live[1:]:
                    writer.write(sample)
                writer.finish(Status.COMPLETE)

    assert len(list(follow(link, clock=Paused()))) == len(live)


def test_a_file_with_many_samples_is_shown_again_while_they_are_given(live: list[Sample], run_path: Path) -> None:
    """What it says of the light is asked for from it, not from what it said when the first was given."""
    with Recording.open(run_path) as recording:
        plan = recording.plan
    run_path.unlink()
    clock, shown, given = VirtualClock(), list[tuple[int, list[str]]](), 0
    with RecordingWriter.create(run_path, plan, Header()) as writer:
        for sample in live:
            writer.write(sample)
        writer.flush()

        def look(recording: Recording) -> None:
            shown.append((given, [event.text for event in recording.events() if event.kind == "shutter"]))

        for _ in follow(run_path, clock=clock, look=look):
            given += 1
            clock.sleep(0.3)
            if given == 5:
                writer.log("shutter", "opened")
            if given == 10:
                break
    assert shown == [(0, []), (4, []), (8, ["opened"])]


def test_following_waits_for_the_file_no_longer_than_told(tmp_path: Path) -> None:
    clock = VirtualClock()
    with pytest.raises(TimeoutError, match="no recording to follow after 3 s"):
        next(follow(tmp_path / "never.h5", patience_s=3.0, clock=clock))
    assert 3.0 <= clock.now() < 4.0


def test_following_refuses_a_file_that_is_no_recording_and_that_nobody_writes(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text("dwell_ms: 2")
    clock = VirtualClock()
    with pytest.raises(InvalidData, match=r"plan\.yaml: is not a recording"):
        next(follow(tmp_path / "plan.yaml", clock=clock))
    assert clock.now() < 10.0


def test_following_goes_through_a_file_that_is_replaced(live: list[Sample], run_path: Path, small_plan: Plans) -> None:
    path, plan = run_path.with_name("followed.h5"), small_plan()
    writer = RecordingWriter.create(path, plan, Header())
    for sample in live[:20]:
        writer.write(sample)
    writer.flush()
    followed: list[Sample] = []
    source: Iterator[Sample] = follow(path)
    followed.extend(next(source) for _ in range(20))
    # as after kill -9: the file still says that it is being written, and nobody holds it
    left_behind = path.read_bytes()
    writer.finish(Status.INTERRUPTED)
    path.with_name("left.h5").write_bytes(left_behind)
    path.with_name("left.h5").replace(path)
    thread = threading.Thread(target=lambda: followed.extend(source))
    thread.start()
    again = resume(path, plan, Header()).writer
    assert again is not None
    with again:
        for sample in live[20:]:
            again.write(sample)
    thread.join(20)
    assert [everything(sample) for sample in followed] == [everything(sample) for sample in live]


def test_other_handles_open_a_followed_file_when_its_scan_has_just_ended(
    live: list[Sample], run_path: Path, small_plan: Plans
) -> None:
    path = run_path.with_name("followed.h5")
    process = multiprocessing.get_context("fork").Process(
        target=written_by_another_process, args=(live, small_plan(), path)
    )
    process.start()
    source = follow(path)
    followed = [next(source)]
    process.join()
    with Recording.open(path) as another:
        assert another.status is Status.COMPLETE
    followed.extend(source)
    assert [everything(sample) for sample in followed] == [everything(sample) for sample in live]
