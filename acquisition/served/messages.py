"""What server and client say to each other: JSON and raw arrays, checked before they are believed.

Request: one JSON frame. Reply: a JSON frame, then what it announces - the plan's columns, or rows of `RECORD` and
their counts, all little-endian. A client that knows n samples asks for the n-th on; replies carry the request's id, so
that a late one is never taken for the answer to another question, and say which recording they are of.
"""

import json
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, ValidationError

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.header import COLUMNS
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import EVENT_ROWS, RECORD, Event, Status
from nlos.acquisition.recording.validation import MAX_BINS, MAX_POINTS
from nlos.configs.settings import Settings

MAX_ROWS = 256
MAX_REQUEST_BYTES = 1024
MAX_REPLY_BYTES = 1 << 30


class Request(Settings):
    """`want`: the plan and header, or at most `most` samples from the `first`-th intact one on, and events from the
    `log`-th on."""

    id: int = Field(ge=0, lt=1 << 53)
    want: Literal["plan", "samples"]
    first: int = Field(default=0, ge=0, le=MAX_POINTS)
    most: int = Field(default=MAX_ROWS, ge=1, le=MAX_ROWS)
    log: int = Field(default=0, ge=0, le=EVENT_ROWS)


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
        "plan": plan.scalars(),
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
        if not 0 < int(about["plan"]["axis"]["bins"]) <= MAX_BINS:
            raise ValueError(f"{about['plan']['axis']['bins']} bins")
        plan = ScanPlan.from_parts(about["plan"], column)
        if plan.digest() != about["digest"]:
            raise ValueError("the digest does not match")
        return plan, Header.from_texts(about["header"])
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidData(
            f"the server's plan is not one that this nlos knows ({error}). Install the same on both machines."
        ) from error


@dataclass(frozen=True)
class Block:
    """The answer to `want: samples`: rows from the `first`-th intact one on, and events from the `log`-th on.

    `ended`: None while more may come, else how the scan ended; with `left`, that nobody writes it any more although it
    says that it is running (a crash, a kill).
    """

    run: str
    first: int
    records: npt.NDArray[Any]  # (n,) RECORD
    counts: npt.NDArray[np.uint32]  # (n, T)
    events: tuple[Event, ...] = ()
    log: int = 0
    ended: Status | None = None
    left: bool = False


def encode_block(number: int, block: Block) -> list[bytes]:
    about = {
        "id": number,
        "run": block.run,
        "first": block.first,
        "rows": len(block.records),
        "log": block.log,
        "events": [[event.unix_s, event.bench_s, event.kind, event.text] for event in block.events],
        "ended": None if block.ended is None else int(block.ended),
        "left": block.left,
    }
    counts = np.ascontiguousarray(block.counts, dtype="<u4").tobytes()
    return [json.dumps(about).encode(), block.records.tobytes(), counts]


def decode_block(frames: list[bytes], bins: int) -> Block:
    """Raises `InvalidData` for anything else than `encode_block` made."""
    try:
        said = _About.model_validate_json(frames[0] if frames else b"")
    except ValidationError as error:
        raise InvalidData("the server's answer does not say what it holds") from error
    if len(frames) != 3 or len(frames[1]) != said.rows * RECORD.itemsize or len(frames[2]) != said.rows * bins * 4:
        raise InvalidData(
            f"the server announced {said.rows} samples and sent {[len(frame) for frame in frames[1:]]} bytes"
        )
    counts = np.frombuffer(frames[2], dtype="<u4").reshape(said.rows, bins)
    records = np.frombuffer(frames[1], dtype=RECORD)
    ended = None if said.ended is None else Status(said.ended)
    events = tuple(Event(*event) for event in said.events)
    return Block(said.run, said.first, records, counts, events, said.log, ended, said.left)


class _About(Settings):
    """The JSON of a `Block`."""

    id: int
    run: str = Field(max_length=64)
    first: int = Field(ge=0, le=MAX_POINTS)
    rows: int = Field(ge=0, le=MAX_ROWS)
    log: int = Field(ge=0, le=EVENT_ROWS)
    events: list[tuple[float, float, str, str]] = Field(max_length=EVENT_ROWS)
    ended: Literal[2, 3, 4, 5] | None
    left: bool


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
        raise InvalidData("a reply that is not a JSON object")
    return about
