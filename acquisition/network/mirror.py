"""A served recording, kept as a local one that grows: everything that follows files works on the far machine too."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zmq

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.network.messages import MAX_REPLY_BYTES, MAX_ROWS, answered, decode_plan, decode_samples
from nlos.acquisition.network.ticket import Ticket
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.recording import Status, sample_crc
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

_IDLE_S = 0.2


class _Line:
    """Requests and their answers. What is not answered in time is asked again; asking twice changes nothing."""

    def __init__(self, ticket: Ticket, answer_s: float) -> None:
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        self._socket.curve_serverkey = ticket.server_public.encode()
        self._socket.curve_publickey = ticket.client_public.encode()
        self._socket.curve_secretkey = ticket.client_secret.encode()
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REPLY_BYTES)
        self._socket.setsockopt(zmq.RECONNECT_IVL, 50)
        self._socket.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        self._socket.setsockopt(zmq.HEARTBEAT_IVL, 1000)
        self._socket.connect(ticket.address)
        self._number, self._most, self._answer_s = 0, MAX_ROWS, answer_s

    def ask(self, patience_s: float, **wanted: object) -> list[bytes]:
        """The reply to one request. Raises `TimeoutError` when nobody answered for `patience_s`."""
        deadline_s = time.monotonic() + patience_s
        while time.monotonic() < deadline_s:
            self._number += 1
            try:
                message = {"id": self._number, "most": self._most, **wanted}
                self._socket.send(json.dumps(message).encode(), flags=zmq.NOBLOCK)
            except zmq.Again:
                time.sleep(_IDLE_S)
                continue
            if (frames := self._reply()) is not None:
                self._most = min(2 * self._most, MAX_ROWS)
                return frames
            # A line that breaks within every large answer still lets small ones through.
            self._most = max(1, self._most // 2)
        raise TimeoutError(f"no answer within {patience_s:g} s; is `nlos serve` running, and is this its ticket?")

    def _reply(self) -> list[bytes] | None:
        asked_s = time.monotonic()
        while (left_s := asked_s + self._answer_s - time.monotonic()) > 0:
            if not self._socket.poll(int(left_s * 1000) + 1):
                return None
            frames = self._socket.recv_multipart()
            if answered(frames) == self._number:
                return frames
        return None

    def close(self) -> None:
        self._socket.close()
        self._context.term()


def mirror(
    ticket: Ticket,
    target: Path,
    *,
    patience_s: float = 60.0,
    answer_s: float = 2.0,
    progress: Callable[[int, int], None] | None = None,
) -> int:
    """Copies the served recording to `target` until the scan is over; returns how many samples it holds.

    What is not answered within `answer_s` is asked again; a `target` that holds the beginning is gone on with.
    `progress(samples, planned)` is called after every block. Raises `TimeoutError` where nobody answers for
    `patience_s`, `ResumeRefused` where `target` is another scan.
    """
    line = _Line(ticket, answer_s)
    try:
        plan, header = decode_plan(line.ask(patience_s, want="plan"))
        begun = resume(target, plan, header)
        if begun.writer is None:
            return len(begun.taken)
        with begun.writer as writer:
            _copy(line, writer, plan, patience_s, progress)
            return writer.acknowledged
    finally:
        line.close()


def _copy(
    line: _Line,
    writer: RecordingWriter,
    plan: ScanPlan,
    patience_s: float,
    progress: Callable[[int, int], None] | None,
) -> None:
    have = writer.acknowledged
    while True:
        frames = line.ask(patience_s, want="samples", first=have)
        first, records, counts, over = decode_samples(frames, plan.axis.bins)
        if first != have:
            raise InvalidData(f"asked for sample {have}, the server sent from {first} on")
        for record, histogram in zip(records, counts, strict=True):
            if sample_crc(record.tobytes(), histogram) != int(record["crc"]):
                raise StorageError("a sample changed on its way; the connection is not to be trusted")
            writer.write(_sample(plan, record, histogram))
        have += len(records)
        if len(records):
            writer.flush()
        if progress is not None:
            progress(have, len(plan))
        if over:
            writer.finish(Status.COMPLETE if have == len(plan) else Status.INTERRUPTED)
            return
        if not len(records):
            time.sleep(_IDLE_S)


def _sample(plan: ScanPlan, record: np.void, counts: np.ndarray[tuple[int], np.dtype[np.uint32]]) -> Sample:
    number = int(record["number"])
    if not number < len(plan):
        raise InvalidData(f"the server sent point {number} of a plan of {len(plan)}")
    axis = plan.axis
    histogram = Histogram(
        counts,
        axis.bin_width_s,
        axis.offset_s,
        float(record["live_time_s"]),
        int(record["sync_count"]),
        int(record["total_count"]),
        HistogramFlag(int(record["flags"])),
        float(record["gate_opened_s"]),
    )
    return Sample(plan[number], histogram, float(record["taken_s"]))
