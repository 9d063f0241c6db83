"""A served recording arrives whole on the far side, however often the line is cut, and only with its ticket."""

import os
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.network.messages import decode_plan, decode_request, decode_samples
from nlos.acquisition.network.mirror import mirror
from nlos.acquisition.network.server import SampleServer
from nlos.acquisition.network.ticket import Ticket, new_keys
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

WALL = WallGrid(1.0, 1.0, 20, 20)


def plan() -> ScanPlan:
    row, col = np.divmod(np.arange(400), 20)
    dwell_s, pass_ = np.full(400, 1e-3), np.zeros(400, np.int32)
    return ScanPlan(WALL, HistogramAxis(64, 16e-12, 1e-9), pixels(WALL, row, col), dwell_s, pass_)


def sample(number: int) -> Sample:
    counts = np.random.default_rng(number).poisson(3.0, 64).astype(np.uint32)
    total = int(counts.sum())
    histogram = Histogram(counts, 16e-12, 1e-9, 1e-3, 10_000, total, HistogramFlag.NONE, number * 1e-3)
    return Sample(plan()[number], histogram, number * 1e-3)


def write(path: Path, count: int = 400) -> Path:
    with RecordingWriter.create(path, plan(), Header(scan_text="a scan")) as writer:
        for number in range(count):
            writer.write(sample(number))
    return path


@contextmanager
def serving(run: Path, port: int = 0) -> Iterator[SampleServer]:
    server = SampleServer(run, port=port)
    stop = threading.Event()
    thread = threading.Thread(target=server.serve, args=(lambda: not stop.is_set(),))
    thread.start()
    try:
        yield server
    finally:
        stop.set()
        thread.join()
        server.close()


def same(one: Path, other: Path) -> bool:
    with Recording.open(one) as a, Recording.open(other) as b:
        alike = np.array_equal(a.counts_of(0, len(a)), b.counts_of(0, len(b)))
        return alike and np.array_equal(a.records, b.records) and a.status == b.status and a.header == b.header


def test_a_finished_recording_is_mirrored_whole(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5")
    with serving(run) as server:
        server.ticket.save(tmp_path / "run.ticket")
        assert mirror(Ticket.load(tmp_path / "run.ticket"), tmp_path / "far.h5", patience_s=20) == 400
    assert same(run, tmp_path / "far.h5")


def test_a_growing_recording_is_followed_to_its_end(tmp_path: Path) -> None:
    run = tmp_path / "run.h5"
    writer = RecordingWriter.create(run, plan(), Header())

    def grow() -> None:
        for number in range(400):
            writer.write(sample(number))
            if number % 50 == 0:
                writer.flush()
                time.sleep(0.02)
        writer.finish(Status.COMPLETE)

    thread = threading.Thread(target=grow)
    with serving(run) as server:
        thread.start()
        assert mirror(server.ticket, tmp_path / "far.h5", patience_s=20) == 400
        thread.join()
    assert same(run, tmp_path / "far.h5")


class Cable:
    """A TCP relay that can be cut: it forwards bytes and now and then closes what passes through it."""

    def __init__(self, target: int, seed: int, most_cuts: int) -> None:
        self._target, self._rng, self._most_cuts = target, np.random.default_rng(seed), most_cuts
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.cuts = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while True:
            try:
                near, _ = self._listener.accept()
            except OSError:
                return
            far = socket.create_connection(("127.0.0.1", self._target))
            budget = int(self._rng.integers(500, 20_000)) if self.cuts < self._most_cuts else 1 << 40
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._pump, args=(source, sink, near, far, budget), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, near: socket.socket, far: socket.socket,
              budget: int) -> None:  # fmt: skip
        try:
            while budget > 0 and (data := source.recv(4096)):
                sink.sendall(data[:budget])
                budget -= len(data)
            self.cuts += budget <= 0
        except OSError:
            pass
        for end in (near, far):
            end.close()

    def close(self) -> None:
        self._listener.close()


@pytest.mark.soak
def test_a_line_that_is_cut_again_and_again_delivers_every_sample_once(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5")
    with serving(run) as server:
        cable = Cable(int(server.ticket.address.rsplit(":", 1)[1]), 3, 50 if os.environ.get("NLOS_SOAK") else 6)
        keys = server.ticket
        ticket = Ticket(f"tcp://127.0.0.1:{cable.port}", keys.server_public, keys.client_public, keys.client_secret)
        assert mirror(ticket, tmp_path / "far.h5", patience_s=60, answer_s=0.3) == 400
        cable.close()
    assert cable.cuts > 0
    assert same(run, tmp_path / "far.h5")


def test_a_mirror_that_was_interrupted_goes_on(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5")
    with RecordingWriter.create(tmp_path / "far.h5", plan(), Header(scan_text="a scan")) as writer:
        for number in range(123):
            writer.write(sample(number))
    with serving(run) as server:
        assert mirror(server.ticket, tmp_path / "far.h5", patience_s=20) == 400
    with Recording.open(run) as a, Recording.open(tmp_path / "far.h5") as b:
        assert np.array_equal(a.counts_of(0, 400), b.counts_of(0, 400))


def test_nobody_is_answered_without_the_tickets_keys(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5", 10)
    with serving(run) as server:
        address, public, secret = server.ticket.address, *new_keys()
        with pytest.raises(TimeoutError):
            mirror(Ticket(address, server.ticket.server_public, public, secret), tmp_path / "far.h5", patience_s=1)
        plain = zmq.Context().socket(zmq.DEALER)
        plain.connect(address)
        plain.send(b'{"id": 1, "want": "plan"}')
        assert plain.poll(500) == 0
        plain.close(linger=0)
        with socket.create_connection(("127.0.0.1", int(address.rsplit(":", 1)[1]))) as raw:
            raw.sendall(np.random.default_rng(0).bytes(5000))
        assert mirror(server.ticket, tmp_path / "far.h5", patience_s=20) == 10


@given(st.binary(max_size=300))
def test_hostile_requests_are_refused(frame: bytes) -> None:
    try:
        decode_request(frame)
    except InvalidData:
        return
    assert b"want" in frame


@given(st.lists(st.binary(max_size=200), max_size=4))
def test_hostile_replies_are_refused(frames: list[bytes]) -> None:
    with pytest.raises(InvalidData):
        decode_plan(frames)
    with pytest.raises(InvalidData):
        decode_samples(frames, 64)


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"nlos": "ticket"}', '{"nlos": "ticket", "address": 1}'])
def test_what_is_no_ticket_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "bad.ticket").write_text(text)
    with pytest.raises(InvalidData, match=r"bad\.ticket"):
        Ticket.load(tmp_path / "bad.ticket")
