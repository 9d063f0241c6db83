"""A served recording, kept as a local one that grows: everything that follows files works on the far machine too."""

import json
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zmq

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.recording.recording import Event, Recording, Status, sample_crc
from nlos.acquisition.recording.salvage import end_film, resume
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.served.messages import (
    MAX_REPLY_BYTES,
    MAX_ROWS,
    Block,
    answered,
    decode_block,
    decode_plan,
)
from nlos.acquisition.served.ticket import Ticket
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag

_IDLE_S = 0.2


class _Line:
    """Requests and their answers. What is not answered in time is asked again; asking twice changes nothing."""

    def __init__(self, ticket: Ticket, answer_s: float) -> None:
        """Raises `InvalidData` where ZMQ cannot make anything of the ticket's address or keys."""
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.DEALER)
        try:
            self._socket.curve_serverkey = ticket.server_public.encode()
            self._socket.curve_publickey = ticket.client_public.encode()
            self._socket.curve_secretkey = ticket.client_secret.encode()
            self._socket.setsockopt(zmq.LINGER, 0)
            self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REPLY_BYTES)
            self._socket.setsockopt(zmq.RECONNECT_IVL, 50)
            self._socket.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
            self._socket.setsockopt(zmq.HEARTBEAT_IVL, 1000)
            self._socket.setsockopt(zmq.IPV6, "[" in ticket.address)
            self._socket.connect(ticket.address)
        except zmq.ZMQError as error:
            self.close()
            raise InvalidData(f"the ticket's address {ticket.address!r} cannot be called ({error.strerror})") from error
        self._number, self._most, self._answer_s = 0, MAX_ROWS, answer_s

    def ask(self, patience_s: float, stopped: Callable[[], bool], **wanted: object) -> list[bytes] | None:
        """The reply to one request; None once `stopped()`. Raises `TimeoutError` when nobody answered for
        `patience_s`."""
        deadline_s = time.monotonic() + patience_s
        while time.monotonic() < deadline_s:
            if stopped():
                return None
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


def copy_served(
    ticket: Ticket,
    target: Path,
    *,
    patience_s: float = 60.0,
    answer_s: float = 2.0,
    begun: Callable[[], None] | None = None,
    stopped: Callable[[], bool] | None = None,
) -> int:
    """Copies the served recording to `target`, events included, until the scan is over or `stopped()`; returns how many
    samples it holds.

    What is not answered within `answer_s` is asked again; a `target` that holds the beginning is resumed. `begun()` is
    called once `target` is there to be followed. Raises `TimeoutError` where nobody answers for `patience_s`,
    `ResumeRefused` where `target` is another scan, `InvalidData` where the server has another one than the ticket says,
    `StorageError` where the scan's own writer is gone.
    """
    line = _Line(ticket, answer_s)
    try:
        stopped = stopped or (lambda: False)
        frames = line.ask(patience_s, stopped, want="plan")
        if frames is None:
            return 0
        plan, header = decode_plan(frames)
        if header.identity != ticket.recording:
            raise InvalidData("the server has another recording than the ticket is for. Ask for a new ticket.")
        held = _events_of(target)
        resumed = resume(target, plan, header, same_run=True)
        if begun is not None:
            begun()
        if resumed.writer is None:
            return len(resumed.taken)
        with resumed.writer as writer:
            copy = _Copy(line, writer, plan, ticket.recording, patience_s, held)
            ended = copy.run(stopped)
        if plan.until_stopped and ended in (Status.INTERRUPTED, Status.COMPLETE):
            end_film(target)
        return writer.acknowledged
    finally:
        line.close()


class _Copy:
    """Block after block into a growing file."""

    def __init__(
        self, line: _Line, writer: RecordingWriter, plan: ScanPlan, run: str, patience_s: float, held: set[Event]
    ) -> None:
        self._line, self._writer, self._plan, self._run = line, writer, plan, run
        self._patience_s, self._held = patience_s, held
        self._have, self._log = writer.acknowledged, 0

    def run(self, stopped: Callable[[], bool]) -> Status | None:
        """Until the served scan has ended, as the copy does then: returns how. None where it was `stopped`."""
        while True:
            frames = self._line.ask(self._patience_s, stopped, want="samples", first=self._have, log=self._log)
            if frames is None:
                self._writer.finish(Status.INTERRUPTED)
                return None
            block = decode_block(frames, self._plan.axis.bins)
            if (block.run, block.first) != (self._run, self._have):
                raise InvalidData(
                    f"asked for sample {self._have} of {self._run:.8}, got {block.first} of {block.run:.8}"
                )
            self._keep(block)
            if block.left:
                raise StorageError(
                    f"the served scan's writer is gone after {self._have} samples. Resume the scan, then follow again."
                )
            if block.ended is not None:
                self._writer.finish(block.ended)
                return block.ended
            if not len(block.records):
                time.sleep(_IDLE_S)

    def _keep(self, block: Block) -> None:
        for record, histogram in zip(block.records, block.counts, strict=True):
            if sample_crc(record.tobytes(), histogram) != int(record["crc"]):
                raise StorageError("a sample changed on its way; the connection is not to be trusted")
            self._writer.write(_sample(self._plan, record, histogram))
        self._have += len(block.records)
        for event in block.events:
            if event not in self._held:
                self._writer.log(event.kind, event.text, event.bench_s, event.unix_s)
        self._log = block.log + len(block.events)
        if len(block.records):
            self._writer.flush()


def _events_of(target: Path) -> set[Event]:
    """What an earlier copy already keeps."""
    try:
        with Recording.open(target) as recording:
            return set(recording.events())
    except (FileNotFoundError, InvalidData):
        return set()


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
