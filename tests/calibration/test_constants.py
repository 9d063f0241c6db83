import errno
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from nlos.acquisition.errors import StorageError
from nlos.acquisition.recording.shown_to_hdf5 import written_hdf5
from nlos.acquisition.response import measured
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.transient import TimeAxis
from nlos.calibration.arrivals import Arrivals
from nlos.calibration.checked import all_checked
from nlos.calibration.constants import BenchConstants, Quantity, load, load_response, save
from nlos.calibration.correct import correct_known, correct_points
from nlos.calibration.errors import ForeignConstants, InvalidData, PoorCalibration
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.known_arrivals import common_bins, known_arrival_bins
from nlos.calibration.one_sample import correct_sample
from nlos.calibration.raw_points import RawPoints
from nlos.drivers.tcspc.counter import Histogram, HistogramFlag
from tests.calibration.conftest import RawScan

TCSPC = Path(__file__).parents[3] / "shared" / "data" / "tcspc"
BENCH = {"mirror": "triggerscope T-1", "counter": "tcspc488 C-7"}


def points(scan: RawScan) -> RawPoints:
    count, bins = scan.counts.shape
    pulses, total = np.full(count, 88_000.0), scan.counts.sum(axis=1).astype(float)
    axis = TimeAxis(bins, scan.bin_width_s)
    return RawPoints(scan.counts, scan.x_m, scan.y_m, np.full(count, 8e-3), pulses, total, axis)


@pytest.fixture(scope="module")
def constants(raw_scan: RawScan) -> BenchConstants:
    done = correct_points(points(raw_scan))
    found = done.offsets
    assert found is not None
    assert found.wall is not None
    wall, width = found.wall, raw_scan.bin_width_s
    residual = (found.offset_bins - found.predicted_bins) * width
    return BenchConstants(
        devices=BENCH,
        measured_utc="2026-03-01T12:00:00+00:00",
        sources=("a.h5",),
        bin_width_s=width,
        arrivals=Arrivals(
            wall.scanner_position_m, wall.delay_s, wall.covariance, wall.rms_s, raw_scan.x_m, raw_scan.y_m, residual
        ),
        response=found.response,
        direct_shape=done.direct.shape,
        direct_end_bin=done.direct.end_bin,
        ambient_hz=Quantity(float(np.mean(done.background.per_bin)) / (88_000 * width), 1.0),
        geometry=ScannerGeometry(2.0, wall_yaw_rad=0.1),
    )


def test_what_is_saved_is_what_is_loaded(constants: BenchConstants, tmp_path: Path) -> None:
    full = replace(
        constants,
        dark_hz=Quantity(80.0, 2.0),
        dark_per_bin_hz=np.full(512, 0.1),
        dead_time_s=Quantity(77e-9, 1e-10),
        afterpulse_probability=Quantity(0.01, 0.001),
        afterpulse_decay_s=3e-8,
        geometry_errors={"wall_yaw_rad": 1e-4},
        bench="left table",
        bench_facts={"geometry.wall_distance_m": 2.0, "mirror.model": "triggerscope"},
    )
    save(full, tmp_path / "c.h5")
    again = load(tmp_path / "c.h5")
    assert again.arrivals is not None
    assert full.arrivals is not None
    assert np.array_equal(again.arrivals.at([0.1, 0.9375], [0, 0.0625]), full.arrivals.at([0.1, 0.9375], [0, 0.0625]))
    for name in ("devices", "measured_utc", "sources", "bin_width_s", "direct_end_bin", "dark_hz", "ambient_hz"):
        assert getattr(again, name) == getattr(full, name), name
    for name in (
        "dead_time_s",
        "afterpulse_probability",
        "afterpulse_decay_s",
        "geometry",
        "geometry_errors",
        "bench",
        "bench_facts",
    ):
        assert getattr(again, name) == getattr(full, name), name
    assert np.array_equal(again.response.density, full.response.density)  # type: ignore[union-attr]


def test_other_readers_find_the_offset_map_itself(constants: BenchConstants, raw_scan: RawScan, tmp_path: Path) -> None:
    save(constants, tmp_path / "c.h5")
    with h5py.File(tmp_path / "c.h5") as file:
        off = file["arrivals/arrival_s"][:] / raw_scan.bin_width_s - raw_scan.arrival_bins
    assert np.abs(off - off.mean()).max() < 0.5


def test_nothing_is_overwritten_unasked(constants: BenchConstants, tmp_path: Path) -> None:
    save(constants, tmp_path / "c.h5")
    before = (tmp_path / "c.h5").read_bytes()
    with pytest.raises(FileExistsError, match="--overwrite"):
        save(constants, tmp_path / "c.h5")
    assert (tmp_path / "c.h5").read_bytes() == before
    save(constants, tmp_path / "c.h5", overwrite=True)
    (tmp_path / "link.h5").symlink_to("c.h5")
    save(constants, tmp_path / "link.h5", overwrite=True)
    assert (tmp_path / "link.h5").is_symlink()


def test_constants_that_came_meanwhile_are_kept(
    constants: BenchConstants, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def others_come(path: Path) -> Iterator[h5py.File]:
        (tmp_path / "c.h5").write_text("another's")
        with written_hdf5(path) as file:
            yield file

    monkeypatch.setattr("nlos.calibration.constants.written_hdf5", others_come)
    with pytest.raises(FileExistsError, match=r"c\.h5: exists by now"):
        save(constants, tmp_path / "c.h5")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("c.h5", "another's")]


def test_a_full_disk_is_told_of_the_constants_and_leaves_the_old_ones(
    constants: BenchConstants, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It named a hidden file that was gone, and no remedy."""
    (tmp_path / "c.h5").write_text("old", encoding="utf-8")

    @contextmanager
    def full(path: Path) -> Iterator[h5py.File]:
        with h5py.File(path, "w") as file:
            yield file
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    monkeypatch.setattr("nlos.calibration.constants.written_hdf5", full)
    with pytest.raises(StorageError, match=r"c\.h5: cannot be written \(No space left.* Free disk space"):
        save(constants, tmp_path / "c.h5", overwrite=True)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("c.h5", "old")]


def test_a_scatter_over_one_bin_is_not_saved(constants: BenchConstants, tmp_path: Path) -> None:
    assert constants.arrivals is not None
    poor = replace(constants, arrivals=replace(constants.arrivals, rms_s=1.01 * constants.bin_width_s))
    with pytest.raises(PoorCalibration, match=r"32\.3 ps RMS .* more than one bin \(32\.0 ps\)"):
        save(poor, tmp_path / "c.h5")
    assert not list(tmp_path.iterdir())


def test_constants_of_another_model_are_refused_by_name(constants: BenchConstants) -> None:
    constants.refuse_other_models({"mirror": "triggerscope T-2"})
    with pytest.raises(ForeignConstants, match="for the counter tcspc488 C-7, the data come from picoquant C-8"):
        constants.refuse_other_models({"counter": "picoquant C-8"})


def test_the_newest_comes_first_and_what_cannot_be_read_not_at_all(constants: BenchConstants, tmp_path: Path) -> None:
    save(replace(constants, measured_utc="2026-03-03T00:00:00+00:00"), tmp_path / "a.h5")
    save(replace(constants, measured_utc="2026-03-09T00:00:00+02:00"), tmp_path / "b.h5")
    save(constants, tmp_path / "c.h5")
    (tmp_path / "d.h5").write_bytes(b"not HDF5")
    assert [path.name for path, _ in all_checked(tmp_path)] == ["b.h5", "a.h5", "c.h5"]


def test_a_time_without_a_zone_is_utc_and_a_nameless_one_is_passed_over(
    constants: BenchConstants, tmp_path: Path
) -> None:
    for name, utc in (("a", "2026-03-03T00:00:00"), ("b", "2026-03-03T01:00:00+00:00"), ("c", "some day")):
        save(replace(constants, measured_utc=utc), tmp_path / f"{name}.h5")
    (tmp_path / "folder.h5").mkdir()
    (tmp_path / "gone.h5").symlink_to(tmp_path / "nothing")
    assert [path.name for path, _ in all_checked(tmp_path)] == ["b.h5", "a.h5"]


@pytest.mark.parametrize("harm", ["truncated", "nan", "format", "shape"])
def test_a_damaged_file_is_refused_with_its_name(constants: BenchConstants, tmp_path: Path, harm: str) -> None:
    path = tmp_path / "c.h5"
    save(constants, path)
    if harm == "truncated":
        path.write_bytes(path.read_bytes()[:900])
    else:
        with h5py.File(path, "r+") as file:
            if harm == "nan":
                file["arrivals/residual_s"][3] = np.nan
            elif harm == "format":
                file.attrs["format"] = "else"
            else:
                del file["arrivals/covariance"]
                file["arrivals/covariance"] = np.zeros((3, 3))
    with pytest.raises(InvalidData, match=r"c\.h5"):
        load(path)


def test_a_stream_is_corrected_as_the_whole_scan_is(constants: BenchConstants, raw_scan: RawScan) -> None:
    raw = points(raw_scan)
    whole = correct_points(raw)
    bins = common_bins(constants, raw.x_m, raw.y_m, raw.time)
    batch = correct_known(raw, constants, bins)
    assert bins == whole.time.bins
    assert np.array_equal(batch.usable, whole.usable)
    off = (batch.counts - whole.counts)[whole.usable]
    assert np.abs(off).mean() < 0.03
    for row in (0, 77, 255):
        histogram = Histogram(
            raw_scan.counts[row],
            raw_scan.bin_width_s,
            0.0,
            8e-3,
            88_000,
            int(raw.total_count[row]),
            HistogramFlag.NONE,
            0,
        )
        point = ScanPoint(row, None, None, float(raw.x_m[row]), float(raw.y_m[row]), 8e-3)
        one = correct_sample(Sample(point, histogram, 0.0), constants, bins)
        assert np.array_equal(one.counts, batch.counts[row])
        assert one.exposure_s == 8e-3


def test_a_stream_that_begins_later_and_counts_fewer_pulses(constants: BenchConstants, raw_scan: RawScan) -> None:
    raw = points(raw_scan)
    late = TimeAxis(raw.time.bins, raw.time.bin_width_s, 20 * raw.time.bin_width_s)
    arrival = known_arrival_bins(constants, raw.x_m, raw.y_m, raw.time)
    assert known_arrival_bins(constants, raw.x_m, raw.y_m, late) == pytest.approx(arrival - 20)
    assert constants.ambient_hz is not None
    per_bin = constants.ambient_hz.value * raw.time.bin_width_s * 88_000
    few = correct_known(replace(raw, sync_count=raw.sync_count / 4), constants)
    assert few.background.per_bin == pytest.approx(per_bin / 4)
    short = TimeAxis(int(arrival.max()) + 1, raw.time.bin_width_s)
    with pytest.raises(InvalidData, match="lengthen the histogram"):
        common_bins(constants, raw.x_m, raw.y_m, short)


def test_a_scan_without_direct_light_leans_on_the_constants(constants: BenchConstants, raw_scan: RawScan) -> None:
    raw = points(raw_scan)
    gated = np.random.default_rng(0).poisson(0.02, raw.counts.shape)
    done = correct_points(replace(raw, counts=gated), constants)
    assert done.time.start_s == 0
    assert done.offsets is None


def test_constants_without_arrivals_do_not_align(constants: BenchConstants, raw_scan: RawScan) -> None:
    with pytest.raises(InvalidData, match="no direct arrivals"):
        correct_known(points(raw_scan), replace(constants, arrivals=None))
    with pytest.raises(InvalidData, match=r"bins of 16\.00 ps, the data have 32\.00 ps"):
        correct_known(points(raw_scan), replace(constants, bin_width_s=16e-12))


@pytest.mark.skipif(not TCSPC.exists(), reason="../shared is not here")
@pytest.mark.parametrize(("name", "fwhm_ps"), [("irf_direct_cdt.h5", 48), ("irf_spad_cmu.h5", 36)])
def test_measured_impulse_responses_are_read(name: str, fwhm_ps: float) -> None:
    response = load_response(TCSPC / name)
    assert response.fwhm_s() == pytest.approx(fwhm_ps * 1e-12, abs=8e-12)
    assert response.start_s < 0 < response.end_s
    said = measured(response.density, response.step_s, name)  # as reconstruction takes it
    assert response.fwhm_s() == pytest.approx(said.fwhm_s)


def test_constants_lend_their_response(constants: BenchConstants, tmp_path: Path) -> None:
    save(constants, tmp_path / "c.h5")
    assert constants.response is not None
    assert np.allclose(load_response(tmp_path / "c.h5").density, constants.response.density)


@pytest.mark.parametrize("harm", ["empty", "uneven", "flat"])
def test_a_file_that_holds_no_response_is_refused(tmp_path: Path, harm: str) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as file:
        if harm != "empty":
            file["counts"] = np.ones(20) if harm == "flat" else np.arange(20.0)
            file["time_s"] = np.arange(20.0) ** (2 if harm == "uneven" else 1)
    with pytest.raises(InvalidData, match=r"r\.h5"):
        load_response(tmp_path / "r.h5")
