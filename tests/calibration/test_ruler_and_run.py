"""The place that a ruler and a scan tell together: within its printed errors, on grids and off, whatever the ruler's
noise; and what a mistyped row or another unit does to it."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import pytest

from nlos.calibration.errors import InvalidData
from nlos.calibration.geometry import ScannerGeometry
from nlos.calibration.geometry_fit import DirectTimes, Spots
from nlos.calibration.reduced_times import reduced_times
from nlos.calibration.spots_fit import PlacedScanner, place_from_spots, place_with_run
from nlos.calibration.spots_sense import check_sense
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.simulated.beam import BeamPath, Misalignment

C = 299_792_458.0
DELAY_S = 47e-9
TRUE_M = {"scanner_x_m": 0.25, "scanner_y_m": -0.05, "wall_distance_m": 1.42}
DRAWN = ScannerGeometry(1.45, 0.0, 0.20)
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Lab:
    """A table that is not as it was drawn, and a ruler with millimetre marks."""

    path: BeamPath

    @classmethod
    def off(cls, **more: float) -> "Lab":
        return cls(BeamPath(1.45, 0.0, Misalignment(**(TRUE_M | more))))

    def seen(self, x_rad: Floats, y_rad: Floats) -> tuple[Floats, Floats, Floats]:
        spots = [self.path.spot(MirrorAngles(float(a), float(b))) for a, b in zip(x_rad, y_rad, strict=True)]
        x, y, far = np.array([(s.x_m, s.y_m, s.range_m) for s in spots if s is not None]).T
        return x, y, far

    def spots(self, kind: str, count: int, noise_m: float, seed: int) -> Spots:
        draw = np.random.default_rng(seed)
        places = np.array([(x, y) for y in (0.4, 0.0, -0.4, 0.2, -0.2) for x in (-0.4, 0.0, 0.4, 0.6)])[:count]
        if kind == "scattered":
            places = draw.uniform(-0.75, 0.75, (count, 2))
        x_rad, y_rad = DRAWN.angles_rad(places[:, 0], places[:, 1])
        x, y, _ = self.seen(x_rad, y_rad)
        read = np.round(np.column_stack([x, y]) + draw.normal(0, noise_m, (count, 2)), 3)
        return Spots(x_rad, y_rad, read[:, 0], read[:, 1])

    def times(self, seed: int, side: int = 5, error_s: float = 0.4e-12) -> DirectTimes:
        line = np.linspace(-0.4, 0.4, side)
        x_rad, y_rad = DRAWN.angles_rad(*(a.ravel() for a in np.meshgrid(line, line)))
        arrival = 2 * self.seen(x_rad, y_rad)[2] / C + DELAY_S
        arrival = arrival + np.random.default_rng(1000 + seed).normal(0, error_s, len(x_rad))
        return DirectTimes(x_rad, y_rad, arrival, np.full(len(x_rad), error_s))


def off_mm(placed: PlacedScanner) -> Floats:
    return np.array([(getattr(placed.fit.geometry, name) - true) * 1e3 for name, true in TRUE_M.items()])


def in_errors(placed: PlacedScanner) -> Floats:
    return off_mm(placed) / [placed.fit.errors[name] * 1e3 for name in TRUE_M]


@pytest.mark.sampled(3)
@pytest.mark.parametrize("kind", ["grid", "scattered"])
@pytest.mark.parametrize("count", [9, 12, 15, 20])
def test_the_true_place_lies_within_the_printed_errors_as_often_as_it_should(kind: str, count: int) -> None:
    lab, alone, both = Lab.off(), [], []
    for noise_m in (0.0, 5e-4, 1e-3):
        for seed in range(2):
            spots = lab.spots(kind, count, noise_m, seed)
            alone.append(in_errors(place_from_spots(spots, DRAWN)))
            placed = place_with_run(spots, lab.times(seed), DRAWN)
            both.append(np.append(in_errors(placed), (placed.fit.delay_s - DELAY_S) / placed.fit.errors["delay_s"]))
            assert not placed.freed
            if count >= 15:
                assert np.abs(off_mm(placed)).max() < 2.0
    for each in (np.array(alone), np.array(both)):
        assert np.abs(each).max() < 3.5
        assert (np.abs(each) < 2).mean() > 0.9


def test_a_ruler_that_everything_shares_does_not_move_the_place_as_a_gain() -> None:
    """Marks 0.07 % too long would be a gain and 2.8 mm of distance, to a fit that believes them to 0.1 mm."""
    spots = Lab.off().spots("grid", 12, 0.0, 0)
    long = replace(spots, x_m=0.25 + (spots.x_m - 0.25) * 1.0007, y_m=-0.05 + (spots.y_m + 0.05) * 1.0007)
    placed = place_with_run(long, Lab.off().times(0), DRAWN)
    assert not placed.freed
    assert np.abs(off_mm(placed)).max() < 2.0
    assert np.abs(in_errors(placed)).max() < 2.0


@pytest.mark.parametrize(("gain", "value"), [("x_gain", 1.012), ("y_gain", 0.99)])
def test_a_gain_that_is_one_is_found(gain: str, value: float) -> None:
    lab = Lab.off(**{gain: value})
    placed = place_with_run(lab.spots("scattered", 15, 5e-4, 3), lab.times(3), DRAWN)
    assert gain in placed.freed
    assert getattr(placed.fit.geometry, gain) == pytest.approx(value, abs=3 * placed.fit.errors[gain])
    assert np.abs(in_errors(placed)).max() < 3.5


def test_thousands_of_arrivals_are_a_few_hundred_that_say_the_same() -> None:
    lab = Lab.off()
    times, spots = lab.times(5, side=40, error_s=2e-12), lab.spots("scattered", 12, 5e-4, 5)
    times.arrival_s[77] += 1e-9
    few = reduced_times(times, DRAWN)
    assert len(few.x_rad) == 144
    assert (few.error_s**-2.0).sum() == pytest.approx((times.error_s**-2.0).sum(), rel=0.1)
    placed = place_with_run(spots, times, DRAWN)
    assert len(placed.fit.height_m) == 1600
    assert not placed.fit.accepted[77]
    assert placed.fit.accepted.mean() > 0.99
    assert np.abs(in_errors(placed)).max() < 3.5


@pytest.mark.parametrize("wrong", [lambda v: v * 10, lambda v: -v, lambda v: v + 0.1, lambda v: v * 1000])
@pytest.mark.parametrize("row", [0, 5, 11])
def test_one_mistyped_row_is_left_aside_and_moves_nothing(row: int, wrong: object) -> None:
    spots = Lab.off().spots("scattered", 12, 5e-4, 7)
    spots.y_m[row] = wrong(spots.y_m[row])  # type: ignore[operator]
    placed = place_from_spots(replace(spots, lines=tuple(range(2, 14))), DRAWN)
    assert np.flatnonzero(~placed.fit.spots_accepted).tolist() == [row]
    assert np.abs(off_mm(placed)).max() < 3.0


@pytest.mark.parametrize(
    ("factor", "said"),
    [(1000.0, "Are these millimetres"), (100.0, "Are these centimetres"), (39.37, "Are these inches")],
)
def test_other_units_are_recognised(factor: float, said: str) -> None:
    spots = Lab.off().spots("grid", 12, 0.0, 0)
    other = replace(spots, x_m=spots.x_m * factor, y_m=spots.y_m * factor)
    for place in (lambda: place_from_spots(other, DRAWN), lambda: place_with_run(other, Lab.off().times(0), DRAWN)):
        with pytest.raises(InvalidData, match=said):
            place()


def test_spots_that_no_wall_explains_are_refused() -> None:
    spots = Lab.off().spots("scattered", 12, 0.0, 0)
    stirred = replace(spots, y_m=spots.y_m + np.random.default_rng(0).normal(0, 0.06, 12))
    with pytest.raises(InvalidData, match=r"scatter by .* mm RMS|spots do not fit the others"):
        place_from_spots(stirred, DRAWN)


@pytest.mark.parametrize("kind", ["grid", "scattered"])
@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_reversed_axis_is_named_and_its_table_can_be_turned(kind: str, axis: str) -> None:
    spots = Lab.off().spots(kind, 12, 1e-3, 2)
    turned = replace(spots, **{f"{axis}_rad": -getattr(spots, f"{axis}_rad")})
    turned.x_m[3] += 3.0  # one mistyped row turns nothing round
    with pytest.raises(InvalidData, match=f"{axis} is reversed"):
        check_sense(turned)
    spots.x_m[3] += 3.0
    check_sense(spots)
