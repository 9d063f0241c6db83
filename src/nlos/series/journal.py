"""What became of each scan of a series, a line each, on disk before the next begins; recordings have the last word.

`journal.jsonl`: at, run, what, digest, message, exit_code. A line that a crash cut short is left aside.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from nlos.cli.terminal import terminal
from nlos.whole_file import whole_file

NAME, PLAN = "journal.jsonl", "plan.json"
BEGUN, DONE, ALARM, STORAGE, FAILED, INTERRUPTED, PICTURE, NO_PICTURE = (
    "begun", "done", "alarm", "storage", "failed", "interrupted", "picture", "no picture",
)  # fmt: skip
WAITING, CUT_OFF = "waiting", "cut off"
"""What no line says: a run that was not begun; one whose program was killed."""


@dataclass(frozen=True)
class Line:
    """One thing that happened to one run."""

    at: str
    run: str
    what: str
    digest: str = ""
    message: str = ""
    exit_code: int = 0


class Journal:
    """The lines so far, by run; adds to them."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / NAME
        self.lines: list[Line] = read(self.path)

    def add(self, run: str, what: str, digest: str = "", message: str = "", exit_code: int = 0) -> None:
        """On disk when this returns, unless the disk refuses: then the terminal says so, and the recordings tell."""
        now = datetime.now(UTC).isoformat(timespec="seconds")
        line = Line(now, run, what, digest, " ".join(message.split())[:500], exit_code)
        self.lines.append(line)
        try:
            file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            try:
                data = b"\n" * self._torn() + json.dumps(asdict(line)).encode() + b"\n"
                while data:  # a disk that is nearly full takes a part, and says at the next try that it is full
                    data = data[os.write(file, data) :]
                os.fsync(file)
            finally:
                os.close(file)
        except OSError as error:
            terminal.log(f"warning: {self.path}: cannot be written ({error.strerror}): {run} {what}")

    def plan(self, expected_s: Mapping[str, float]) -> None:
        """Writes which runs there are and how long each of those to come takes: what a status page counts by."""
        try:
            with whole_file(self.path.with_name(PLAN)) as partial:
                partial.write_text(json.dumps(dict(expected_s)), encoding="utf-8")
        except OSError as error:
            why = error.__cause__ if isinstance(error.__cause__, OSError) else error
            terminal.log(f"warning: {self.path.with_name(PLAN)}: cannot be written ({why.strerror or why})")

    def _torn(self) -> bool:
        """Whether the last line was cut short."""
        try:
            with self.path.open("rb") as file:
                file.seek(-1, os.SEEK_END)
                return file.read(1) != b"\n"
        except OSError:
            return False

    def last(self, run: str) -> Line | None:
        """What became of its scan, its picture aside."""
        return next(
            (line for line in reversed(self.lines) if line.run == run and line.what not in (PICTURE, NO_PICTURE)), None
        )

    def has_picture(self, run: str) -> bool | None:
        """Whether the last picture that the series made of a run is of its recording as it is; None: it made none."""
        lines = [line.what for line in self.lines if line.run == run]
        return lines[-1] == PICTURE if PICTURE in lines else None

    def is_over(self, run: str, going: bool) -> bool:
        """Whether nothing more is taken of a run by its series, which is `going` or not: it is done, or an alarm ended
        it and the series went on without it. One that an alarm or anything else ended with the series is resumed."""
        last = self.last(run)
        if last is None or last.what != ALARM:
            return last is not None and last.what == DONE
        return going or any(line.run != run for line in self.lines[self.lines.index(last) :])

    def outcome(self, run: str) -> str:
        """In a word."""
        last = self.last(run)
        return WAITING if last is None else CUT_OFF if last.what == BEGUN else last.what


def planned(folder: Path) -> dict[str, float]:
    """The runs of the series in `folder`, in their order, and how long each was expected to take; empty where none is
    planned there."""
    try:
        found = json.loads((folder / PLAN).read_text(encoding="utf-8"))
        return {str(name): float(seconds) for name, seconds in found.items()}
    except (OSError, ValueError, TypeError, AttributeError):
        return {}


def read(path: Path) -> list[Line]:
    """Every whole line; none where there is no journal."""
    try:
        texts = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    lines = []
    for text in texts:
        try:
            lines.append(Line(**json.loads(text)))
        except (ValueError, TypeError):
            continue
    return lines
