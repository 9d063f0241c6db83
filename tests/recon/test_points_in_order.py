"""Whether points lie where a scan says: neighbours record nearly the same light, other points do not."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.points_in_order import out_of_order

Counts = npt.NDArray[np.float32]
WALL, TIME = WallGrid(1.6, 1.2, 24, 32), TimeAxis(256, 64e-12)


def scan(photons: float, seed: int = 0, shapes: int = 12) -> Transient:
    """Points that hang in space, seen from a wall that is not square."""
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(WALL.x_m(), WALL.y_m())
    expected, (row, col) = np.full((TIME.bins, 24, 32), 0.01), np.indices((24, 32))
    for _ in range(shapes):
        at_x, at_y, z = rng.uniform(-0.6, 0.6), rng.uniform(-0.5, 0.5), rng.uniform(0.5, 1.2)
        r = np.sqrt((x - at_x) ** 2 + (y - at_y) ** 2 + z**2)
        np.add.at(expected, ((2 * r / 299792458 / 64e-12).astype(int), row, col), photons / r**4)
    return Transient(rng.poisson(expected).astype(np.float32), np.ones((24, 32)), WALL, TIME)


def mixed(counts: Counts) -> Counts:
    """Four points of ten in each other's places."""
    rng, flat = np.random.default_rng(7), counts.reshape(len(counts), -1).copy()
    chosen = rng.permutation(flat.shape[1])[: 2 * flat.shape[1] // 5]
    flat[:, chosen] = flat[:, rng.permutation(chosen)]
    return flat.reshape(counts.shape)


def there_and_back(counts: Counts) -> Counts:
    counts = counts.copy()
    counts[:, 1::2] = counts[:, 1::2, ::-1]
    return counts


def lagging(counts: Counts) -> Counts:
    counts = counts.copy()
    counts[:, :, 1::2] = np.roll(counts[:, :, 1::2], 4, axis=1)
    return counts


@pytest.mark.parametrize("photons", [0.3, 3.0, 30.0])
@pytest.mark.parametrize("seed", range(4))
def test_nothing_speaks_against_points_in_order(photons: float, seed: int) -> None:
    right = scan(photons, seed)
    assert out_of_order(right) == ""
    turned = replace(right, counts=np.ascontiguousarray(right.counts[:, ::-1, ::-1]))
    assert out_of_order(turned) == "", "a mirror image is a scene as good as any"


def jumping_by_columns(counts: Counts) -> Counts:
    """Time zero wanders by 3 bins of 64 ps, as of a trigger that is armed anew for every line."""
    shifts = np.round(np.random.default_rng(5).normal(0, 3, counts.shape[2])).astype(int)
    return np.stack([np.roll(counts[:, :, col], by, axis=0) for col, by in enumerate(shifts)], axis=2)


def jumping_by_rows(counts: Counts) -> Counts:
    shifts = np.round(np.random.default_rng(6).normal(0, 3, counts.shape[1])).astype(int)
    return np.stack([np.roll(counts[:, row], by, axis=0) for row, by in enumerate(shifts)], axis=1)


@pytest.mark.parametrize("photons", [3.0, 30.0])
@pytest.mark.parametrize(
    ("disorder", "words"),
    [
        (mixed, "check their order"),
        (there_and_back, "every second line"),
        (lagging, "every second line"),
    ],
)
def test_points_that_lie_elsewhere_are_noticed(
    photons: float, disorder: Callable[[Counts], Counts], words: str
) -> None:
    for seed in range(3):
        right = scan(photons, seed)
        assert words in out_of_order(replace(right, counts=disorder(right.counts)))


@pytest.mark.parametrize("disorder", [jumping_by_columns, jumping_by_rows])
def test_a_time_zero_that_jumps_between_lines_is_named(disorder: Callable[[Counts], Counts]) -> None:
    for seed in range(3):
        right = scan(30.0, seed)
        assert "time zero jumps by" in out_of_order(replace(right, counts=disorder(right.counts)))


def test_one_line_that_is_late_is_no_jumping_time_zero() -> None:
    right = scan(30.0)
    late = right.counts.copy()
    late[:, :, 20] = np.roll(late[:, :, 20], 40, axis=0)
    assert out_of_order(replace(right, counts=late)) == ""


def test_uneven_dwells_are_no_disorder() -> None:
    right, rng = scan(30.0), np.random.default_rng(1)
    dwell = rng.uniform(0.2, 1.0, right.exposure_s.shape)
    counts = rng.binomial(right.counts.astype(int), dwell).astype(np.float32)
    assert out_of_order(replace(right, counts=counts, exposure_s=dwell)) == ""


def test_noise_and_scattered_points_say_nothing() -> None:
    right = scan(30.0)
    noise = np.random.default_rng(2).poisson(0.4, right.counts.shape).astype(np.float32)
    assert out_of_order(replace(right, counts=noise)) == ""
    sparse = np.zeros_like(right.exposure_s)
    sparse[::4, ::4] = 1
    assert out_of_order(replace(right, counts=mixed(right.counts) * (sparse > 0), exposure_s=sparse)) == ""


def test_points_aligned_by_parts_of_a_bin_under_a_background_that_was_taken_off_are_in_order() -> None:
    """Half of each photon lies in the next bin, and noise alone is left of the early bins."""
    rng, right = np.random.default_rng(3), scan(1.0)
    tail = 40 * np.exp(-np.arange(TIME.bins) / 20.0)[:, None, None]
    noisy = right.counts + rng.poisson(tail, right.counts.shape)
    moved = ((noisy + np.roll(noisy, 1, axis=0)) / 2 - (tail + np.roll(tail, 1, axis=0)) / 2).astype(np.float32)
    moved[:2] = 0.0
    assert out_of_order(replace(right, counts=moved)) == ""


def test_lines_reversed_under_even_light_that_was_taken_off_are_told() -> None:
    """As calibration leaves a raw scan in a lit room: faint light, much noise, and counts below 0."""
    rng, right = np.random.default_rng(4), scan(3.0)
    part = rng.uniform(0, 1, right.exposure_s.shape)

    def calibrated(counts: Counts) -> Transient:
        lit = counts + rng.poisson(6.0, counts.shape)
        moved = np.roll(lit, 1, axis=0) * part + lit * (1 - part) - 6.0
        return replace(right, counts=moved.astype(np.float32))

    assert out_of_order(calibrated(right.counts)) == ""
    assert "every second line" in out_of_order(calibrated(there_and_back(right.counts)))
