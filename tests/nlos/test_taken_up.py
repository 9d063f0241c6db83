"""A scan that is resumed after a viewer saw its end is followed anew: the page says nothing of before."""

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.salvage import resume
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.live.page import LivePage
from nlos.live.scan import LiveScan
from nlos.live.taken_up import TakenUp
from nlos.live.web import Request
from nlos.recon.live import LiveReconstruction

PATIENCE_S = 60.0


def test_light_that_a_resumed_scan_lets_on_is_on_the_page_that_saw_its_end(
    small: Path, nlos: Callable[..., Any], tmp_path: Path
) -> None:
    assert nlos("scan", small.name, "-o", "whole.h5").returncode == 0
    path = tmp_path / "run.h5"
    with Recording.open(tmp_path / "whole.h5") as whole:
        samples, plan, header = list(whole.samples()), whole.plan, whole.header
    writer = RecordingWriter.create(path, plan, header)
    writer.log("shutter", "opened")
    for sample in samples[:8]:
        writer.write(sample)
    writer.log("shutter", "closed")
    writer.finish(Status.INTERRUPTED)

    scans = [LiveScan(path, [LiveReconstruction("lct")])]
    page = LivePage(scans, "token", {"host"})
    taken_up = TakenUp(scans, page, PATIENCE_S)

    def state_once(expected: dict[str, object]) -> None:
        until_s = time.monotonic() + PATIENCE_S
        said: dict[str, object] = {}
        while {name: said.get(name) for name in expected} != expected:
            assert time.monotonic() < until_s, said
            taken_up.look()
            said = json.loads(page(Request("/token/state", {}, "host")).body)["scans"][0]
            time.sleep(0.02)

    scans[0].start()
    try:
        ended = {"status": "interrupted", "light": "off", "over": True, "samples": 8}
        state_once({**ended, "taken_up": 0})
        again = resume(path, plan, header).writer
        assert again is not None
        again.log("shutter", "opened")
        for sample in samples[8:12]:
            again.write(sample)
        again.flush()
        state_once({"status": "running", "light": "on", "over": False, "samples": 12, "lost": False})
        again.log("shutter", "closed")
        again.finish(Status.INTERRUPTED)
        state_once({**ended, "samples": 12})
    finally:
        page.stop(PATIENCE_S)
        for scan in scans:
            scan.stop(PATIENCE_S)
