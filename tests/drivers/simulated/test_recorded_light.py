"""A recorded scan handed out again, thinned to the dwell asked for."""

from dataclasses import replace

import numpy as np
import pytest

from nlos.drivers.errors import LimitError
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath
from nlos.drivers.simulated.bench import Gate
from nlos.drivers.simulated.recorded import RecordedLight, RecordedScan

BIN_S = 32e-12


def recorded(exposure_s: float = 10e-3) -> RecordedScan:
    rng = np.random.default_rng(2)
    x_m, y_m = (axis.ravel() for axis in np.meshgrid([-0.2, 0.0, 0.2], [0.2, 0.0, -0.2]))
    return RecordedScan(rng.poisson(400.0, (9, 64)).astype(np.uint32), x_m, y_m, np.full(9, exposure_s), BIN_S, 5e-9)


def at(x_m: float, y_m: float) -> MirrorAngles:
    y_rad = np.arctan2(y_m, 2.0)
    return MirrorAngles(float(np.arctan2(x_m, 2.0 / np.cos(y_rad))), float(y_rad))


def source(scan: RecordedScan) -> RecordedLight:
    return RecordedLight(scan, BeamPath(2.0), 10e6, seed=3)


def gate(dwell_s: float, bins: int = 64, width: int = 1, offset_s: float = 5e-9) -> Gate:
    return Gate(0.0, dwell_s, bins, BIN_S * width, offset_s, number=7)


def test_the_whole_dwell_gives_the_recorded_counts_at_the_recorded_place() -> None:
    scan = recorded()
    light = source(scan)
    for point in range(9):
        exposure = light(gate(10e-3), at(scan.x_m[point] + 0.03, scan.y_m[point] - 0.03), True)
        assert (exposure.counts == scan.counts[point]).all()


def test_a_shorter_dwell_keeps_a_binomial_part() -> None:
    scan = recorded()
    exposure = source(scan)(gate(2.5e-3), at(0.2, -0.2), True)
    expected = scan.counts[8] / 4
    assert (np.abs(exposure.counts - expected) < 5 * np.sqrt(expected * 0.75)).all()
    assert exposure.live_s == 2.5e-3


def test_a_longer_dwell_and_an_unrecorded_place_are_refused() -> None:
    light = source(recorded())
    with pytest.raises(LimitError, match="longer than the 10 ms recorded"):
        light(gate(11e-3), at(0.0, 0.0), True)
    with pytest.raises(LimitError, match=r"nothing was recorded at x = \+0\.5000 m"):
        light(gate(5e-3), at(0.5, 0.0), True)


@pytest.mark.parametrize("seed", range(3))
def test_of_many_places_the_nearest_one_is_found_and_of_two_as_near_one_of_them(seed: int) -> None:
    """By the distances to all of them, which are not computed where there are many."""
    rng = np.random.default_rng(seed)
    x_m, y_m = rng.integers(-4, 5, (2, 60)) * 0.05
    light = source(replace(recorded(), counts=np.eye(60, dtype=np.uint32), x_m=x_m, y_m=y_m, exposure_s=np.ones(60)))
    apart_m = np.unique(np.stack([x_m, y_m], axis=1), axis=0)
    for spot_m in rng.integers(-10, 11, (100, 2)) * 0.025:
        away_m = np.hypot(*(apart_m - spot_m).T)
        if away_m.min() > light._tolerance_m - 1e-9:
            with pytest.raises(LimitError):
                light.check(gate(0.5, bins=60), at(*(spot_m * 1.001)))
            continue
        x, y = apart_m[np.flatnonzero(away_m < away_m.min() + 1e-9)].T
        got = int(light(gate(1.0, bins=60), at(*spot_m), True).counts.argmax())
        assert (x_m[got], y_m[got]) in set(zip(x.tolist(), y.tolist(), strict=True))


def test_a_rate_meter_may_look_longer_than_was_recorded() -> None:
    scan = recorded()
    look = replace(gate(0.1), kept=False)
    assert source(scan)(look, at(3.0, 0.0), True).total_count == 0
    shown = source(scan)(look, at(0.0, 0.0), True)
    assert shown.total_count == pytest.approx(int(scan.counts[4].sum()) * 10, rel=0.02)


def test_time_axes_are_regrouped_whole_bins_at_a_time() -> None:
    scan = recorded()
    light = source(scan)
    wide = light(gate(10e-3, bins=32, width=2), at(0.0, 0.0), True)
    assert (wide.counts == scan.counts[4].reshape(32, 2).sum(axis=1)).all()
    later = light(gate(10e-3, bins=70, offset_s=5e-9 + 3 * BIN_S), at(0.0, 0.0), True)
    assert (later.counts == np.append(scan.counts[4][3:], np.zeros(9))).all()
    earlier = light(gate(10e-3, bins=20, offset_s=5e-9 - 3 * BIN_S), at(0.0, 0.0), True)
    assert (earlier.counts == np.append(np.zeros(3), scan.counts[4][:17])).all()
    with pytest.raises(LimitError, match="do not lie on them"):
        light(gate(10e-3, offset_s=5e-9 + 0.4 * BIN_S), at(0.0, 0.0), True)


def test_a_closed_shutter_hands_out_nothing() -> None:
    assert source(recorded())(gate(10e-3), at(0.0, 0.0), False).counts.sum() == 0
