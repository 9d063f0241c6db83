"""What server and client say to each other: JSON and raw arrays, checked before they are believed.

Request: one JSON frame. Reply: a JSON frame, then what it announces - the plan's columns, or rows of `RECORD` and
their counts, all little-endian. A client that knows n samples asks for the n-th on; replies carry the request's id, so
that a late one is never taken for the answer to another question.
"""

import json
from dataclasses import asdict
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import Positions
from nlos.acquisition.recording.header import COLUMNS, MAX_BINS, MAX_POINTS
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import RECORD
from nlos.acquisition.wall import WallGrid
from nlos.configs.settings import Settings
from nlos.drivers.tcspc.counter import HistogramAxis, StopAtCounts

MAX_ROWS = 256
MAX_REQUEST_BYTES = 1024
MAX_REPLY_BYTES = 1 << 30


class Request(Settings):
    """`want`: the plan and header, or at most `most` samples from the `first`-th intact one on."""

    id: int = Field(ge=0, lt=1 << 53)
    want: Literal["plan", "samples"]
    first: int = Field(default=0, ge=0, le=MAX_POINTS)
    most: int = Field(default=MAX_ROWS, ge=1, le=MAX_ROWS)


def decode_request(frame: bytes) -> Request:
    """Raises `InvalidData` for anything that is not a request."""
    if len(frame) > MAX_REQUEST_BYTES:
        raise InvalidData(f"a request of {len(frame)} bytes")
    try:
        return Request.model_validate_json(frame)
    except ValidationError as error:
        raise InvalidData(f"not a request: {error.error_count()} faults") from error


def encode_plan(number: int, plan: ScanPlan, header: Header) -> list[bytes]:
    """The answer to `want: plan`."""
    about = {
        "id": number,
        "wall": asdict(plan.wall),
        "axis": asdict(plan.axis),
        "stop": asdict(plan.stop) if plan.stop else None,
        "revisit_below": plan.revisit_below,
        "points": len(plan),
        "digest": plan.digest(),
        "header": header.texts(),
    }
    columns = [np.ascontiguousarray(plan.columns()[name], dtype=dtype).tobytes() for name, dtype in COLUMNS.items()]
    return [json.dumps(about).encode(), *columns]


def decode_plan(frames: list[bytes]) -> tuple[ScanPlan, Header]:
    """Raises `InvalidData` for anything that is not a plan, or not the plan that its digest was made of."""
    about = _json(frames)
    try:
        points = about["points"]
        if not (isinstance(points, int) and 0 < points <= MAX_POINTS and len(frames) == 1 + len(COLUMNS)):
            raise ValueError(f"{points} points in {len(frames)} frames")
        column = {}
        for (name, dtype), frame in zip(COLUMNS.items(), frames[1:], strict=True):
            column[name] = np.frombuffer(frame, dtype=dtype)
            if column[name].shape != (points,):
                raise ValueError(f"{name} has {len(frame)} bytes for {points} points")
        axis = HistogramAxis(**about["axis"])
        if not 0 < axis.bins <= MAX_BINS:
            raise ValueError(f"{axis.bins} bins")
        stop = StopAtCounts(**about["stop"]) if about["stop"] else None
        positions = Positions(column["row"], column["col"], column["x_m"], column["y_m"])
        plan = ScanPlan(
            WallGrid(**about["wall"]), axis, positions, column["dwell_s"], column["pass"], stop, about["revisit_below"]
        )
        if plan.digest() != about["digest"]:
            raise ValueError("the digest does not fit")
        return plan, Header.from_texts(about["header"])
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidData(f"the server's plan is not one ({error})") from error


def encode_samples(number: int, first: int, records: npt.NDArray[Any], counts: npt.NDArray[np.uint32],
                   over: bool) -> list[bytes]:  # fmt: skip
    """The answer to `want: samples`; `over`: no more will come."""
    about = {"id": number, "first": first, "rows": len(records), "over": over}
    return [json.dumps(about).encode(), records.tobytes(), np.ascontiguousarray(counts, dtype="<u4").tobytes()]


def decode_samples(frames: list[bytes], bins: int) -> tuple[int, npt.NDArray[Any], npt.NDArray[np.uint32], bool]:
    """(first, records (n,), counts (n, T), over). Raises `InvalidData` for anything else."""
    about = _json(frames)
    rows, first, over = about.get("rows"), about.get("first"), about.get("over")
    if not (isinstance(rows, int) and 0 <= rows <= MAX_ROWS and isinstance(first, int) and isinstance(over, bool)):
        raise InvalidData("the server's answer does not say what it holds")
    if len(frames) != 3 or len(frames[1]) != rows * RECORD.itemsize or len(frames[2]) != rows * bins * 4:
        raise InvalidData(f"the server announced {rows} samples and sent {[len(frame) for frame in frames[1:]]} bytes")
    counts = np.frombuffer(frames[2], dtype="<u4").reshape(rows, bins)
    return first, np.frombuffer(frames[1], dtype=RECORD), counts, over


def answered(frames: list[bytes]) -> int:
    """The id of the request that a reply answers. Raises `InvalidData`."""
    number = _json(frames).get("id")
    if not isinstance(number, int):
        raise InvalidData("a reply without an id")
    return number


def _json(frames: list[bytes]) -> dict[str, Any]:
    try:
        about = json.loads(frames[0])
    except (IndexError, ValueError, RecursionError) as error:
        raise InvalidData("a reply that is not JSON") from error
    if not isinstance(about, dict):
        raise InvalidData("a reply that is no object")
    return about
