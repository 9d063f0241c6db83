"""How a scan's recording ends: with the status that fits, whatever ended the scan and whenever."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.recording import Status
from nlos.acquisition.recording.salvage import UNCUT, EndedFilm, end_film
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.control import ScanControl, ScanState
from nlos.drivers.bench import Bench
from nlos.drivers.errors import DeviceError, Preempted, SafetyTrip, ShutterHeld
from nlos.drivers.exit_paths import undisturbed
from nlos.drivers.trip_latch import CLEARS

LONG_BYTES = 1 << 27
"""Of counts: more take more than a second or two to copy, which a signal may break off."""


class ScanEnding(AbstractContextManager["ScanEnding"]):
    """Finishes `writer` when the block is left, and ends a film that was to go on until it is stopped. Enter it before
    anything can end the block that made the writer.

    Every device error that is passed on says where the samples are; `resume` is the word that takes the others.
    """

    def __init__(
        self, bench: Bench, writer: RecordingWriter, control: ScanControl, resume: str,
        tell: Callable[[str], None] = lambda said: None,
    ) -> None:  # fmt: skip
        """`tell` is told of what takes its time once a film is stopped."""
        self._bench, self._writer, self._control, self._resume, self._tell = bench, writer, control, resume, tell
        self._uncut = self._broken = False
        self.film: EndedFilm | None = None
        """What the recording holds once a person has ended a film that was to go on until then."""

    @property
    def complete(self) -> bool:
        whole = self.film is not None and self.film.whole
        return self._control.state is ScanState.COMPLETE or whole or (self._writer.has_all and not self._broken)

    @property
    def by_hand(self) -> bool:
        """Whether somebody ended the scan, be it after its last sample; a film is ended so as a rule."""
        return self._control.state is ScanState.ENDED and self.film is None and not self.film_is_whole

    @property
    def film_is_whole(self) -> bool:
        """Whether a film that was to go on until it is stopped has all up to its last point, be it the last of all."""
        return self._writer.plan.until_stopped and self.complete

    @property
    def scheme(self) -> str:
        """By which the samples were taken."""
        return self._control.scheme

    @property
    def expected_s(self) -> float:
        """How long the scan was forecast to take by it; 0 where none was begun."""
        return self._control.expected_s

    @property
    def path(self) -> Path:
        return self._writer.path

    @property
    def safe(self) -> str:
        """Where the samples are, and what takes or makes the rest."""
        return self._safe(clearing_told=False)

    def _safe(self, *, clearing_told: bool) -> str:
        path = self._writer.path
        if self.film is not None and self.film.whole:
            return f"{path} holds the film: {self.film.said()}."
        if self.complete:
            return f"{path} is complete."
        if self._uncut:
            return f"{path} was not cut to the frames of its film. {UNCUT.format(path=path)}"
        if self._writer.has_all:
            return f"All samples are safe in {path}."
        cleared = "" if clearing_told or not self._bench.shutter.is_tripped() else f"{CLEARS} clears the trip, then "
        return f"The samples so far are safe in {path}; {cleared}`{self._resume}` takes the others."

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with undisturbed():
            status = self._status(error)
            self._broken = status in (Status.STOPPED, Status.FAILED)
            try:
                if status is Status.FAILED:
                    self._bench.report("failed", str(error) or type(error).__name__)
                self._bench.report("scan", status.name.lower())
            finally:
                self._bench.on_event = None
                self._writer.finish(status)
            # The light is off and the samples are safe: what cannot be done now `nlos recover` does later. A signal
            # that waited is delivered where this block ends, and would leave a film that is ended after it uncut.
            ends_film = status is Status.INTERRUPTED and self._writer.plan.until_stopped
            self._uncut = ends_film and self._writer.acknowledged >= self._writer.plan.first_round
            copied = 4 * self._writer.acknowledged * self._writer.plan.axis.bins
            if ends_film and copied <= LONG_BYTES:
                self._end_film(error)
        if ends_film and copied > LONG_BYTES:
            self._tell(f"{self._writer.path}: ending the film, {copied / 1e6:.0f} MB are copied")
            self._end_film(error)
        if isinstance(error, DeviceError):
            safe = self._safe(clearing_told=CLEARS in error.remedy)
            error.remedy = f"{error.remedy} {safe}".strip()
            error.args = (f"{error.said} {error.remedy}",)

    def _end_film(self, error: BaseException | None) -> None:
        try:
            self.film = end_film(self._writer.path)
            self._uncut = False
        except StorageError as failure:
            if error is None:
                raise
            error.add_note(str(failure))

    def _status(self, error: BaseException | None) -> Status:
        if self._control.state is ScanState.COMPLETE:  # what came after that changes nothing of it
            return Status.COMPLETE
        if isinstance(error, SafetyTrip):
            return Status.STOPPED
        if error is not None and not self._told_to_end(error):
            return Status.FAILED  # after its last sample, too: a shutter that nobody saw close, say
        return Status.COMPLETE if self._writer.has_all else Status.INTERRUPTED

    def _told_to_end(self, error: BaseException) -> bool:
        """Whether a person or the system ended the scan, also where the signal that shut the light broke into an
        exchange, so that what ends the block is a device's error."""
        if self._control.wanted or isinstance(error, Preempted | ShutterHeld):
            return True
        while not isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit):
            if error.__context__ is None:
                return False
            error = error.__context__
        return True
