"""Reads files from outside in a child process: whatever a damaged file does to a parser, it does it over there.

The child has a memory limit and a deadline; arrays come back as .npy files in a folder of the parent's, never pickled.
"""

import contextlib
import json
import subprocess
import sys
import tempfile
import threading
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import IO, Self

import numpy as np

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.importers.imported import ImportedScan
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid

DEADLINE_S = 300.0
MEMORY_BYTES = 24 << 30
"""Address space of the child: three times the largest scan that is read, and what Python and its libraries map."""

_PLAIN_FIELDS = ("source_format", "direct_cut_bins", "falloff", "rectified", "wall_known")


class IsolatedReader:
    """A child process that reads one file after another; it is started anew after a crash.

    `memory_bytes` limits the child's address space where the operating system can (not on Windows).
    """

    def __init__(self, memory_bytes: int = MEMORY_BYTES, deadline_s: float = DEADLINE_S) -> None:
        self._memory_bytes, self._deadline_s = memory_bytes, deadline_s
        self._child: subprocess.Popen[str] | None = None

    def read(self, path: Path) -> ImportedScan:
        """As `formats.read_any`. Raises `InvalidData` also where the reader crashed or ran out of time or memory."""
        if not path.is_file():
            raise FileNotFoundError(f"{path}: no such file")
        with tempfile.TemporaryDirectory(prefix="nlos-import-") as folder:
            answer = self._ask({"path": str(path.absolute()), "shown": str(path), "folder": folder})
            if answer is None:
                raise InvalidData(f"{path}: the reader did not survive this file; it is damaged, or not what it says")
            if "error" in answer:
                raise InvalidData(str(answer["error"]))
            return _load(Path(folder), answer)

    def close(self) -> None:
        """Ends the child. May be called twice."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            child.wait()
            for pipe in (child.stdin, child.stdout):
                if pipe is not None:
                    with contextlib.suppress(BrokenPipeError):  # a request that the child never read
                        pipe.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, request: dict[str, str]) -> dict[str, object] | None:
        """The child's answer; None where it died or had to be killed at the deadline."""
        if self._child is None or self._child.poll() is not None:
            self.close()
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-m", __name__, str(self._memory_bytes)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        child = self._child
        timer = threading.Timer(self._deadline_s, child.kill)
        timer.start()
        try:
            line = _exchange(child, json.dumps(request))
        finally:
            timer.cancel()
        if not line:
            self.close()
            return None
        answer: dict[str, object] = json.loads(line)
        return answer


def read_isolated(path: Path) -> ImportedScan:
    """One file, read by a child process of its own."""
    with IsolatedReader() as reader:
        return reader.read(path)


def _exchange(child: "subprocess.Popen[str]", request: str) -> str:
    if child.stdin is None or child.stdout is None:
        return ""
    try:
        child.stdin.write(request + "\n")
        child.stdin.flush()
    except BrokenPipeError:
        return ""
    return child.stdout.readline()


def _load(folder: Path, answer: dict[str, object]) -> ImportedScan:
    fields = {key: answer[key] for key in _PLAIN_FIELDS}
    wall, time = answer["wall"], answer["time"]
    if not isinstance(wall, dict) or not isinstance(time, dict):
        raise InvalidData("the reader answered without wall or time axis")
    offsets = folder / "time_offset_bins.npy"
    return ImportedScan(
        Transient(
            np.load(folder / "counts.npy", allow_pickle=False),
            np.load(folder / "exposure_s.npy", allow_pickle=False),
            WallGrid(**wall),
            TimeAxis(**time),
        ),
        time_offset_bins=np.load(offsets, allow_pickle=False) if offsets.exists() else None,
        notes=tuple(str(note) for note in answer["notes"]) if isinstance(answer["notes"], list) else (),
        **fields,  # type: ignore[arg-type]
    )


def _serve(requests: IO[str], answers: IO[str], memory_bytes: int) -> None:
    """The child: one line of JSON in, arrays into the folder, one line of JSON out."""
    from nlos.acquisition.importers.formats import read_any

    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for line in requests:
        request = json.loads(line)
        try:
            scan = read_any(Path(request["path"]))
        except (InvalidData, FileNotFoundError) as error:
            answer: dict[str, object] = {"error": str(error).replace(request["path"], request["shown"])}
        except MemoryError:
            answer = {"error": f"{request['shown']}: asks for more memory than {memory_bytes >> 20} MiB"}
        else:
            folder, transient = Path(request["folder"]), scan.transient
            np.save(folder / "counts.npy", transient.counts)
            np.save(folder / "exposure_s.npy", transient.exposure_s)
            if scan.time_offset_bins is not None:
                np.save(folder / "time_offset_bins.npy", scan.time_offset_bins)
            answer = {key: getattr(scan, key) for key in (*_PLAIN_FIELDS, "notes")}
            answer |= {"wall": asdict(transient.wall), "time": asdict(transient.time)}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    _serve(sys.stdin, sys.stdout, int(sys.argv[1]))
