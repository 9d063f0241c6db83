"""Which rows of a recording are served: all that are intact, in their order, whatever becomes of the file meanwhile."""

import os
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.recording.condition import RowState
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.served import server as server_module
from nlos.acquisition.served.far_copy import FarCopy
from nlos.acquisition.served.messages import Block, encode_block
from nlos.acquisition.served.served_copy import copy_served
from tests.acquisition.serving import serving
from tests.acquisition.test_network import plan, same, sample, write


def soon() -> Callable[[], bool]:
    """Whether a copy that does not end has gone on for long enough."""
    until_s = time.monotonic() + 60
    return lambda: time.monotonic() > until_s


def numbers(path: Path) -> list[int]:
    with Recording.open(path) as recording:
        return [each.point.number for each in recording.samples()]


def test_a_row_that_is_on_its_way_to_the_disk_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A flush that the server meets halfway: the row counts already, and is not what was measured yet."""
    run, judged, looks = tmp_path / "run.h5", Recording.state_of, list[int]()
    writer = RecordingWriter.create(run, plan(), Header())
    for number in range(10):
        writer.write(sample(number))
    writer.flush()

    def on_its_way(recording: Recording, row: int) -> RowState:
        if recording.path != run or row != 5 or len(looks) == 3:
            return judged(recording, row)
        looks.append(row)
        if len(looks) == 3:
            writer.finish(Status.INTERRUPTED)
        return RowState.UNACKNOWLEDGED

    monkeypatch.setattr(Recording, "state_of", on_its_way)
    with serving(run) as server:
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20, stopped=soon()) == 10
    monkeypatch.undo()
    assert numbers(tmp_path / "far.h5") == list(range(10))


def test_a_row_that_never_came_to_the_disk_is_waited_for_no_longer_than_the_scan(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, judged = write(tmp_path / "run.h5", 10), Recording.state_of
    never = {5: RowState.UNACKNOWLEDGED, 7: RowState.DAMAGED}
    monkeypatch.setattr(
        Recording, "state_of", lambda it, row: never.get(row) or judged(it, row) if it.path == run else judged(it, row)
    )
    with serving(run) as server:
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20, stopped=soon()) == 8
    monkeypatch.undo()
    assert numbers(tmp_path / "far.h5") == [0, 1, 2, 3, 4, 6, 8, 9]


def test_a_file_put_in_the_place_of_the_served_one_is_served_from_its_first_row(tmp_path: Path) -> None:
    run = write(tmp_path / "run.h5", 10)
    with serving(run) as server:
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20) == 10
        shutil.copy(run, tmp_path / "fresh.h5")
        os.replace(tmp_path / "fresh.h5", run)
        assert copy_served(server.ticket, tmp_path / "again.h5", patience_s=20) == 10
    assert same(run, tmp_path / "again.h5")


def test_no_answer_is_larger_than_it_may_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []

    def noted(number: int, block: Block) -> list[bytes]:
        sent.append(block.counts.nbytes)
        return encode_block(number, block)

    run, most = write(tmp_path / "run.h5", 10), 3 * 64 * 4
    monkeypatch.setattr(server_module, "encode_block", noted)
    monkeypatch.setattr(server_module, "MAX_BLOCK_BYTES", most + 1)
    with serving(run) as server:
        assert copy_served(server.ticket, tmp_path / "far.h5", patience_s=20) == 10
    assert max(sent) == most
    assert same(run, tmp_path / "far.h5")


@pytest.mark.parametrize("change", [{"run": "another"}, {"first": 1}])
def test_rows_that_were_not_asked_for_are_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any]
) -> None:
    run = write(tmp_path / "run.h5", 10)
    monkeypatch.setattr(server_module, "encode_block", lambda number, it: encode_block(number, replace(it, **change)))
    with serving(run) as server, pytest.raises(InvalidData, match="asked for sample 0 of "):
        copy_served(server.ticket, tmp_path / "far.h5", patience_s=20)
    assert numbers(tmp_path / "far.h5") == []


def test_who_asks_for_another_recording_than_is_served_gets_none_of_it_and_is_told(tmp_path: Path) -> None:
    run, far, ticket = write(tmp_path / "run.h5", 10), tmp_path / "far.h5", tmp_path / "run.ticket"
    with serving(run) as server:
        other = replace(server.ticket, recording="another")
        with pytest.raises(InvalidData, match="another recording than the ticket is for"):
            copy_served(other, far, patience_s=20)
        other.save(ticket)
        with pytest.raises(InvalidData, match=r"run\.ticket: .*another recording than the ticket is for"):
            FarCopy(ticket, far, patience_s=20)
    assert not far.exists()


def test_a_copy_takes_the_place_of_no_file_that_is_none_and_one_that_is_whole_needs_no_more(tmp_path: Path) -> None:
    run, far, ticket = write(tmp_path / "run.h5", 10), tmp_path / "far.h5", tmp_path / "run.ticket"
    far.write_bytes(b"mine")
    with serving(run) as server:
        server.ticket.save(ticket)
        for _ in range(2):
            with FarCopy(ticket, far, patience_s=20) as copy:
                copy.check()
                copy.close()
            assert same(run, far)
    kept = [path for path in tmp_path.iterdir() if path.name.startswith("far") and path != far]
    assert [path.read_bytes() for path in kept if path.stat().st_size] == [b"mine"]
