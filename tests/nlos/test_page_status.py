"""What the live page says of a scan under way: running, paused or lost, and whether its laser is on."""

from pathlib import Path

import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.live.answers import ScanAnswers
from nlos.live.file_seen import Seen
from nlos.live.gathered import nothing_yet
from nlos.live.scan import LiveScan
from nlos.recon.live import LiveReconstruction
from nlos.response import AUTO
from tests.scan_texts import THREE_BY_FOUR, recorded


@pytest.mark.parametrize(
    ("said", "status", "light"),
    [
        ([("scan", "paused by a person"), ("scan", "resumed"), ("shutter", "opened")], "running", "on"),
        ([("shutter", "opened"), ("scan", "paused by a person")], "paused", "on"),
        ([("shutter", "opened"), ("scan", "resumed")], "lost", "maybe"),
        ([("shutter", "opened"), ("shutter", "closed"), ("scan", "paused by a person")], "lost", "off"),
    ],
)
def test_the_page_says_how_a_scan_under_way_stands_and_its_light(
    tmp_path: Path, said: list[tuple[str, str]], status: str, light: str
) -> None:
    """Paused, and going on again; lost, whatever its last words were."""
    with Recording.open(recorded(tmp_path, THREE_BY_FOUR)) as recording:
        plan, header = recording.plan, recording.header
    with RecordingWriter.create(tmp_path / "growing.h5", plan, header) as writer:
        for kind, text in said:
            writer.log(kind, text)
        writer.flush()
        watched = LiveScan(tmp_path / "growing.h5", [LiveReconstruction("lct")])
        watched.error = StorageError("its writer is gone") if status == "lost" else None
        with Recording.open(watched.run) as growing:
            watched.gathered = nothing_yet(growing, None, AUTO, False, print)
            watched.seen = Seen.of(growing)
        state = ScanAnswers(watched).state()
    assert (state["status"], state["light"], state["lost"]) == (status, light, status == "lost")
