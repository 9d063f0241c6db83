"""The child that reads files from outside: whatever a damaged file does to a parser, it does it here.

A line that says that it is ready; then one line of JSON in, arrays into a folder of the parent's, one line of JSON
out. The child has a memory limit, and ends itself where one file takes longer than it may, whether or not the parent
still lives.
"""

import importlib
import json
import signal
import sys
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

import numpy as np

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.importers.describe import describe
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.given import Given
from nlos.acquisition.importers.imported import PLAIN_FIELDS, FreePoints, ImportedScan
from nlos.acquisition.recording.disk_refusal import disk_refusal
from nlos.acquisition.response import as_json


def main(requests: IO[str], answers: IO[str], memory_bytes: int) -> None:
    """Says that it is there, and answers until the requests end."""
    _limit(memory_bytes)
    print("ready", file=answers, flush=True)
    for line in requests:
        request = json.loads(line)
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, request["deadline_s"])  # no handler: C code that loops ends, too
        try:
            answer = _answer(request)
        except MemoryError:
            answer = {"error": f"{request['shown']}: asks for more memory than {memory_bytes >> 20} MiB"}
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        print(json.dumps(answer), file=answers, flush=True)


def _limit(memory_bytes: int) -> None:
    """Bounds this process's memory; where memory runs out all the same, it is this process that goes."""
    if sys.platform == "win32":
        return
    import resource

    with suppress(ValueError):  # macOS takes no limit below what a process has been given already
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        Path("/proc/self/oom_score_adj").write_text("1000")
    except OSError:
        return


def _answer(request: dict[str, Any]) -> dict[str, object]:
    path, shown = Path(request["path"]), request["shown"]
    place, _, name = (request["reader"] or f"{__name__}:read_any").partition(":")
    module = importlib.import_module(place)
    refusals = (InvalidData, FileNotFoundError, getattr(module, "InvalidData", InvalidData))  # each room has its own
    try:
        if request["reader"] is not None:
            found = getattr(module, name)(path)
            return {"found": found} if isinstance(found, dict) else {}
        given = request["given"]
        wall_m = None if given["wall_m"] is None else tuple(given["wall_m"])
        return _passed_on(read_any(path, Given(**{**given, "wall_m": wall_m})), Path(request["folder"]), shown)
    except StorageError as error:
        return {"storage": str(error).replace(str(path), shown)}
    except (*refusals, OSError) as error:
        if (refused := disk_refusal(shown, error)) is not None:
            return {"storage": str(refused)}
        if not isinstance(error, refusals):
            raise
        return {"error": str(error).replace(str(path), shown), "contents": _contents(path, request)}


def _contents(path: Path, request: dict[str, Any]) -> dict[str, object]:
    """What is in a file that is not a scan, where that was asked for and can be told."""
    if not request["describe"]:
        return {}
    try:
        return {key: _plain(value) for key, value in describe(path).items()}
    except InvalidData:
        return {}


def _plain(value: object) -> object:
    return value if isinstance(value, str | int | float) else str(value)


def _passed_on(scan: ImportedScan, folder: Path, shown: str) -> dict[str, object]:
    try:
        return _sent(scan, folder)
    except OSError as error:  # of that folder's disk, and no fault of the file
        raise StorageError(
            f"{shown}: {folder.parent} has no room for what it holds ({error}). Free disk space there, or "
            "name another folder by the environment variable TMPDIR."
        ) from error


def _sent(scan: ImportedScan, folder: Path) -> dict[str, object]:
    held = scan.held
    np.save(folder / "counts.npy", held.counts)
    np.save(folder / "exposure_s.npy", held.exposure_s)
    if isinstance(held, FreePoints):
        np.save(folder / "places_m.npy", np.stack([held.x_m, held.y_m]))
    if scan.time_offset_bins is not None:
        np.save(folder / "time_offset_bins.npy", scan.time_offset_bins)
    answer = {key: getattr(scan, key) for key in (*PLAIN_FIELDS, "notes")}
    answer["response"] = as_json(scan.response)
    return answer | {"wall": asdict(held.wall), "time": asdict(held.time)}


if __name__ == "__main__":
    main(sys.stdin, sys.stdout, int(sys.argv[1]))
