"""A served recording arrives whole on the far side, however often the line is cut, and only with its ticket."""

import contextlib
import json
import os
import socket
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zmq
from hypothesis import given
from hypothesis import strategies as st

from nlos.acquisition.errors import InvalidData, StorageError
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.sample import Sample
from nlos.acquisition.served.address import listening_address
from nlos.acquisition.served.messages import Block, decode_block, decode_plan, decode_request, encode_block
from nlos.acquisition.served.served_copy import copy_served
from nlos.acquisition.served.server import AddressTaken, SampleServer
from nlos.acquisition.served.ticket import Ticket, new_keys
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag
from tests.acquisition.serving import serving

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


def same(one: Path, other: Path) -> bool:
    with Recording.open(one) as a, Recording.open(other) as b:
        alike = np.array_equal(a.counts_of(0, len(a)), b.counts_of(0, len(b)))
        return alike and np.array_equal(a.records, b.records) and a.status == b.status and a.header == b.header


def test_a_finished_recording_is_mirrored_whole(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5")
    with serving(run) as server:
        server.ticket.save(tmp_path / "run.ticket")
        assert copy_served(Ticket.load(tmp_path / "run.ticket"), tmp_path / "far.h5", patience_s=20) == 400
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
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20) == 400
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
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts; closing alone does not
        self._listener.close()
        self._thread.join(5)


@pytest.mark.soak
def test_a_line_that_is_cut_again_and_again_delivers_every_sample_once(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5")
    with serving(run) as server:
        cable = Cable(int(server.ticket.address.rsplit(":", 1)[1]), 3, 50 if os.environ.get("NLOS_SOAK") else 6)
        ticket = replace(server.ticket, address=f"tcp://127.0.0.1:{cable.port}")
        assert copy_served(ticket, tmp_path / "far.h5", patience_s=60, answer_s=0.3) == 400
        cable.close()
    assert cable.cuts > 0
    assert same(run, tmp_path / "far.h5")


def test_a_mirror_that_was_interrupted_goes_on(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5")
    with Recording.open(run) as recording:
        header = recording.header
    with RecordingWriter.create(tmp_path / "far.h5", plan(), header) as writer:
        for number in range(123):
            writer.write(sample(number))
    with serving(run) as server:
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20) == 400
    with Recording.open(run) as a, Recording.open(tmp_path / "far.h5") as b:
        assert np.array_equal(a.counts_of(0, 400), b.counts_of(0, 400))


@pytest.mark.parametrize("what", ["counts", "records"])
def test_a_sample_that_changed_on_its_way_is_not_kept(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One number of one of them; what came before it is there."""

    def changed(number: int, block: Block) -> list[bytes]:
        records, counts = block.records.copy(), block.counts.copy()
        if len(records):
            (records["live_time_s"] if what == "records" else counts[:, 60])[7] += 1
        return encode_block(number, replace(block, records=records, counts=counts))

    run = write(tmp_path / "run.h5", 10)
    monkeypatch.setattr("nlos.acquisition.served.server.encode_block", changed)
    with serving(run) as server, pytest.raises(StorageError, match="a sample changed on its way"):
        copy_served(server.ticket, tmp_path / "far.h5", patience_s=20)
    with Recording.open(tmp_path / "far.h5") as far:
        assert [each.point.number for each in far.samples()] == list(range(7))


def test_nobody_is_answered_without_the_tickets_keys(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5", 10)
    with serving(run) as server:
        address, public, secret = server.ticket.address, *new_keys()
        stranger = replace(server.ticket, client_public=public, client_secret=secret)
        with pytest.raises(TimeoutError):
            copy_served(stranger, tmp_path / "far.h5", patience_s=1)
        plain = zmq.Context().socket(zmq.DEALER)
        plain.connect(address)
        with contextlib.suppress(zmq.Again):  # refused already: to wait for room would be to wait for ever
            plain.send(b'{"id": 1, "want": "plan"}', zmq.DONTWAIT)
        assert plain.poll(500) == 0
        plain.close(linger=0)
        with socket.create_connection(("127.0.0.1", int(address.rsplit(":", 1)[1]))) as raw:
            raw.sendall(np.random.default_rng(0).bytes(5000))
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20) == 10


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
        decode_block(frames, 64)


GOOD = {
    "nlos": "ticket", "address": "tcp://127.0.0.1:5000", "server_public": "a" * 40, "client_public": "b" * 40,
    "client_secret": "c" * 40, "recording": "d" * 64,
}  # fmt: skip


@pytest.mark.parametrize(
    "change",
    [
        "", "{}", "[1]", "[" * 4000, '{"nlos": "ticket"}', {"address": 1}, {"more": "1"}, {"nlos": "tickets"},
        {"server_public": "a" * 39}, {"client_public": "\u00e9" * 40}, {"client_secret": '"' * 40},
        {"server_public": "#" * 40},
        *({"address": each} for each in (
            "", "127.0.0.1:5000", "tcp://", "tcp://127.0.0.1", "tcp://127.0.0.1:", "tcp://127.0.0.1:0",
            "tcp://127.0.0.1:65536", "tcp://127.0.0.1:99999999999", "tcp://127.0.0.1:-1", "tcp://*:5000",
            "tcp://127.0.0.1:*", "tcp://0.0.0.0:5000", "tcp://0:5000", "tcp://0x0:5000", "tcp://[::]:5000",
            "tcp://a b:5000", "tcp://127.0.0.1:5000;10.0.0.1:5000", "ipc:///tmp/x", "udp://127.0.0.1:5000",
            "tcp://127.0.0.1:5000\n", "tcp://:5000", "tcp://[::1:5000", "inproc://here",
        )),
    ],
)  # fmt: skip
def test_what_is_no_ticket_is_refused(change: "str | dict[str, object]", tmp_path: Path) -> None:
    path, words = tmp_path / "bad.ticket", {key: value for key, value in GOOD.items() if key != "nlos"}
    if isinstance(change, str):
        path.write_text(change)
    else:
        Ticket(**words).save(path)  # its checksum is right where it is a ticket at all
        if change.keys() <= words.keys():
            Ticket(**{**words, **change}).save(path)
        else:
            path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(InvalidData, match=r"bad\.ticket") as refused:
        Ticket.load(path)
    assert "checksum" not in str(refused.value)


@pytest.mark.parametrize("key", GOOD)
def test_a_ticket_with_one_letter_changed_is_refused_before_anybody_is_called(key: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.ticket"
    Ticket(**{key: value for key, value in GOOD.items() if key != "nlos"}).save(path)
    stored = json.loads(path.read_text())
    stored[key] = stored[key][:-1] + ("1" if stored[key][-1] != "1" else "2")
    path.write_text(json.dumps(stored))
    with pytest.raises(InvalidData, match=r"bad\.ticket.*(checksum|not a ticket)"):
        Ticket.load(path)


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:5000", "tcp://bench.lab.example:1", "tcp://[::1]:65535"])
def test_a_ticket_is_read_as_it_was_saved(address: str, tmp_path: Path) -> None:
    ticket = Ticket(**{key: value for key, value in {**GOOD, "address": address}.items() if key != "nlos"})
    ticket.save(tmp_path / "run.ticket")
    assert Ticket.load(tmp_path / "run.ticket") == ticket
    assert [path.name for path in tmp_path.iterdir()] == ["run.ticket"]


def test_a_ticket_that_no_disk_takes_is_told_by_its_name(tmp_path: Path) -> None:
    ticket = Ticket(**{key: value for key, value in GOOD.items() if key != "nlos"})
    with pytest.raises(StorageError, match=r"run\.ticket: cannot be written \(No such file or directory\)"):
        ticket.save(tmp_path / "gone" / "run.ticket")


def test_a_server_removes_its_own_ticket_only(tmp_path: Path) -> None:
    run, path = write(tmp_path / "run.h5", 10), tmp_path / "run.ticket"
    with serving(run) as first, serving(run) as second:
        first.ticket.save(path)
        second.ticket.save(path)
        first.ticket.withdraw(path)
        assert Ticket.load(path) == second.ticket
        second.ticket.withdraw(path)
        assert not path.exists()
        path.write_text("notes of mine")
        with pytest.raises(FileExistsError, match="not a ticket"):
            first.ticket.save(path)
        first.ticket.withdraw(path)
    assert path.read_text() == "notes of mine"


@pytest.mark.parametrize(
    "host",
    ["0.0.0.0", "0", "0x0", "0.0", "00.0x0.0", "000.000.000.000", "::", "[::]", "0::0", "::ffff:0.0.0.0", "", "*"],
)
def test_every_spelling_of_every_interface_is_refused(host: str) -> None:
    with pytest.raises(ValueError, match=r"interface|not an address"):
        listening_address(host)


@pytest.mark.parametrize(
    ("host", "means", "said"),
    [
        ("lab-pc", ["::1", "127.0.1.1"], r"'lab-pc' is 127\.0\.1\.1 here, which no other machine reaches"),
        ("lab-pc", ["127.0.1.1", "::1", "fe80::7", "192.168.1.7", "fd00::7"], "192.168.1.7"),
        ("lab-pc", ["fd00::7", "::1"], "fd00::7"),
        ("localhost", ["::1", "127.0.0.1"], "127.0.0.1"),
        ("ip6-loopback", ["::1"], "::1"),
        ("fe80::7%eth0", ["fe80::7"], "holds for one cable alone"),
    ],
)
def test_a_name_stands_for_what_another_machine_can_call(
    host: str, means: list[str], said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Debian's /etc/hosts calls the machine itself 127.0.1.1; systemd knows a name for all its addresses."""
    monkeypatch.setattr(socket, "getaddrinfo", lambda *asked, **how: [(0, 0, 0, "", (one, 0)) for one in means])
    if said in means:
        assert listening_address(host) == said
    else:
        with pytest.raises(ValueError, match=said):
            listening_address(host)


def test_one_address_is_bound_and_no_other(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5", 10)
    for host in ("127.0.0.1", "localhost", "0x7f000001", "127.1"):
        server = SampleServer(run, host)
        assert server.ticket.address.startswith(("tcp://127.0.0.1:", "tcp://[::1]:"))
        with pytest.raises(AddressTaken):
            SampleServer(run, host, int(server.ticket.address.rsplit(":", 1)[1]))
        server.close()
