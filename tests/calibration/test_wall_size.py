import numpy as np
import pytest

from nlos.acquisition.transient import TimeAxis
from nlos.calibration.raw_points import RawPoints
from nlos.calibration.wall_size import fit_scale, wall_scale
from tests.calibration.conftest import RawScan, make_raw_scan


def points(scan: RawScan) -> RawPoints:
    count, bins = scan.counts.shape
    nothing = np.zeros(count)
    axis = TimeAxis(bins, scan.bin_width_s)
    return RawPoints(scan.counts, scan.x_m, scan.y_m, np.ones(count), nothing, nothing, axis)


@pytest.mark.parametrize("drawn_m", [0.5, 1.0, 5.0])
def test_direct_times_tell_how_large_the_wall_is(drawn_m: float) -> None:
    scan = make_raw_scan(scanner_m=(0.1, -0.2, 1.2), delay_s=-6e-9)
    scale = wall_scale(points(scan).scaled(drawn_m / 2))
    assert scale is not None
    assert abs(scale.value * drawn_m - 2.0) < 4 * scale.error * drawn_m
    assert scale.error * drawn_m < 0.02


def test_where_times_do_not_tell_nothing_is_claimed() -> None:
    scan = make_raw_scan(scanner_m=(0.0, 0.0, 12.0), delay_s=-78e-9, direct_counts=100)
    assert wall_scale(points(scan)) is None
    few = np.arange(5.0)
    assert fit_scale(few * 1e-11, few + 1e-12, few, few) is None
