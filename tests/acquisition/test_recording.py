"""A scan file keeps every acknowledged sample, exactly, and says what it does not hold."""

import logging
import os
import re
import signal
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import pixels
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording import empty_file, file_bytes
from nlos.acquisition.recording import recording as recording_module
from nlos.acquisition.recording import writer as writer_module
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import recover, resume
from nlos.acquisition.recording.same_scan import ResumeRefused
from nlos.acquisition.recording.verification import verify
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.wall import WallGrid
from nlos.drivers.clock import VirtualClock
from nlos.drivers.identity import DeviceIdentity
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

COUNTER = DeviceIdentity("tcspc488", "NLOS", "TCSPC-488", "0001", "1.0")
HEADER = Header(scan_text="wall: …", bench_text="mirror: …", devices={"counter": COUNTER})


def plan_of(rows: int = 6, cols: int = 5, dwell_ms: float = 8.0, pattern: str = "serpentine") -> ScanPlan:
    settings = {
        "wall": {"width_m": 1.0, "height_m": 1.2, "rows": rows, "cols": cols},
        "pattern": pattern,
        "dwell_ms": dwell_ms,
        "histogram": {"bins": 64, "bin_width_ps": 16, "offset_ns": 12},
    }
    return ScanSettings.model_validate(settings).plan()


def sample_of(plan: ScanPlan, number: int) -> Sample:
    rng = np.random.default_rng(number)
    counts = rng.poisson(3.0, plan.axis.bins).astype(np.uint32)
    histogram = Histogram(
        counts,
        plan.axis.bin_width_s,
        plan.axis.offset_s,
        live_time_s=0.008 - number * 1e-6,
        sync_count=88_000 + number,
        total_count=int(counts.sum()) + 7,
        flags=HistogramFlag(number % 4),
        gate_opened_s=number * 0.0085,
    )
    return Sample(plan[number], histogram, taken_s=number * 0.0085)


def same(a: Sample, b: Sample) -> bool:
    plain_a, plain_b = (replace(s, histogram=replace(s.histogram, counts=s.histogram.counts.tobytes())) for s in (a, b))
    return plain_a == plain_b and a.histogram.counts.dtype == b.histogram.counts.dtype


def write_all(path: Path, plan: ScanPlan, count: int | None = None) -> None:
    with RecordingWriter.create(path, plan, HEADER.stamped()) as writer:
        for number in range(len(plan) if count is None else count):
            writer.write(sample_of(plan, number))


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    plan, path = plan_of(), tmp_path / "run.h5"
    write_all(path, plan)
    with Recording.open(path) as recording:
        assert recording.plan == plan
        assert recording.header.scan_text == HEADER.scan_text
        assert recording.header.devices == {"counter": COUNTER}
        assert recording.header.software["h5py"] == h5py.__version__
        assert recording.status is Status.COMPLETE
        samples = list(recording.samples())
        assert len(samples) == len(plan) == recording.acknowledged
        assert all(same(sample, sample_of(plan, number)) for number, sample in enumerate(samples))
    assert verify(path).complete
    assert not path.with_name("run.h5.lock").exists()


def test_header_and_plan_are_in_the_file_before_the_first_sample(tmp_path: Path) -> None:
    writer = RecordingWriter.create(tmp_path / "run.h5", plan_of(), HEADER.stamped())
    with Recording.open(tmp_path / "run.h5") as recording:
        assert (len(recording), recording.status, recording.plan) == (0, Status.RUNNING, plan_of())
        assert recording.header.started_utc
    writer.finish(Status.INTERRUPTED)


def test_a_reader_sees_acknowledged_samples_while_the_file_is_written(tmp_path: Path) -> None:
    plan = plan_of(16, 16)
    path = tmp_path / "run.h5"
    with RecordingWriter.create(path, plan, HEADER) as writer, Recording.open(path) as recording:
        for number in range(150):
            writer.write(sample_of(plan, number))
        assert writer.acknowledged == 128
        assert recording.refresh() == 128
        assert recording.acknowledged <= writer.acknowledged
        writer.flush()
        assert recording.refresh() == writer.acknowledged == 150
        assert all(same(s, sample_of(plan, i)) for i, s in enumerate(recording.samples()))


def test_a_block_is_flushed_after_a_second_at_the_latest(tmp_path: Path) -> None:
    clock, plan = VirtualClock(), plan_of()
    with RecordingWriter.create(tmp_path / "run.h5", plan, HEADER, clock=clock) as writer:
        writer.write(sample_of(plan, 0))
        assert writer.acknowledged == 0
        clock.sleep(1.0)
        writer.write(sample_of(plan, 1))
        assert writer.acknowledged == 2


def test_transient_adds_samples_where_they_belong(tmp_path: Path) -> None:
    plan = plan_of()
    write_all(tmp_path / "run.h5", plan, 17)
    with Recording.open(tmp_path / "run.h5") as recording:
        transient = recording.transient()
    assert transient.counts.shape == (64, 6, 5)
    assert transient.time.start_s == plan.axis.offset_s
    for number in range(17):
        point, histogram = plan[number], sample_of(plan, number).histogram
        assert (transient.counts[:, point.row, point.col] == histogram.counts).all()
        assert transient.exposure_s[point.row, point.col] == histogram.live_time_s
    assert (transient.exposure_s == 0).sum() == 13


def test_nothing_is_overwritten_unless_asked(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_all(path, plan_of())
    with pytest.raises(StorageError, match="exists"):
        RecordingWriter.create(path, plan_of(), HEADER)
    RecordingWriter.create(path, plan_of(), HEADER, overwrite=True).finish(Status.INTERRUPTED)
    with Recording.open(path) as recording:
        assert len(recording) == 0


def test_two_writers_of_one_file_are_one_too_many(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    writer = RecordingWriter.create(path, plan_of(), HEADER)
    with pytest.raises(StorageError, match="another process"):
        resume(path, plan_of(), HEADER)
    writer.finish(Status.INTERRUPTED)


def test_events_are_kept_with_their_times(tmp_path: Path) -> None:
    with RecordingWriter.create(tmp_path / "run.h5", plan_of(), HEADER) as writer:
        writer.log("shutter_open", "before point 0", 1.5)
        writer.log("alarm", "ä" * 300, 2.5)
        for i in range(2000):
            writer.log("tick", str(i))
    with Recording.open(tmp_path / "run.h5") as recording:
        events = recording.events()
    assert (events[0].kind, events[0].text, events[0].bench_s) == ("shutter_open", "before point 0", 1.5)
    assert events[1].text == "ä" * 108
    assert (len(events), events[-1].kind) == (1024, "log_full")


def test_resume_takes_up_where_the_recording_ends(tmp_path: Path) -> None:
    path, plan = tmp_path / "run.h5", plan_of()
    write_all(path, plan, 11)
    resumed = resume(path, plan, HEADER)
    assert resumed.writer is not None
    assert sorted(resumed.taken) == list(range(11))
    assert resumed.elapsed_s - resumed.away_s == pytest.approx(10 * 0.0085 + 0.008, abs=1e-4)
    assert 0 <= resumed.away_s < 60  # since the last of it was written
    with Recording.open(path) as recording:
        todo = recording.missing()
        assert todo == list(range(11, 30))
    for number in todo:
        resumed.writer.write(sample_of(plan, number))
    resumed.writer.finish(Status.COMPLETE)
    with Recording.open(path) as recording:
        assert all(same(s, sample_of(plan, i)) for i, s in enumerate(recording.samples()))
    assert verify(path).complete
    assert resume(path, plan, HEADER).writer is None


@pytest.mark.parametrize("rest", [b"", b"\x89HDF\r\n\x1a\n", b"not a recording at all"])
def test_resume_starts_afresh_on_a_file_without_a_complete_header(tmp_path: Path, rest: bytes) -> None:
    path = tmp_path / "run.h5"
    path.write_bytes(rest)
    writer = resume(path, plan_of(), HEADER).writer
    assert writer is not None
    assert writer.acknowledged == 0
    writer.finish(Status.INTERRUPTED)
    assert (tmp_path / "run.h5.unreadable").read_bytes() == rest


def test_resume_refuses_another_plan_other_constants_other_devices(tmp_path: Path) -> None:
    path = tmp_path / "run.h5"
    write_all(path, plan_of(), 3)
    with pytest.raises(ResumeRefused, match="plan"):
        resume(path, plan_of(dwell_ms=9.0), HEADER)
    with pytest.raises(ResumeRefused, match="constants"):
        resume(path, plan_of(), Header(devices=HEADER.devices, constants_json='{"dark_hz": 3}'))
    with pytest.raises(ResumeRefused, match="counter was"):
        resume(path, plan_of(), Header(devices={"counter": DeviceIdentity("tcspc488", "NLOS", "TCSPC-488", "2", "1")}))


def test_a_damaged_sample_is_named_and_taken_again(tmp_path: Path) -> None:
    path, plan = tmp_path / "run.h5", plan_of()
    write_all(path, plan)
    raw = bytearray(path.read_bytes())
    at = raw.find(sample_of(plan, 7).histogram.counts.tobytes())
    raw[at + 40] ^= 0x10
    path.write_bytes(raw)
    found = verify(path)
    assert (found.corrupt, found.missing, found.intact) == ((7,), (7,), False)
    assert recover(path, tmp_path / "new.h5") == 29
    assert verify(tmp_path / "new.h5").missing == (7,)
    writer = resume(path, plan, HEADER).writer
    assert writer is not None
    writer.write(sample_of(plan, 7))
    writer.finish(Status.COMPLETE)
    assert verify(path).complete


def test_what_is_left_aside_is_said_once_and_again_only_where_it_is_more(tmp_path: Path) -> None:
    """A film asks for every frame's."""
    write_all(tmp_path / "run.h5", plan_of())
    with h5py.File(tmp_path / "run.h5", "r+") as file:
        file["samples/counts"][[4, 7]] += 1
    said: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    recording_module.log.addHandler(handler)
    try:
        for _ in range(2):  # openings
            with Recording.open(tmp_path / "run.h5") as recording:
                assert [recording.left_aside() for _ in range(3)] == [2, 2, 2]
    finally:
        recording_module.log.removeHandler(handler)
    assert len(said) == 2
    assert all("2 of 30 samples are skipped" in each for each in said)


def test_a_truncated_copy_gives_what_it_still_holds(tmp_path: Path) -> None:
    path, plan = tmp_path / "run.h5", plan_of(16, 16)
    write_all(path, plan)
    os.truncate(path, path.stat().st_size - 64 * plan.axis.bins * 4)
    found = verify(path)
    assert len(found.corrupt) == 64
    assert recover(path, tmp_path / "new.h5") == 192


@pytest.mark.parametrize("damage", ["format", "digest", "link", "shape", "filter", "missing"])
def test_open_refuses_what_is_no_scan_file(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "run.h5"
    write_all(path, plan_of())
    with h5py.File(path, "r+") as file:
        if damage == "format":
            file.attrs["format"] = "other"
        elif damage == "digest":
            file["plan/x_m"][3] = 9.0
        elif damage == "link":
            del file["samples/counts"]
            file["samples/counts"] = h5py.ExternalLink("/etc/passwd", "/")
        elif damage == "shape":
            del file["samples/counts"]
            file["samples"].create_dataset("counts", shape=(1 << 40, 64), chunks=(1, 64), dtype="<u4")
        elif damage == "filter":
            counts = file["samples/counts"][:]
            del file["samples/counts"]
            file["samples"].create_dataset("counts", data=counts, compression="gzip")
        else:
            del file["samples/records"]
    with pytest.raises(InvalidData, match=r"run\.h5"):
        Recording.open(path)


def test_a_second_handle_of_the_same_process_takes_nothing_from_the_first(tmp_path: Path) -> None:
    wall = WallGrid(1.0, 1.0, 20, 20)
    row, col = np.divmod(np.arange(400), 20)
    many = ScanPlan(
        wall, HistogramAxis(64, 16e-12), pixels(wall, row, col), np.full(400, 1e-3), np.zeros(400, np.int32)
    )
    with RecordingWriter.create(tmp_path / "run.h5", many, Header()) as writer:
        for point in many:
            counts = np.full(64, point.number, np.uint32)
            flags = HistogramFlag.NONE
            writer.write(Sample(point, Histogram(counts, 16e-12, 0.0, 1e-3, 10, int(counts.sum()), flags, 0.0), 0.0))
    with Recording.open(tmp_path / "run.h5") as first:
        samples = first.samples()
        next(samples)
        Recording.open(tmp_path / "run.h5").close()
        assert sum(1 for _ in samples) == 399


def test_the_file_format_page_names_everything_that_is_in_a_file(tmp_path: Path) -> None:
    write_all(tmp_path / "run.h5", plan_of())
    page = (Path(__file__).parents[2] / "docs" / "file-format.md").read_text(encoding="utf-8")
    with h5py.File(tmp_path / "run.h5", "r") as file:
        places: list[str] = []
        file.visititems(lambda name, item: places.append(name) if isinstance(item, h5py.Dataset) else None)
        fields = [field for name in ("status", "events", "samples/records") for field in file[name].dtype.names]
        attributes = [*file.attrs, *file["plan"].attrs]
    assert len(places) == 22
    for place in places:
        assert f"`/{place}`" in page
    for word in fields + attributes:
        assert f"`{word}`" in page
    layout = recording_module.__doc__ or ""
    words = {place.split("/")[-1] for place in places} | set(fields) | set(attributes)
    told = set(re.findall(r"\w+", layout))
    assert words <= told, f"the docstring of recording.py does not name {words - told}"
    promises = {"acknowledged", "identity", "CRC", "in one piece", "counts, then records, then"}
    assert all(word in page and word in layout for word in promises)


def test_the_file_format_pages_recipe_reads_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_all(tmp_path / "scan.h5", plan_of(), 17)
    page = (Path(__file__).parents[2] / "docs" / "file-format.md").read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    found: dict[str, np.ndarray] = {}
    exec(page.split("```python")[1].split("```")[0], found)
    assert found["counts"].shape == found["rate"].shape == (17, 64)
    assert (found["counts"][3] == sample_of(plan_of(), 3).histogram.counts).all()
    assert found["x"][16] == plan_of()[16].x_m


@pytest.mark.parametrize("step", ["write_plan", "put_in_place"])
def test_an_interrupt_while_a_recording_is_laid_out_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def interrupted(*arguments: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(empty_file if step == "write_plan" else writer_module, step, interrupted)
    with pytest.raises(KeyboardInterrupt):
        RecordingWriter.create(tmp_path / "run.h5", plan_of(), HEADER)
    assert not list(tmp_path.iterdir())


def test_an_interrupt_while_hdf5_writes_is_no_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = file_bytes.write_at

    def interrupted(fd: int, data: bytes | memoryview, place: int) -> None:
        signal.raise_signal(signal.SIGINT)
        written(fd, data, place)

    monkeypatch.setattr(file_bytes, "write_at", interrupted)
    with pytest.raises(KeyboardInterrupt):
        RecordingWriter.create(tmp_path / "run.h5", plan_of(), HEADER)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert not list(tmp_path.iterdir())
