"""A copy in a process of its own: whoever follows it holds the only HDF5 handle of its own process."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from types import TracebackType
from typing import Self

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.served.served_copy import copy_served
from nlos.acquisition.served.ticket import Ticket

_ENDS_S = 10.0
_FAILURES: dict[str, type[Exception]] = {
    "InvalidData": InvalidData, "StorageError": StorageError, "TimeoutError": TimeoutError,
}  # fmt: skip


class FarCopy:
    """The recording that a ticket names, growing at `target` while the block lasts."""

    def __init__(self, ticket: Path, target: Path, patience_s: float = 60.0) -> None:
        """Returns once `target` is there to be followed. Raises what `copy_served` raises."""
        Ticket.load(ticket)
        self._ticket = ticket
        command = [sys.executable, "-P", "-m", "nlos.acquisition.served.far_copy"]
        self._child = subprocess.Popen(
            [*command, str(ticket), str(target), str(patience_s)],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        assert self._child.stdout is not None
        said = self._child.stdout.readline()
        if said != "begun\n":
            self.close()
            if said:
                raise _failure(ticket, said)
            raise self._broken_off()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def pid(self) -> int:
        return self._child.pid

    def check(self) -> None:
        """Waits for the end of a copy whose scan is over. Raises what kept it from being whole."""
        assert self._child.stdout is not None
        try:
            self._child.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            return
        if said := self._child.stdout.readline():
            raise _failure(self._ticket, said)
        if self._child.returncode:
            raise self._broken_off()

    def _broken_off(self) -> StorageError:
        return StorageError(
            f"{self._ticket}: the copying process stopped ({_how(self._child.returncode)}). What it holds is safe; "
            "follow the ticket again into the same folder."
        )

    def close(self) -> None:
        """Ends the copy where it is; what it holds is safe. May be called twice."""
        if self._child.stdin is not None and not self._child.stdin.closed:
            self._child.stdin.close()
        try:
            self._child.wait(_ENDS_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()


def _failure(ticket: Path, said: str) -> Exception:
    found = json.loads(said)
    return _FAILURES[found["error"]](f"{ticket}: {found['message']}")


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit {code}"


def main(ticket: Path, target: Path, patience_s: float) -> None:
    """The child: ends when the scan does, or when its parent has gone and its standard input with it."""
    orphaned = threading.Event()

    def listen() -> None:
        while os.read(0, 1 << 10):  # past sys.stdin, whose lock would be held when the interpreter ends
            pass
        orphaned.set()

    threading.Thread(target=listen, daemon=True).start()
    try:
        copy_served(
            Ticket.load(ticket), target, patience_s=patience_s,
            begun=lambda: print("begun", flush=True), stopped=orphaned.is_set,
        )  # fmt: skip
    except (InvalidData, StorageError, TimeoutError) as error:
        kind = next(name for name, each in _FAILURES.items() if isinstance(error, each))
        print(json.dumps({"error": kind, "message": str(error)}), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), float(sys.argv[3]))
