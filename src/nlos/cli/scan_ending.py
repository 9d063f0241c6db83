"""How a scan's recording ends: with the status that fits, whatever ended the scan and whenever."""

from contextlib import AbstractContextManager
from types import TracebackType
from typing import TYPE_CHECKING

from nlos.cli.exit_codes import ExitCode, Stopped
from nlos.cli.terminal import terminal

if TYPE_CHECKING:
    from nlos.acquisition.recording.recording import Status
    from nlos.acquisition.recording.writer import RecordingWriter
    from nlos.acquisition.scanning.control import ScanControl
    from nlos.drivers.bench import Bench


class ScanEnding(AbstractContextManager["ScanEnding"]):
    """Finishes `writer` when the block is left. Enter it before anything can end the block that made the writer.

    A trip or an alarm goes on as `Stopped`; every error that goes on says where the samples are.
    """

    def __init__(self, bench: "Bench", writer: "RecordingWriter", control: "ScanControl") -> None:
        self._bench, self._writer, self._control = bench, writer, control

    @property
    def complete(self) -> bool:
        from nlos.acquisition.scanning.control import ScanState

        return self._control.state is ScanState.COMPLETE

    @property
    def safe(self) -> str:
        return f"The samples so far are safe in {self._writer.path}; `--resume` takes the others."

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        from nlos.drivers.errors import DeviceError, SafetyTrip
        from nlos.drivers.exit_paths import undisturbed

        with undisturbed():
            status = self._status(error)
            try:
                self._bench.report("scan", status.name.lower())
            finally:
                self._bench.on_event = None
                self._writer.finish(status)
        if isinstance(error, SafetyTrip):
            raise Stopped(ExitCode.ALARM, f"{error} {self.safe}") from error
        if isinstance(error, DeviceError):
            error.remedy = f"{error.remedy} {self.safe}".strip()
            error.args = (f"{error.device}: {error.what} {error.remedy}",)
        if isinstance(error, KeyboardInterrupt | SystemExit):
            terminal.log(f"nlos: ended by a signal. {self.safe}", -9)

    def _status(self, error: BaseException | None) -> "Status":
        from nlos.acquisition.recording.recording import Status
        from nlos.drivers.errors import SafetyTrip

        if self.complete:  # a signal that came after the last sample changes nothing
            return Status.COMPLETE
        if error is None or isinstance(error, KeyboardInterrupt | SystemExit):
            return Status.INTERRUPTED
        return Status.STOPPED if isinstance(error, SafetyTrip) else Status.FAILED
