"""The last picture of a scan comes as soon as it can: nothing that is thrown away, or may come later, is before it."""

import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.transient import Transient
from nlos.chain import calibrate_scan
from nlos.live.gathered import nothing_yet
from nlos.live.overtaken import Overtaken, given_up_once
from nlos.live.scan import LiveScan
from nlos.live.schedule import Schedule
from nlos.loaded import load_scan
from nlos.recon.live import LivePicture, LiveReconstruction
from nlos.recon.reconstruct import reconstruct
from nlos.response import AUTO

SCAN = """\
wall: {width_m: 1.0, height_m: 1.0, rows: 16, cols: 16}
pattern: {kind: coarse_to_fine, batch: 8}
dwell_ms: 20
histogram: {bins: 512, bin_width_ps: 32, offset_ns: 10}
"""
SLOW = '''\
"""A minute a picture, as long as points are missing."""

import time

import torch
from torch import nn

from nlos.configs.settings import Settings as AnySettings
from nlos.recon.method import MethodResult
from nlos.recon.parts import counted


class Settings(AnySettings):
    """Nothing to set."""


class Slow(nn.Module):
    def forward(self, counts, exposure_s=None):
        for _ in counted(range(6000), 6000, "rounds"):
            if (exposure_s > 0).all():
                break
            time.sleep(0.01)
        brightest = counts[:, 0].amax(dim=1).clamp(min=0)
        return MethodResult(brightest, torch.full_like(brightest, torch.nan))


def build(settings, wall, time):
    return Slow()
'''


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("scanned")
    (folder / "scan.yaml").write_text(SCAN)
    command = [sys.executable, "-m", "nlos", "scan", "scan.yaml", "-o", "run.h5", "-q"]
    subprocess.run(command, cwd=folder, check=True, timeout=300, stdout=subprocess.DEVNULL)
    return folder / "run.h5"


def test_a_picture_in_passing_is_given_up_once_the_scan_has_ended(run: Path, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(SLOW)
    pictures: list[LivePicture] = []
    grows = tmp_path / "grows.h5"
    watched = LiveScan(grows, [LiveReconstruction(str(tmp_path / "slow.py"))], on_picture=pictures.append)
    with Recording.open(run) as recording:
        writer = RecordingWriter.create(grows, recording.plan, recording.header)
        samples = list(recording.samples())
        for sample in samples[:128]:
            writer.write(sample)
        writer.flush()
        watched.start()
        deadline_s = time.monotonic() + 240
        while not (watched.coming and watched.coming.making) and time.monotonic() < deadline_s:
            time.sleep(0.01)
        for sample in samples[128:]:
            writer.write(sample)
        writer.finish(Status.COMPLETE)
    waiter = threading.Thread(target=watched.wait, daemon=True)
    waiter.start()
    waiter.join(45)
    watched.stop(5)
    assert [picture.samples for picture in pictures] == [256]
    assert watched.over


def test_how_much_light_a_picture_explains_is_told_after_the_picture(run: Path) -> None:
    came: list[tuple[str, LivePicture]] = []
    watched = LiveScan(
        run, [LiveReconstruction("lct")], on_picture=lambda picture: came.append(("picture", picture)),
        on_explained=lambda picture: came.append(("explained", picture)),
    )  # fmt: skip
    watched.start()
    watched.wait()
    (first, picture), (second, explained) = came
    assert (first, second) == ("picture", "explained")
    assert picture.reconstruction.explained is None
    np.testing.assert_array_equal(picture.reconstruction.albedo, explained.reconstruction.albedo)
    batch = reconstruct(calibrate_scan(load_scan(run)), "lct").explained
    assert batch is not None
    assert explained.reconstruction.explained is not None
    assert explained.reconstruction.explained.share == pytest.approx(batch.share, abs=1e-6)
    assert watched.latest["lct"] is explained


def test_what_the_last_picture_needs_is_built_while_too_little_is_left_for_another() -> None:
    schedule = Schedule(["nano"], 0.05)
    now_s = time.monotonic()
    for sample in range(100):
        schedule.pace.saw(now_s - 1 + sample / 100)  # a hundred in the last second
    assert not schedule.ending(100, 400, True)  # before the first picture, which nothing is known of
    schedule.made("nano", 20, 400, 2.0, True)
    assert not schedule.ending(20, 400, True)  # 3.8 s: there is time for another
    assert schedule.ending(150, 400, True)
    assert schedule.due(150, 400, True, False) is None
    assert not schedule.ending(360, 400, True)  # 0.4 s: it would only keep the last one waiting
    assert not schedule.ending(150, 400, False)  # a finished recording


def test_samples_so_far_are_made_ready_as_the_whole_scan_will_be(run: Path) -> None:
    with Recording.open(run) as recording:
        held = nothing_yet(recording, None, AUTO, True, print)
        for sample in recording.samples():
            held.add(sample)
        ready, falloff = held.as_last()
    whole, last = held.calibrated(True), held.calibrated(True).transient
    assert (ready.wall, ready.time, falloff) == (last.wall, last.time, whole.falloff)
    np.testing.assert_array_equal(ready.counts, last.counts)


def test_what_was_built_before_the_last_picture_is_what_makes_it(run: Path, tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(SLOW.replace("    return Slow()", f"""\
    from pathlib import Path
    with Path({str(tmp_path / "built")!r}).open("a") as file:
        file.write("once more ")
    return Slow()"""))  # fmt: skip
    live, transient = LiveReconstruction(str(tmp_path / "own.py")), calibrate_scan(load_scan(run))
    live.get_ready(transient)
    assert (tmp_path / "built").read_text() == "once more "
    live.update(transient, 256)
    assert (tmp_path / "built").read_text() == "once more "


def test_how_long_a_picture_takes_is_without_what_comes_after_it(run: Path) -> None:
    begun: list[float] = []
    slow = LiveScan(run, [LiveReconstruction("lct")])
    slow.on_picture = lambda picture: begun.append(slow._schedule.pace.picture_s("lct"))
    slow.on_explained = lambda picture: begun.append(slow._schedule.pace.picture_s("lct"))
    slow.start()
    slow.wait()
    assert begun[0] == 0.0  # shown first
    assert begun[1] > 0.0  # known before it is explained


def test_what_has_no_rounds_is_given_up_when_it_is_done() -> None:
    over = False
    with pytest.raises(Overtaken), given_up_once(lambda: over):
        over = True
    with pytest.raises(Overtaken), given_up_once(lambda: over):
        pytest.fail("begun though the scan has ended")


def test_what_is_given_up_leaves_nothing_behind_in_the_next_picture(run: Path) -> None:
    transient = calibrate_scan(load_scan(run))
    whole = reconstruct(transient, "nano", explain=False)
    rounds = 0

    def after_two() -> bool:
        nonlocal rounds
        rounds += 1
        return rounds > 2

    with pytest.raises(Overtaken), given_up_once(after_two):
        reconstruct(transient, "nano", explain=False)
    assert rounds == 3
    np.testing.assert_array_equal(reconstruct(transient, "nano", explain=False).albedo, whole.albedo)


def test_what_an_earlier_picture_was_sure_of_stays_so(run: Path) -> None:
    scan = calibrate_scan(load_scan(run))
    kept = np.zeros((16, 16), dtype=np.float32)
    kept[::4, ::4] = 1
    few = Transient(scan.counts * kept, scan.exposure_s * kept, scan.wall, scan.time, scan.response)
    live = LiveReconstruction("nano")
    first, own = live.update(scan, 200).bound, LiveReconstruction("nano").update(few, 256).bound
    assert first is not None
    assert own is not None
    assert own > first  # by itself this picture is less sure
    assert live.update(few, 256).bound == first
