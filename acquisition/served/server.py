"""Serves a recording, growing or finished, to whoever holds its ticket. Reads the file; never touches the scan."""

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zmq
from zmq.auth.thread import ThreadAuthenticator

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.recording.condition import RowState
from nlos.acquisition.recording.follow import LEFT_ALONE_S
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer_lock import is_locked
from nlos.acquisition.served.address import endpoint, listening_address
from nlos.acquisition.served.messages import (
    MAX_REQUEST_BYTES,
    Block,
    Request,
    decode_request,
    encode_block,
    encode_plan,
)
from nlos.acquisition.served.ticket import Ticket, new_keys

_POLL_MS = 200
_LOOK_S = 0.5
MAX_BLOCK_BYTES = 16 << 20


class AddressTaken(OSError):
    """Nobody can listen there: the port is taken, or the address is not this machine's."""


class SampleServer:
    """One recording on one port. CurveZMQ: connections without the ticket's keys are refused in the handshake."""

    def __init__(self, run: Path, host: str = "127.0.0.1", port: int = 0) -> None:
        """Binds at once; port 0 takes a free one. Raises `ValueError` for a host that is not one address,
        `AddressTaken`, and what opening `run` raises."""
        address = listening_address(host)
        self._run = run
        self._recording, self._inode = Recording.open(run), run.stat().st_ino
        self._which = self._recording.header.identity
        self._intact: list[int] = []
        self._looked_at = 0
        self._looked_s = self._alone_since_s = time.monotonic()
        self.answers = 0
        """How many questions were answered."""
        self.left = False
        """The file says that it is being written, and nobody has done so for a while."""
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
        self._socket.setsockopt(zmq.IPV6, ":" in address)
        try:
            self._socket.bind(endpoint(address, port) if port else endpoint(address, 0).removesuffix("0") + "*")
            bound = int(self._socket.getsockopt_string(zmq.LAST_ENDPOINT).rpartition(":")[2])
        except zmq.ZMQError as error:
            self.close()
            raise AddressTaken(f"{endpoint(address, port)}: cannot be bound ({error.strerror})") from error
        self.ticket = Ticket(endpoint(address, bound), server_public, client_public, client_secret, self._which)

    @property
    def over(self) -> bool:
        """Whether no more samples are to be expected: the scan has ended, or its writer is gone."""
        return self.left or self._recording.status is not Status.RUNNING

    def serve(self, go_on: Callable[[], bool]) -> None:
        """Answers requests until `go_on` says no. Continues through a crash and `--resume`; raises `StorageError` where
        another recording takes the file's place."""
        while go_on():
            if self._socket.poll(_POLL_MS):
                self._answer(self._socket.recv_multipart())
            if time.monotonic() - self._looked_s > _LOOK_S:
                self._look()

    def close(self) -> None:
        """May be called twice."""
        self._recording.close()
        self._socket.close()
        if self._door.is_alive():
            self._door.stop()
        self._context.term()

    def _answer(self, frames: list[bytes]) -> None:
        """Answers what is a request; anything else is dropped without an answer."""
        if len(frames) != 2:
            return
        try:
            reply = self._reply(decode_request(frames[1]))
        except InvalidData:
            return
        try:
            self._socket.send_multipart([frames[0], *reply], flags=zmq.NOBLOCK)
        except zmq.Again:
            return  # the asker is gone or does not listen; it asks again
        self.answers += 1

    def _reply(self, request: Request) -> list[bytes]:
        seen, status = self._recording, self._recording.status  # before its rows: a scan may end between two looks
        self._look()
        recording = self._recording
        if request.want == "plan":
            return encode_plan(request.id, recording.plan, recording.header)
        bins = recording.plan.axis.bins
        most = max(1, min(request.most, MAX_BLOCK_BYTES // (bins * 4)))
        over = self.left or (recording is seen and status is not Status.RUNNING)
        self._look_further(recording, request.first + most, over)
        rows = self._intact[request.first : request.first + most]
        if rows:
            counts = np.concatenate([recording.counts_of(row, row + 1) for row in rows])
        else:
            counts = np.zeros((0, bins), np.uint32)
        last = over and request.first + len(rows) >= len(self._intact) and self._looked_at >= len(recording)
        events = tuple(recording.events()[request.log :])
        return encode_block(
            request.id,
            Block(self._which, request.first, recording.records[rows], counts, events, request.log,
                  (Status.FAILED if self.left else status) if last else None, self.left),
        )  # fmt: skip

    def _look_further(self, recording: Recording, wanted: int, over: bool) -> None:
        """Lists intact rows up to the `wanted`-th; stops at one still on its way to the disk."""
        while len(self._intact) < wanted and self._looked_at < len(recording):
            state = recording.state_of(self._looked_at)
            if state is RowState.INTACT:
                self._intact.append(self._looked_at)
            elif state is RowState.UNACKNOWLEDGED and not over:
                return
            self._looked_at += 1

    def _look(self) -> None:
        """The recording as it is now, reopened where `--resume` put a new file in its place."""
        now_s = self._looked_s = time.monotonic()
        try:
            inode = self._run.stat().st_ino
        except FileNotFoundError as error:
            raise StorageError(f"{self._run}: was deleted or moved while it was served.") from error
        if inode != self._inode:
            fresh = Recording.open(self._run)
            self._recording.close()
            self._recording, self._inode = fresh, inode
            self._intact, self._looked_at = [], 0
            if fresh.header.identity != self._which:
                raise StorageError(f"{self._run}: another recording has taken its place. Serve that one instead.")
        before = len(self._recording)
        alone = self._recording.refresh() == before and not is_locked(self._run)
        if not alone or self._recording.status is not Status.RUNNING:
            self._alone_since_s = now_s
        self.left = now_s - self._alone_since_s > LEFT_ALONE_S


class _OnlyKey:
    """What ZMQ's authenticator asks whether a client's key is known."""

    def __init__(self, key: str) -> None:
        self._key = key.encode()

    def callback(self, domain: str, key: bytes) -> bool:
        return key == self._key
