"""A scan followed while it is written ends in the picture of the finished recording, wherever it is followed from."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.recording.recording import Recording, Status
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.gathering import Gathering
from nlos.acquisition.wall import WallGrid
from nlos.live.following import replace_pictures
from nlos.recon.live import LivePicture
from nlos.recon.volume import Intervals, Reconstruction
from tests.scan_texts import COARSE_TO_FINE, recorded

Nlos = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return recorded(tmp_path, COARSE_TO_FINE)


def albedo(folder: Path) -> np.ndarray:
    with h5py.File(folder / "reconstruction.h5") as file:
        return np.asarray(file["albedo"])


def test_samples_in_any_order_add_up_to_the_same_transient(run: Path) -> None:
    with Recording.open(run) as recording:
        whole, samples = recording.transient(), list(recording.samples())
        plan = recording.plan
    gathering = Gathering(plan)
    for index in np.random.default_rng(1).permutation(len(samples)):
        gathering.add(samples[index])
        gathering.add(samples[index])  # a second copy changes nothing
    assert len(gathering) == len(samples)
    assert np.array_equal(gathering.transient().counts, whole.counts)
    assert np.array_equal(gathering.transient().exposure_s, whole.exposure_s)


def test_following_a_shuffled_growing_file_ends_in_the_batch_result(nlos: Nlos, run: Path, tmp_path: Path) -> None:
    assert nlos("reconstruct", "run.h5", "-o", "batch").returncode == 0
    with Recording.open(run) as recording:
        samples, plan, header = list(recording.samples()), recording.plan, recording.header
    writer = RecordingWriter.create(tmp_path / "grows.h5", plan, header)
    follower = subprocess.Popen(
        [sys.executable, "-m", "nlos", "reconstruct", "grows.h5", "--follow", "-o", "live", "--json"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    for count, index in enumerate(np.random.default_rng(2).permutation(len(samples))):
        writer.write(samples[index])
        if count % 64 == 63:
            writer.flush()
            time.sleep(0.3)
    writer.finish(Status.COMPLETE)
    out, err = follower.communicate(timeout=240)
    assert follower.returncode == 0, err
    assert '"points": 256' in out
    expected = albedo(tmp_path / "batch")
    assert np.abs(albedo(tmp_path / "live") - expected).max() <= 1e-5 * expected.max()
    left = {path.name for path in (tmp_path / "live").iterdir()}
    assert {"albedo.png", "depth.png", "reconstruction.h5"} <= left
    assert not [name for name in left if name.startswith(".")]


def test_what_is_followed_by_a_method_that_knows_how_sure_it_is_has_its_picture(tmp_path: Path) -> None:
    ones = np.ones((8, 8), np.float32)
    sure = Intervals(0.5 * ones, 1.5 * ones, 0.9 * ones, 1.1 * ones, ones)
    made = Reconstruction(ones, ones, WallGrid(1.0, 1.0, 8, 8), "nano", 0.0, {}, None, intervals=sure)
    replace_pictures(tmp_path, LivePicture(made, 64, 0.1, 0.1, confidence=ones), False)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        ("albedo.png", "depth.png", "confidence.png", "uncertainty.png")
    )


def test_what_is_served_is_followed_by_its_ticket(nlos: Nlos, run: Path, tmp_path: Path) -> None:
    server = subprocess.Popen(
        [sys.executable, "-m", "nlos", "serve", "run.h5", "--idle-s", "600"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    said = server.stdout.readline()
    assert "tcp://127.0.0.1:" in said
    for words in (["--host", "0.0.0.0"], ["--port", said.strip().rsplit(":", 1)[1]]):  # no address to go to; taken
        assert nlos("serve", "run.h5", *words).returncode == 2
    assert os.stat(tmp_path / "run.ticket").st_mode & 0o077 == 0
    done = nlos("reconstruct", "run.ticket", "--follow", "-o", "far")
    server.send_signal(signal.SIGTERM)
    assert server.wait(240) == 143
    assert done.returncode == 0, done.stderr
    with Recording.open(tmp_path / "far" / "run.h5") as far, Recording.open(run) as near:
        assert np.array_equal(far.records, near.records)
    assert not (tmp_path / "run.ticket").exists()
    assert nlos("reconstruct", "run.h5", "-o", "batch").returncode == 0
    assert np.allclose(albedo(tmp_path / "far"), albedo(tmp_path / "batch"), rtol=0, atol=1e-5)
