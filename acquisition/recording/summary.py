"""What a recording says of itself in a moment: header, status and rates, without its histograms. For lists of runs."""

import base64
import json
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.ended_as_asked import word_of
from nlos.acquisition.recording.header import FORMAT, LATER, MAX_TEXT_BYTES, VERSION
from nlos.acquisition.recording.layout import EVENT, EVENT_ROWS, RECORD, STATUS, Status
from nlos.acquisition.recording.run_notes import RunNotes
from nlos.acquisition.recording.writer_lock import is_locked

Floats = npt.NDArray[np.float64]

CUT_OFF = "cut off"
"""The status of a recording that says it is running while nobody writes it."""
MOST_PIXELS = 32
"""Of a thumbnail's side."""
_SAYS_WHY = {Status.STOPPED: ("alarm", "trip"), Status.FAILED: ("device", "failed")}
"""Kinds of events, the last of which says what ended the scan."""
_TEXTS = ("identity", "started_utc", "scan_json", "bench_json", "devices", "warnings", "run_json")


def summarise(path: Path) -> dict[str, Any]:
    """Plain JSON values, the same for the same file: what a person said, what was measured, how far it got, and a
    thumbnail of the rates. Raises `InvalidData` where `path` is no complete recording, `StorageError`.

    Reads a fifth of what `Recording.open` does, and checks less: for a process of its own.
    """
    try:
        with h5py.File(path, "r", locking=False) as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("version") != VERSION:
                raise InvalidData(f"{path}: not a recording of version {VERSION}")
            texts = {name: _text(file, name) for name in _TEXTS}
            return _summary(path, file, texts)
    except (
        OSError, RuntimeError, LookupError, ValueError, TypeError, ArithmeticError, AttributeError, MemoryError
    ) as error:  # fmt: skip
        if isinstance(error, InvalidData):
            raise
        raise InvalidData(f"{path}: not a readable recording: it is damaged, or was cut short") from error


def _text(file: h5py.File, name: str) -> str:
    """Empty where recordings of earlier versions do not have it. Raises `KeyError` where all have it."""
    try:
        item = h5py.h5d.open(file.id, f"header/{name}".encode())
    except KeyError:
        if name in LATER:
            return ""
        raise
    held = np.empty((), dtype=item.dtype)
    if item.shape != () or held.dtype.kind != "S" or held.dtype.itemsize > MAX_TEXT_BYTES:
        raise InvalidData(f"{file.filename}: {name}: is not a text of at most {MAX_TEXT_BYTES} bytes")
    item.read(h5py.h5s.ALL, h5py.h5s.ALL, held)
    return bytes(held[()]).decode("utf-8")


def _summary(path: Path, file: h5py.File, texts: dict[str, str]) -> dict[str, Any]:
    stored = h5py.h5d.open(file.id, b"samples/records")
    planned = stored.shape[0]
    if stored.dtype != RECORD or planned * RECORD.itemsize > path.stat().st_size:
        raise InvalidData(f"{path}: states {planned} points but does not hold them")
    plan = h5py.h5o.open(file.id, b"plan")
    said = {name: _number(file, plan, name) for name in ("width_m", "height_m", "rows", "cols", "bin_width_s")}
    x_m, y_m = (_array(h5py.h5d.open(plan, name), np.dtype(float)) for name in (b"x_m", b"y_m"))
    state, taken, _ = _array(h5py.h5d.open(file.id, b"status"), STATUS)[0].tolist()
    records = _array(stored, RECORD)[: min(int(taken), planned)]
    scan, bench = json.loads(texts["scan_json"]), json.loads(texts["bench_json"])
    notes, pattern = RunNotes.from_json(texts["run_json"] or "{}"), scan.get("pattern", "")
    events = _events(file) if state in (Status.INTERRUPTED, *_SAYS_WHY) else ()
    status = word_of(Status(state), events)
    trouble = [text for kind, text in events if kind in _SAYS_WHY.get(Status(state), ())]
    if state == Status.RUNNING and not is_locked(path):
        status = CUT_OFF
    wall = [said["width_m"], said["height_m"]]
    grid = [min(int(said[name]), MOST_PIXELS) for name in ("rows", "cols")]
    return {
        # A recording without an identity of its own gets it from all of its texts: read by whoever has to know.
        "identity": texts["identity"],
        "started_utc": texts["started_utc"],
        "status": status,
        "points": len(records),
        "planned": planned,
        "photons": int(records["total_count"].sum()),
        "live_s": float(records["live_time_s"].sum()),
        "sample": notes.sample,
        "operator": notes.operator,
        "note": notes.note,
        "tags": list(notes.tags),
        "bench": str(bench.get("name", "")),
        "devices": [f"{who['model']} {who['serial']}".strip() for who in json.loads(texts["devices"]).values()],
        "pattern": str(pattern.get("kind", "") if isinstance(pattern, dict) else pattern),
        "wall": wall,
        "bin_width_s": said["bin_width_s"],
        "dwell_ms": scan.get("dwell_ms"),
        "warnings": len(json.loads(texts["warnings"])),
        **({"trouble": trouble[-1]} if trouble else {}),
        "thumbnail": _thumbnail(records, x_m / wall[0], y_m / wall[1], *grid),
    }


def _events(file: h5py.File) -> list[tuple[str, str]]:
    """(kind, text) of each; none where they cannot be read as such."""
    stored = h5py.h5d.open(file.id, b"events")
    if stored.dtype != EVENT or stored.shape != (EVENT_ROWS,):
        return []
    rows = _array(stored, EVENT)
    return [(kind.decode(errors="replace"), text.decode(errors="replace")) for kind, text in rows[["kind", "text"]]]


def _array(item: h5py.h5d.DatasetID, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """A whole dataset, past h5py's own wrapping, which takes twice as long."""
    held = np.empty(item.shape, dtype)
    item.read(h5py.h5s.ALL, h5py.h5s.ALL, held)
    return held


def _number(file: h5py.File, plan: h5py.h5g.GroupID, name: str) -> float:
    """A scalar attribute."""
    attribute = h5py.h5a.open(plan, name.encode())
    if attribute.shape != () or attribute.dtype.kind not in "iuf":
        raise InvalidData(f"{file.filename}: plan: {name} is not a number")
    held = np.empty((), dtype=float)
    attribute.read(held)
    return float(held)


def _thumbnail(records: npt.NDArray[Any], x: Floats, y: Floats, rows: int, cols: int) -> dict[str, Any]:
    """Mean rate over the wall, whose places are given in parts of it from its centre, in rows x cols grey values, 1 to
    255; 0 where nothing was measured."""
    good = (records["number"] < len(x)) & (records["live_time_s"] > 0)
    records, number = records[good], records["number"][good]
    row = np.clip(((0.5 - y[number]) * rows).astype(int), 0, rows - 1)
    col = np.clip(((x[number] + 0.5) * cols).astype(int), 0, cols - 1)
    photons = np.bincount(row * cols + col, records["total_count"].astype(float), rows * cols)
    live_s = np.bincount(row * cols + col, records["live_time_s"], rows * cols)
    measured = live_s > 0
    rate = np.where(measured, photons / np.where(measured, live_s, 1.0), 0.0)
    low, high = (rate[measured].min(), rate[measured].max()) if measured.any() else (0.0, 0.0)
    grey = np.where(measured, 1 + 254 * (rate - low) / max(high - low, 1e-300), 0).astype(np.uint8)
    return {"rows": rows, "cols": cols, "grey": base64.b64encode(grey.tobytes()).decode("ascii")}
