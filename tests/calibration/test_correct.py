import numpy as np
import pytest

from acquisition.transient import TimeAxis, Transient
from acquisition.wall import WallGrid
from calibration.correct import correct, correct_points
from calibration.errors import InvalidData
from tests.calibration.conftest import RawScan, make_raw_scan


def test_time_zero_is_the_direct_arrival_and_only_the_hidden_light_is_left() -> None:
    scan = make_raw_scan(direct_counts=40_000)
    axis = TimeAxis(512, scan.bin_width_s)
    done = correct_points(scan.counts, scan.x_m, scan.y_m, np.ones(256), axis)
    assert done.time.start_s == 0
    return_bins = 2 * np.sqrt((scan.x_m - 0.2) ** 2 + scan.y_m**2 + 0.9**2) / 299_792_458 / scan.bin_width_s
    for point in (0, 100, 255):
        near = slice(int(return_bins[point]) - 3, int(return_bins[point]) + 6)
        assert done.counts[point, near].sum() == pytest.approx(scan.hidden[point].sum(), abs=25)
    assert done.counts[:, : done.direct.end_bin].max() == 0
    elsewhere = done.usable & (np.abs(np.arange(done.time.bins) - return_bins[:, None]) > 20)
    assert abs(done.counts[elsewhere].mean()) < 0.05
    rest = (done.counts / np.sqrt(np.maximum(done.variance, 0.2)))[elsewhere]
    assert rest.std() < 1.3


def test_the_model_gives_back_what_was_removed(raw_scan: RawScan) -> None:
    axis = TimeAxis(512, raw_scan.bin_width_s)
    parts = (raw_scan.counts, raw_scan.x_m, raw_scan.y_m, np.ones(256), axis)
    kept, removed = correct_points(*parts, remove_direct=False), correct_points(*parts)
    again = removed.counts + removed.direct.counts()
    usable = removed.usable
    assert np.allclose(again[usable], kept.counts[usable], atol=1e-2)


def test_rectified_scans_without_direct_light_are_left_alone() -> None:
    counts = np.random.default_rng(0).poisson(2.0, (100, 6, 6)).astype(np.float32)
    counts[60:64] += 30
    scan = Transient(counts, np.ones((6, 6)), WallGrid(1, 1, 6, 6), TimeAxis(100, 32e-12))
    done = correct(scan, rectified=True)
    assert (done.transient.counts == counts).all()
    assert done.mask.all()


def test_unmeasured_points_stay_unmeasured(raw_scan: RawScan) -> None:
    exposure = np.ones(256)
    exposure[10] = 0
    done = correct_points(raw_scan.counts, raw_scan.x_m, raw_scan.y_m, exposure, TimeAxis(512, raw_scan.bin_width_s))
    assert done.exposure_s[10] == 0
    assert not done.usable[10].any()
    assert not done.counts[10].any()


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (np.nan, "point 37, bin 5 is nan: counts must be finite"),
        (-1.0, "point 37, bin 5 is -1.0: raw counts are never"),
    ],
)
def test_bad_counts_are_refused_by_point_and_reason(raw_scan: RawScan, bad: float, reason: str) -> None:
    counts = raw_scan.counts.astype(np.float64)
    counts[37, 5] = bad
    with pytest.raises(InvalidData, match=reason):
        correct_points(counts, raw_scan.x_m, raw_scan.y_m, np.ones(256), TimeAxis(512, raw_scan.bin_width_s))
