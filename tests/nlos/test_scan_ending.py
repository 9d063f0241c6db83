"""The status of a recording says who ended the scan: a person, an alarm, or a device that failed."""

import contextlib
import errno
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import resume, settle
from nlos.acquisition.recording.stored_rows import StoredRows
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.alarms import Action, AlarmRaised, Trouble
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceError, DeviceLost, DeviceTimeout, Preempted, ProtocolError, SafetyTrip
from nlos.scan_ending import ScanEnding
from tests.acquisition.test_recording import sample_of

PLAN = ScanSettings.model_validate(
    {"wall": {"width_m": 1.0, "height_m": 1.0, "rows": 4, "cols": 4}, "pattern": "serpentine", "dwell_ms": 1,
     "histogram": {"bins": 64, "bin_width_ps": 256, "offset_ns": 10}}
).plan()  # fmt: skip


def broken_answer_while_ending(kind: type[BaseException]) -> BaseException:
    """What leaves a block that a signal ends and whose cleaning up meets a signal, too."""
    try:
        try:
            raise kind(143)
        finally:
            raise ProtocolError("mirror", "half an answer.")
    except ProtocolError as error:
        return error


@contextlib.contextmanager
def an_ending(path: Path) -> Iterator[tuple[ScanEnding, RecordingWriter, list[tuple[str, str]]]]:
    """Of a scan into `path`, its writer, and what the bench tells of it."""
    told: list[tuple[str, str]] = []
    with open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench:
        bench.on_event = lambda kind, text: told.append((kind, text))
        writer = RecordingWriter.create(path, PLAN, Header())
        yield ScanEnding(bench, writer, ScanControl(), "--resume"), writer, told


@pytest.mark.parametrize(
    ("error", "asked", "status"),
    [
        (None, "", Status.INTERRUPTED),
        (KeyboardInterrupt(), "", Status.INTERRUPTED),
        (Preempted("counter", "an urgent command broke into this exchange."), "", Status.INTERRUPTED),
        (ProtocolError("mirror", "half an answer."), "Ctrl-C", Status.INTERRUPTED),
        (broken_answer_while_ending(SystemExit), "", Status.INTERRUPTED),
        (ProtocolError("mirror", "half an answer."), "", Status.FAILED),
        (DeviceLost("counter", "is gone."), "", Status.FAILED),
        (SafetyTrip("counter", "too much light."), "", Status.STOPPED),
        (SafetyTrip("counter", "too much light."), "Ctrl-C", Status.STOPPED),
    ],
)
def test_a_recording_says_who_ended_the_scan(
    tmp_path: Path, error: BaseException | None, asked: str, status: Status
) -> None:
    bench_settings = load("bench", "zero_latency", BenchSettings).settings
    with open_bench(bench_settings) as bench:
        control = ScanControl()
        writer = RecordingWriter.create(tmp_path / "run.h5", PLAN, Header())
        with contextlib.suppress(DeviceError, KeyboardInterrupt), ScanEnding(bench, writer, control, "--resume"):
            if asked:
                control.interrupt(asked)
            if error is not None:
                raise error
    with Recording.open(tmp_path / "run.h5") as recording:
        assert recording.status is status


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (None, Status.COMPLETE, "is complete"),
        (KeyboardInterrupt(), Status.COMPLETE, "is complete"),
        (GeneratorExit(), Status.COMPLETE, "is complete"),
        (Preempted("counter", "an urgent command broke into this exchange."), Status.COMPLETE, "is complete"),
        (DeviceTimeout("shutter", "did not say that it is closed."), Status.FAILED, "All samples are safe"),
        (SafetyTrip("counter", "too much light."), Status.STOPPED, "All samples are safe"),
    ],
)
def test_after_the_last_sample_a_person_changes_nothing_and_a_device_that_fails_is_told(
    tmp_path: Path, error: BaseException | None, status: Status, said: str
) -> None:
    """A shutter that nobody saw close is no scan that went well, though no point is lost."""
    with (
        an_ending(tmp_path / "run.h5") as (ending, writer, told),
        contextlib.suppress(DeviceError, KeyboardInterrupt, GeneratorExit),
        ending,
    ):
        for number in range(16):
            writer.write(sample_of(PLAN, number))
        if error is not None:
            raise error
    assert (said in ending.safe, "--resume" in ending.safe) == (True, False)
    assert told[-1] == ("scan", status.name.lower())
    with Recording.open(tmp_path / "run.h5") as recording:
        assert (recording.status, len(recording)) == (status, 16)
    assert settle(tmp_path / "run.h5", PLAN)  # nothing is left to take


@pytest.mark.parametrize(("last", "status"), [(18, Status.COMPLETE), (17, Status.INTERRUPTED)])
def test_a_scan_of_two_passes_ended_by_hand_is_complete_with_the_last_point_that_it_needs(
    tmp_path: Path, last: int, status: Status
) -> None:
    """Three points of the first pass fell short; the second wants no others. Resumed half way, too."""
    plan = replace(
        PLAN, positions=PLAN.positions.take(np.tile(np.arange(16), 2)), dwell_s=np.tile(PLAN.dwell_s, 2),
        pass_=np.repeat(np.array([0, 1], dtype=np.int32), 16), revisit_below=100,
    )  # fmt: skip
    photons = dict(zip(range(16), [100] * 13 + [99] * 3, strict=True)) | dict.fromkeys(range(16, 32), 1)
    run, wanted = tmp_path / "run.h5", [*range(16), 29, 30, 31]
    with open_bench(load("bench", "zero_latency", BenchSettings).settings) as bench:
        for part in (wanted[:7], wanted[7 : last + 1]):
            begun = resume(run, plan, Header())
            assert begun.writer is not None
            control = ScanControl()
            ending = ScanEnding(bench, begun.writer, control, "--resume")
            with contextlib.suppress(KeyboardInterrupt), ending:
                for number in part:
                    histogram = sample_of(plan, number).histogram
                    counts = np.zeros_like(histogram.counts)
                    counts[3] = photons[number]
                    begun.writer.write(replace(sample_of(plan, number), histogram=replace(histogram, counts=counts)))
                control.enter(ScanState.ENDED)
                raise KeyboardInterrupt
    with Recording.open(run) as recording:
        assert (recording.status, len(recording)) == (status, last + 1)
    assert settle(run, plan) == (status is Status.COMPLETE)


@pytest.mark.parametrize("name", ["sync", "count rate", "full bin", "direct", "aim"])
def test_what_an_alarm_ended_is_told_to_be_resumed_once(tmp_path: Path, name: str) -> None:
    alarm = Trouble(name, "too much", Action.ABORT)
    said = AlarmRaised("alarm", "Too much.", alarm.cure)
    with an_ending(tmp_path / "run.h5") as (ending, writer, _), contextlib.suppress(AlarmRaised), ending:
        writer.write(sample_of(PLAN, 0))
        raise said
    assert str(said).lower().count("resume") == 1
    assert "`--resume` takes the others." in str(said)


def test_a_scan_whose_last_samples_its_disk_refused_is_not_called_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with an_ending(tmp_path / "run.h5") as (ending, writer, told):
        for number in range(16):
            writer.write(sample_of(PLAN, number))
        monkeypatch.setattr(StoredRows, "write", full)
        with pytest.raises(StorageError, match="the disk refused a write"), ending:
            writer.flush()
    assert not ending.complete
    assert "--resume" in ending.safe
    assert told[-1] == ("scan", "failed")
    monkeypatch.undo()
    with Recording.open(tmp_path / "run.h5") as recording:
        assert (recording.status, len(recording)) == (Status.RUNNING, 0)


def full(rows: object, *what: object) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_signal_after_the_last_point_leaves_nothing_for_a_resume(tmp_path: Path) -> None:
    bench_settings = load("bench", "zero_latency", BenchSettings).settings
    with open_bench(bench_settings) as bench:
        control = ScanControl()
        writer = RecordingWriter.create(tmp_path / "run.h5", PLAN, Header())
        ending = ScanEnding(bench, writer, control, "--resume")
        with contextlib.suppress(SystemExit), ending:
            control.enter(ScanState.COMPLETE)
            raise SystemExit(143)
        assert ending.safe == f"{tmp_path / 'run.h5'} is complete."
