"""The status of a recording says who ended the scan: a person, an alarm, or a device that failed."""

import contextlib
from pathlib import Path

import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.errors import DeviceError, DeviceLost, Preempted, ProtocolError, SafetyTrip
from nlos.scan_ending import ScanEnding

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
