"""What is said of a scan that has ended, once its bench is closed: a terminal may take its time then."""

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from nlos.acquisition.recording.ended_as_asked import AS_ASKED
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.cli.exit_codes import ExitCode, Stopped
from nlos.cli.terminal import terminal
from nlos.drivers.bench import Bench
from nlos.scan_ending import ScanEnding
from nlos.scan_preparation import PreparedScan, ScanRequest


@dataclass(frozen=True)
class Taken:
    """A scan that has ended, with what there is to say of it."""

    prepared: PreparedScan
    ending: ScanEnding
    points: int
    before: int
    """Points that were there before it began."""
    duration_s: float
    status: str
    seen: str
    """Of the picture, at the last look."""
    reached: bool

    def tell(self, shown: ExitStack) -> None:
        """`shown`: what is on the screen until then. Raises `Stopped` where somebody ended the scan."""
        try:
            shown.close()
            _tell_taken(self)
            if self.status == AS_ASKED and self.points == self.before:
                say_nothing_left(self.ending.path, self.seen)
            elif self.seen:
                terminal.result(
                    f"the picture at the last look: {self.seen}", until={"reached": self.reached, "said": self.seen}
                )
        except (KeyboardInterrupt, SystemExit):
            say_ended(self.prepared.request, self.ending)
            raise
        if self.status == "interrupted" or (self.status == "complete" and self.ending.by_hand and not self.reached):
            raise Stopped(ExitCode.INTERRUPTED, f"ended at the terminal. {self.ending.safe}")


def listen(bench: Bench, writer: RecordingWriter, start_s: float) -> None:
    """What happens on the bench is kept in the recording; another scheme than the one that was said is told, too."""
    schemes = list[str]()

    def happened(kind: str, text: str) -> None:
        writer.log(kind, text, bench.clock.now() - start_s)
        if kind == "scheme":
            schemes.append(text)
            if len(schemes) > 1:
                terminal.log(f"warning: scheme {text}")

    bench.on_event = happened


def say_complete(run: Path) -> None:
    """Of a scan that is resumed although it has all its points."""
    terminal.result(f"{run}: is complete, nothing was left to take", recording=str(run), taken=0)


def say_nothing_left(run: Path, seen: str) -> None:
    """Of a scan that is resumed although its picture was good enough: how it goes on all the same."""
    terminal.result(
        f"{run}: had ended as asked, nothing was left to take: {seen}. A lower level goes on, and so does leaving "
        "--until out.",
        recording=str(run), taken=0, status=AS_ASKED, until={"reached": True, "said": seen},
    )  # fmt: skip


def say_ended(request: ScanRequest, ending: ScanEnding) -> None:
    """A signal ends the command: where the samples are."""
    terminal.say_end(f"ended by a signal. {ending.safe}")
    status = "complete" if ending.complete else "interrupted"  # by a signal after its last point
    terminal.document.update(recording=str(request.target), status=status)


def _tell_taken(taken: Taken) -> None:
    """What was taken of what was planned, in which time; of a film until it is stopped, its frames."""
    prepared, ending, points = taken.prepared, taken.ending, taken.points
    plan, forecast_s = prepared.request.plan, ending.expected_s or prepared.choice.forecast.total_s
    planned, why = plan.most_samples, f" ({forecast_s:.1f} s predicted)"
    predicted_s: float | None = forecast_s
    said = f"{points} of {'at most ' if plan.budget is not None else ''}{planned} points"
    if ending.film is not None:
        planned, predicted_s, why, said = len(ending.film.plan), None, "", ending.film.said()
    elif plan.until_stopped and ending.complete:
        why = "; the recording is full, and the film ended by itself"
    terminal.result(
        f"{prepared.request.target}: {said} in {taken.duration_s:.1f} s of bench time{why}",
        recording=str(prepared.request.target), taken=points - taken.before, points=points, planned=planned,
        bench_s=taken.duration_s, predicted_s=predicted_s, scheme=ending.scheme or prepared.choice.scheme.value,
        status=taken.status,
        **({} if plan.frames == 1 else {"frames": (ending.film.plan if ending.film is not None else plan).frames}),
    )  # fmt: skip
