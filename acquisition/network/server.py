"""Serves a recording, growing or finished, to whoever holds its ticket. Reads the file; never touches the scan."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zmq
from zmq.auth.thread import ThreadAuthenticator

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.network.messages import (
    MAX_REQUEST_BYTES,
    Request,
    decode_request,
    encode_plan,
    encode_samples,
)
from nlos.acquisition.network.ticket import Ticket, new_keys
from nlos.acquisition.recording.recording import Recording, Status, sample_crc

_POLL_MS = 200
MAX_BLOCK_BYTES = 16 << 20


class SampleServer:
    """One recording on one port. CurveZMQ: connections without the ticket's keys are refused in the handshake."""

    def __init__(self, run: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        """Binds at once; port 0 takes a free one. Raises `OSError` where the port is taken."""
        self._run = run
        self._recording: Recording | None = None
        self._inode = 0
        self._intact: list[int] = []
        self._looked_at = 0
        self.answers = 0
        """How many questions were answered."""
        self._context = zmq.Context()
        server_public, server_secret = new_keys()
        client_public, client_secret = new_keys()
        self._door = ThreadAuthenticator(self._context)
        self._door.start()
        # Only this one client key is let in.
        self._door.configure_curve_callback("*", _OnlyKey(client_public))
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.curve_server = True
        self._socket.curve_publickey = server_public.encode()
        self._socket.curve_secretkey = server_secret.encode()
        self._socket.setsockopt(zmq.MAXMSGSIZE, MAX_REQUEST_BYTES)
        self._socket.setsockopt(zmq.LINGER, 0)
        try:
            bound = self._socket.bind_to_random_port(f"tcp://{host}") if port == 0 else port
            if port != 0:
                self._socket.bind(f"tcp://{host}:{port}")
        except zmq.ZMQError as error:
            self.close()
            raise OSError(f"tcp://{host}:{port}: cannot be bound ({error.strerror}). Choose another --port.") from error
        self.ticket = Ticket(f"tcp://{host}:{bound}", server_public, client_public, client_secret)

    def serve(self, go_on: Callable[[], bool]) -> None:
        """Answers requests until `go_on` says no. A file that vanishes or is replaced is opened again."""
        while go_on():
            if self._socket.poll(_POLL_MS):
                self._answer(self._socket.recv_multipart())

    def close(self) -> None:
        """May be called twice."""
        if self._recording is not None:
            self._recording.close()
            self._recording = None
        self._socket.close()
        if self._door.is_alive():
            self._door.stop()
        self._context.term()

    def _answer(self, frames: list[bytes]) -> None:
        """Answers what is a request; anything else is dropped without an answer."""
        if len(frames) != 2:
            return
        try:
            request = decode_request(frames[1])
            reply = self._reply(request)
        except (InvalidData, FileNotFoundError):
            return
        self._socket.send_multipart([frames[0], *reply], flags=zmq.NOBLOCK)
        self.answers += 1

    def _reply(self, request: Request) -> list[bytes]:
        recording = self._refreshed()
        if request.want == "plan":
            return encode_plan(request.id, recording.plan, recording.header)
        bins = recording.plan.axis.bins
        most = max(1, min(request.most, MAX_BLOCK_BYTES // (bins * 4)))
        over = recording.status is not Status.RUNNING
        self._look_further(recording, request.first + most, over)
        rows = self._intact[request.first : request.first + most]
        if rows:
            counts = np.concatenate([recording.counts_of(row, row + 1) for row in rows])
        else:
            counts = np.zeros((0, bins), np.uint32)
        last = over and request.first + len(rows) >= len(self._intact) and self._looked_at >= len(recording)
        return encode_samples(request.id, request.first, recording.records[rows], counts, last)

    def _look_further(self, recording: Recording, wanted: int, over: bool) -> None:
        """Lists intact rows up to the `wanted`-th; stops at one still on its way to the disk."""
        while len(self._intact) < wanted and self._looked_at < len(recording):
            row = self._looked_at
            record, counts = recording.records[row], recording.counts_of(row, row + 1)[0]
            if sample_crc(record.tobytes(), counts) == int(record["crc"]):
                self._intact.append(row)
            elif not over:
                return
            self._looked_at += 1

    def _refreshed(self) -> Recording:
        """The recording as it is now, reopened where another file took its name."""
        inode = self._run.stat().st_ino
        if self._recording is not None and inode != self._inode:
            self._recording.close()
            self._recording = None
        if self._recording is None:
            self._recording, self._inode = Recording.open(self._run), inode
            self._intact, self._looked_at = [], 0
        self._recording.refresh()
        return self._recording


class _OnlyKey:
    """What ZMQ's authenticator asks whether a client's key is known."""

    def __init__(self, key: str) -> None:
        self._key = key.encode()

    def callback(self, domain: str, key: bytes) -> bool:
        return key == self._key


def until(deadline_s: float) -> Callable[[], bool]:
    """A `go_on` that ends at a moment of the monotonic clock."""
    return lambda: time.monotonic() < deadline_s
