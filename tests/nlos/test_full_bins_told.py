"""A recording whose counter could count no further says so to every verb that reads it, and no picture comes of it."""

import json
import shutil
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.scanning.engine import record, scan
from nlos.calibration.errors import SaturatedBins
from nlos.calibration.raw_points import from_transient
from nlos.configs.load import load
from nlos.drivers.bench import BenchSettings, open_bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.bench import Exposure, Gate
from nlos.loaded import load_scan
from tests.command import nlos

FULL, PLACE = 0xFFFF, 3
"""Of a 16-bit counter; and the wall point whose direct light is too bright."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames of 3 x 3 points, whose sum is twice as much as the bin holds; nobody set an alarm."""
    bench = load("bench", "zero_latency", BenchSettings).settings
    bench = bench.model_copy(update={"counter": bench.counter.model_copy(update={"counts": "u16"})})
    wall = {"width_m": 1.0, "height_m": 1.0, "rows": 3, "cols": 3}
    axis = {"bins": 128, "bin_width_ps": 64, "offset_ns": 10}
    plan = ScanSettings.model_validate(
        {"wall": wall, "pattern": "raster", "dwell_ms": 1000, "histogram": axis, "frames": 2}
    ).plan()

    def light(gate: Gate, beam: MirrorAngles, is_open: bool) -> Exposure:
        seen = np.zeros(gate.bins, np.uint32)
        if is_open:
            seen[60:] = 3
            seen[50] = 70_000 if gate.number is not None and gate.number % 9 == PLACE and gate.number < 9 else 9_000
        return Exposure(seen, gate.dwell_s, round(gate.dwell_s * 10e6), int(seen.sum()), False)

    path = tmp_path_factory.mktemp("full") / "full.h5"
    with open_bench(bench) as opened:
        assert opened.simulated is not None
        opened.simulated.light = light
        devices = {"mirror": opened.mirror.identity, "counter": opened.counter.identity}
        with RecordingWriter.create(path, plan, Header(devices=devices)) as writer:
            record(scan(plan, opened), writer)
    return path


def test_the_file_holds_what_a_stranger_finds_full(run: Path) -> None:
    with h5py.File(run) as file:
        records, counts = file["samples/records"][:], file["samples/counts"][:]
    row = int(np.flatnonzero(records["number"] == PLACE)[0])
    assert records["flags"][row] & 1
    assert counts[row].max() == FULL
    assert (records["flags"] & 1).sum() == 1


@pytest.mark.parametrize(
    "words",
    [["replay", "--speed", "max"], ["export", "--to", "npz"]],
    ids=lambda words: words[0],
)
def test_every_reader_is_told(run: Path, tmp_path: Path, words: list[str]) -> None:
    """What was measured is handed on as it is: that is no fault of the file."""
    shutil.copy(run, tmp_path / "full.h5")
    done = nlos(tmp_path, words[0], "full.h5", *words[1:])
    assert done.returncode == 0, done.stderr
    assert "1 of 18 samples hold a bin that was full (rows 3)" in done.stderr


def test_verify_and_info_give_the_number_to_programs(run: Path, tmp_path: Path) -> None:
    shutil.copy(run, tmp_path / "full.h5")
    done = nlos(tmp_path, "--json", "verify", "full.h5")
    assert (done.returncode, json.loads(done.stdout)["full"]) == (0, [3])
    assert "1 of 18 samples hold a bin that was full (rows 3)" in done.stderr
    assert json.loads(nlos(tmp_path, "--json", "info", "full.h5").stdout)["with a full bin"] == 1


def test_no_picture_comes_of_frames_added_up_beyond_what_a_bin_holds(run: Path, tmp_path: Path) -> None:
    """By the sum nobody sees it: 65,535 and 9,000 are no counter's limit."""
    shutil.copy(run, tmp_path / "full.h5")
    for words in (["reconstruct", "full.h5", "--method", "lct", "-o", "out"], ["calibrate", "full.h5"]):
        done = nlos(tmp_path, *words)
        assert done.returncode == 7
        assert "point 3 at (-0.333 m, +0.000 m): its counter says that a bin is saturated" in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_frame_without_full_bins_is_as_good_as_ever(run: Path) -> None:
    assert [len(load_scan(run, frames=range(frame, frame + 1)).full) for frame in range(2)] == [1, 0]


def test_a_bin_of_32_bits_is_full_in_single_precision_too(run: Path, tmp_path: Path) -> None:
    """4,294,967,295 is 4,294,967,296 there. The row is written by hand as the page on the format says."""
    path = shutil.copy(run, tmp_path / "wide.h5")
    with h5py.File(path, "r+") as file:
        records, counts = file["samples/records"][:], file["samples/counts"][:]
        records["flags"][3], counts[3, 50] = 0, 2**32 - 1
        records["crc"][3] = zlib.crc32(counts[3].tobytes(), zlib.crc32(records[3:4].tobytes()[:47]))
        file["samples/records"][...], file["samples/counts"][...] = records, counts
    scan_ = load_scan(path, frames=range(1))
    assert not scan_.full
    with pytest.raises(SaturatedBins, match=r"point 3 .* the most that the counter can"):
        from_transient(scan_.transient).check()
