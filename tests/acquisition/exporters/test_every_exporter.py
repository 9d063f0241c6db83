"""What is exported comes back: the same counts, walls and time axes, wherever the format has room for them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import ptufile
import pytest

from nlos.acquisition.errors import InvalidData
from nlos.acquisition.exporters.matlab import write_matlab
from nlos.acquisition.exporters.npz import write_npz
from nlos.acquisition.exporters.ptu import write_ptu
from nlos.acquisition.exporters.scan_arrays import ScanArrays, arrays_of_import, arrays_of_recording
from nlos.acquisition.exporters.ytal import write_ytal
from nlos.acquisition.importers.formats import read_any
from nlos.acquisition.importers.to_recording import write_recording
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.positions import free, pixels
from nlos.acquisition.recording.provenance import Header
from nlos.acquisition.recording.recording import Recording
from nlos.acquisition.recording.writer import RecordingWriter
from nlos.acquisition.response import gaussian
from nlos.acquisition.sample import Sample
from nlos.acquisition.scanning.free_points import FreePoints
from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag

Writer = Callable[[ScanArrays, Path], list[str]]
WRITERS: dict[str, Writer] = {".npz": write_npz, ".mat": write_matlab, ".hdf5": write_ytal, ".ptu": write_ptu}
WALL = WallGrid(1.2, 0.9, 4, 3)


def scan(even: bool = True) -> ScanArrays:
    rng = np.random.default_rng(3)
    counts = rng.poisson(2.0, (4, 3, 100)).astype(np.uint32)
    exposure = np.full((4, 3), 0.01) if even else rng.uniform(0.01, 0.02, (4, 3))
    return ScanArrays(counts, exposure, WALL.x_m(), WALL.y_m(), WALL, TimeAxis(100, 32e-12, 1e-9))


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("even", [True, False])
def test_counts_and_time_axis_come_back(suffix: str, even: bool, tmp_path: Path) -> None:
    path = tmp_path / f"scan{suffix}"
    left_behind = WRITERS[suffix](scan(even), path)
    back = read_any(path).transient
    before = 31 if suffix == ".ptu" else 0  # whose delays count from time 0
    assert np.array_equal(np.moveaxis(back.counts[before:], 0, 2), scan(even).histograms)
    assert not back.counts[:before].any()
    assert back.time.bin_width_s == pytest.approx(32e-12, rel=1e-9)
    if suffix in (".npz", ".mat"):
        assert back.wall.width_m == pytest.approx(1.2)
        assert back.time.start_s == 1e-9
        assert np.array_equal(back.exposure_s, scan(even).exposure_s)
    else:
        assert left_behind


@pytest.mark.parametrize("shape", [(1, 3), (4, 1)])
@pytest.mark.parametrize("suffix", WRITERS)
def test_a_line_of_points_comes_back_or_is_refused(suffix: str, shape: tuple[int, int], tmp_path: Path) -> None:
    rows, cols = shape
    wall = WallGrid(0.4 * cols, 0.225 * rows, rows, cols)
    line = replace(scan(), histograms=scan().histograms[:rows, :cols], exposure_s=scan().exposure_s[:rows, :cols],
                   x_m=wall.x_m(), y_m=wall.y_m(), wall=wall)  # fmt: skip
    path = tmp_path / f"line{suffix}"
    if suffix == ".hdf5":
        with pytest.raises(InvalidData, match="2 x 2 points at least"):
            WRITERS[suffix](line, path)
        assert not path.exists()
        return
    WRITERS[suffix](line, path)
    back = read_any(path).transient
    assert np.array_equal(np.moveaxis(back.counts[-100:], 0, 2), line.histograms)


@pytest.mark.parametrize("suffix", WRITERS)
def test_facts_that_a_format_has_no_place_for_are_named(suffix: str, tmp_path: Path) -> None:
    plain = replace(scan(), rectified=True)
    told = WRITERS[suffix](plain, tmp_path / f"plain{suffix}")
    said = replace(plain, direct_cut_bins=12, falloff=2, response=gaussian(150e-12, "a Gaussian"))
    more = " / ".join(note for note in WRITERS[suffix](said, tmp_path / f"said{suffix}") if note not in told)
    assert ("the first 12 bins hold direct light" in more) == (suffix in (".hdf5", ".ptu"))
    assert ("--response 150" in more) == (suffix in (".hdf5", ".ptu"))
    assert ("--set falloff=2" in more) == (suffix == ".ptu")
    timed = replace(scan(), time_offset_bins=np.full((4, 3), 5.0))
    more = " / ".join(WRITERS[suffix](timed, tmp_path / f"timed{suffix}"))
    assert ("time_offset_bins" in more) == (suffix in (".hdf5", ".ptu"))


@pytest.mark.parametrize("rectified", [True, False])
@pytest.mark.parametrize("suffix", [".npz", ".mat", ".hdf5"])
def test_free_positions_come_back_in_their_order(suffix: str, rectified: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    counts, (x_m, y_m) = rng.poisson(2.0, (9, 100)).astype(np.uint32), rng.uniform(-0.4, 0.4, (2, 9))
    exposure_s = rng.integers(1, 9, 9) * 1e-3
    free_scan = ScanArrays(counts, exposure_s, x_m, y_m, WALL, TimeAxis(100, 32e-12, 2e-9), rectified=rectified)
    for again in ("first", "second"):
        path = tmp_path / f"{again}{suffix}"
        WRITERS[suffix](free_scan, path)
        back = read_any(path)
        assert back.points is not None
        assert back.rectified == rectified
        assert back.points.time.start_s == pytest.approx(2e-9)
        assert (back.points.wall.width_m, back.points.wall.height_m) == (1.2, 0.9)
        write_recording(back, path, tmp_path / f"{again}.h5")
        with Recording.open(tmp_path / f"{again}.h5") as recording:
            free_scan = arrays_of_recording(recording)
        assert np.array_equal(free_scan.histograms, counts)
        assert np.array_equal(free_scan.x_m, x_m)
        assert np.array_equal(free_scan.y_m, y_m)
        assert free_scan.exposure_s == pytest.approx(exposure_s)


@pytest.mark.parametrize("suffix", [".ptu"])
def test_free_positions_are_refused_where_the_format_has_no_place(suffix: str, tmp_path: Path) -> None:
    free = ScanArrays(
        np.ones((5, 100), np.uint32), np.ones(5), np.arange(5.0), np.arange(5.0), WALL, TimeAxis(100, 32e-12)
    )
    with pytest.raises(InvalidData, match="npz"):
        WRITERS[suffix](free, tmp_path / f"free{suffix}")
    assert not (tmp_path / f"free{suffix}").exists()


@pytest.mark.parametrize("even", [True, False])
def test_a_ptu_has_the_tags_that_other_readers_want(even: bool, tmp_path: Path) -> None:
    """phconvert reads no file without the first two, which the vendor's dictionary calls optional."""
    left_behind = write_ptu(scan(even), tmp_path / "scan.ptu")
    assert any("delays are whole bins: times are 8 ps off" in note for note in left_behind)
    with ptufile.PtuFile(tmp_path / "scan.ptu") as file:
        tags = file.tags
    assert tags["MeasDesc_AcquisitionTime"] == round(float(scan(even).exposure_s.sum()) * 1e3)
    assert tags["HW_Type"] == "MultiHarp"
    assert tags["CreatorSW_Name"] == "nlos"
    assert tags["TTResultFormat_TTTRRecType"] == 0x00010307
    for name in ("File_CreatingTime", "CreatorSW_Version", "TTResult_SyncRate", "MeasDesc_Resolution"):
        assert name in tags


@pytest.mark.parametrize("suffix", [".npz", ".mat", ".hdf5"])
def test_counts_that_floats_of_32_bits_would_round_stay_as_they_are(suffix: str, tmp_path: Path) -> None:
    counts = scan().histograms + np.uint32(1 << 24)
    counts[1, 2, 3] = (1 << 32) - 1
    path = tmp_path / f"scan{suffix}"
    WRITERS[suffix](replace(scan(), histograms=counts), path)
    back = read_any(path)
    assert np.array_equal(np.moveaxis(back.transient.counts, 0, 2), counts)
    assert np.array_equal(arrays_of_import(back, path).histograms, counts)
    write_recording(back, path, tmp_path / "run.h5")
    with Recording.open(tmp_path / "run.h5") as recording:
        assert np.array_equal(arrays_of_recording(recording).histograms, counts)
    more = replace(back, held=replace(back.transient, counts=back.transient.counts + 1))
    assert arrays_of_import(more, path).histograms[1, 2, 3] == 1 << 32
    with pytest.raises(InvalidData, match="4294967296 counts in one bin are more than the 32 bits of a recording hold"):
        write_recording(more, path, tmp_path / "more.h5")


@pytest.mark.parametrize("on_grid", [True, False])
def test_sums_of_more_than_32_bits_are_exported_as_they_are(on_grid: bool, tmp_path: Path) -> None:
    """Two visits of each of two places; one of their bins holds more than a 32-bit counter could."""
    wall, axis = WallGrid(1.0, 1.0, 1, 2), HistogramAxis(3, 32e-12, 0.0)
    places = pixels(wall, [0] * 4, [0, 1, 0, 1]) if on_grid else free([-0.2, 0.2] * 2, [0.1] * 4)
    plan = ScanPlan(wall, axis, places, np.ones(4), np.array([0, 0, 1, 1], dtype=np.int32))
    gathered = FreePoints(plan)
    with RecordingWriter.create(tmp_path / "run.h5", plan, Header().stamped()) as writer:
        for point in plan:
            counts = np.array([5, (3 << 30) + 1, 0] if point.number % 2 else [1, 2, 3], dtype=np.uint32)
            histogram = Histogram(counts, axis.bin_width_s, 0.0, 1.0, 10**7, int(counts.sum()), HistogramFlag.NONE, 0.0)
            writer.write(sample := Sample(point, histogram, float(point.number)))
            gathered.add(sample)
    with Recording.open(tmp_path / "run.h5") as recording:
        exported = arrays_of_recording(recording)
    assert exported.histograms.reshape(2, 3).tolist() == [[2, 4, 6], [10, (6 << 30) + 2, 0]]
    assert exported.laser_period_s == pytest.approx(100e-9)
    assert gathered.counts.tolist() == [[2, 4, 6], [10, (6 << 30) + 2, 0]]
