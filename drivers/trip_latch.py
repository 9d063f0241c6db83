"""Trips outlast the program: each bench keeps its own in an append-only file until a person clears them by name."""

import errno
import hashlib
import os
import stat
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

from nlos.drivers.bench_settings import BenchSettings
from nlos.drivers.errors import LimitError, SafetyTrip
from nlos.drivers.file_word import older_word, own_word
from nlos.drivers.state_folder import state_folder

CLEARS = "`nlos doctor --bench BENCH --clear-trip YOUR-NAME`"


class TripLatch:
    """The log of one bench: a line a trip, override or name. The last line says whether a trip stands; one that is not
    whole, as a full disk leaves it, stands for a trip: nothing else is written down while light is on."""

    def __init__(self, path: Path, older: Path | None = None) -> None:
        """`older`: the log of an earlier version, which several benches may share. It is read until there is an own
        one, so that a trip in it stands, and never written to."""
        self.path, self._older = path, older

    @classmethod
    def of_bench(cls, settings: BenchSettings) -> "TripLatch":
        """By the bench's name and what it is made of: a bench file that is moved or corrected elsewhere keeps its trip,
        so does a bench whose ports have other names today."""
        parts = (settings.mirror.model, settings.counter.model, settings.shutter.model, str(settings.simulated))
        addresses = (settings.mirror.address, settings.counter.model, settings.shutter.model)  # as earlier versions did
        folder = state_folder() / "trips"
        older = folder / f"{older_word(settings.name)}-{_short_hash(addresses)}.log"
        return cls(folder / f"{own_word(settings.name)}-{_short_hash(parts)}.log", older)

    def standing(self) -> str | None:
        """Why the bench is tripped; None where it is not. Raises `LimitError` where nobody can know."""
        try:
            text = _text(self.path)
            if text is None and self._older is not None:
                text = _text(self._older)
        except OSError as error:
            raise LimitError(
                "shutter",
                f"whether a trip stands is not to be read ({error}), so no light is allowed.",
                "Make that file readable, or name another folder by NLOS_STATE.",
            ) from error
        if text is None:
            return None
        line = text.rstrip("\n").rpartition("\n")[2]
        kind, _, why = line.partition(" ")[2].partition(": ")
        if kind == "trip":
            return why
        whole = kind == "override" and text.endswith("\n")
        return None if whole else f"what was written down of it ends in {line[-40:]!r}"

    def check(self, there: bool) -> None:
        """Raises `SafetyTrip` where a trip stands. `there`: whether there is a shutter that it keeps closed."""
        if (why := self.standing()) is not None:
            raise tripped(why, there)

    def check_place(self) -> None:
        """Before there is light. Raises `LimitError` where a trip could not be written down, as on a disk that is gone
        or read-only, in a folder of another user's."""
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            place = self.path if self.path.exists() else self.path.parent
            if not os.access(place, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(place))
        except OSError as error:
            raise LimitError(
                "shutter",
                f"a trip could not be written down ({error}), so no light is allowed: the next command would not know.",
                "Make that place writable for you, or name another folder by NLOS_STATE, the same one for everybody.",
            ) from error

    def trip(self, why: str) -> None:
        """Writes down that, when and why the light was shut off."""
        self._add(f"trip: {why}")

    def clear(self, who: str) -> None:
        """Raises `LimitError` where nobody gives a name, or where it cannot be written down: then the trip stands."""
        who = " ".join(who.split())
        if not who:
            raise LimitError("shutter", "a trip is cleared by somebody, and no name was given.", "Give yours.")
        try:
            self._add(f"override: {who} cleared the trip: {self.standing() or 'the instrument had it'}")
        except OSError as error:
            raise LimitError(
                "shutter",
                f"that the trip is cleared could not be written down ({error}), so it stands.",
                "Make that place writable for you, with room on its disk, and clear the trip again.",
            ) from error

    def _add(self, text: str) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        line = f"{datetime.now(UTC).isoformat(timespec='seconds')} {' '.join(text.split())}\n"
        log = self._opened()
        try:
            left = line.encode("utf-8", "replace")
            if not _ends_its_line(log):
                left = b"\n" + left
            while left:  # a disk that fills up takes a part and says nothing
                left = left[os.write(log, left) :]
            os.fsync(log)
        finally:
            os.close(log)

    def _opened(self) -> int:
        """Whoever may write in the folder may write in the log: several users of one bench share it."""
        try:
            return os.open(self.path, os.O_RDWR | os.O_APPEND)  # no O_CREAT: some folders refuse it for others' files
        except FileNotFoundError:
            log = os.open(self.path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            if hasattr(os, "fchmod"):
                with suppress(OSError):
                    os.fchmod(log, stat.S_IMODE(self.path.parent.stat().st_mode) & 0o666)
            return log


def check_before_light(settings: BenchSettings) -> None:
    """What would refuse light on this bench whatever is to be scanned: a trip that stands, and no place to write one
    down. Raises `SafetyTrip`, `LimitError`."""
    latch = TripLatch.of_bench(settings)
    latch.check(there=settings.shutter_on != "nothing")
    if not settings.safety.dry_run:
        latch.check_place()


def tripped(why: str, there: bool) -> SafetyTrip:
    """What refuses light after a trip."""
    return SafetyTrip(
        "shutter",
        f"{'stays closed' if there else 'no scan'} after a trip ({why.rstrip('.')}).",
        f"Find the cause, then run {CLEARS}.",
    )


def _short_hash(words: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(words).encode()).hexdigest()[:8]


def _text(path: Path) -> str | None:
    """None where there is no such file. Raises OSError where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except FileNotFoundError:
        return None


def _ends_its_line(log: int) -> bool:
    """Whether what is there ends in a line's end: a full disk cuts lines off."""
    size = os.lseek(log, 0, os.SEEK_END)
    if not size:
        return True
    os.lseek(log, size - 1, os.SEEK_SET)
    return os.read(log, 1) == b"\n"
