"""Explained light: the two parts of a scan, the renderer, what is judged, and where it is told."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import pytest
import scipy
from matplotlib.figure import Figure

from nlos.acquisition.response import gaussian
from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.picture import Picture
from nlos.recon.count_noise import count_noise
from nlos.recon.errors import ReconstructionFailed
from nlos.recon.explained import explained_light
from nlos.recon.explained_hot import hot_points
from nlos.recon.explained_parts import KEPT, CountNoise, coarser, counted_in, photon_unit, photon_unit_of_sums, split
from nlos.recon.explained_share import Explained, blame_response
from nlos.recon.explained_surface import light_from_in_front, surface_light, with_haze
from nlos.recon.live import LiveReconstruction
from nlos.recon.methods import catalogue
from nlos.recon.pictures import NOTHING, summary_figure
from nlos.recon.reconstruct import reconstruct
from nlos.recon.results import read_reconstruction, write_results
from nlos.recon.training.dataset import DatasetSettings, TrainingSample, sample
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Surfels

PLAIN = {"noiseless": 0.0, "uniform": 0.0, "sparse": 0.0, "uneven_dwell": 0.0, "jitter_fwhm_most_ps": 0.0,
         "afterpulsing_most": 0.0, "pile_up": 0.0, "calibration_residue": 0.0}  # fmt: skip
GRID = {"rows": 20, "cols": 20, "bins": 256, "bin_width_ps": 64.0}


def drawn(peak: float, index: int = 3) -> tuple[TrainingSample, Transient]:
    """A simulated scan of so many counts in the brightest bins, and the truth."""
    detector = DetectorSettings(**PLAIN, peak_counts_least=peak, peak_counts_most=peak * 1.0001)  # type: ignore[arg-type]
    data = DatasetSettings(seed=41, degradations=1, detector=detector, **GRID)  # type: ignore[arg-type]
    made = sample(data, index)
    return made, Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), data.wall, data.time)


def truth(made: TrainingSample) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    return made.intensity, np.where(made.depth_m > 0, made.depth_m, np.nan).astype(np.float32)


@pytest.mark.parametrize("falloff", [4.0, 2.0])
def test_the_renderer_sends_the_light_that_the_training_renderer_sends(falloff: float) -> None:
    wall, time = WallGrid(1.0, 1.0, 24, 24), TimeAxis(200, 64e-12)
    x, y = np.meshgrid(wall.x_m(), wall.y_m())
    seen = (np.abs(x) < 0.3) & (np.abs(y) < 0.2)
    depth = 0.6 + 0.5 * x - 0.3 * y
    normal = np.array([0.5, -0.3, -1.0]) / np.sqrt(0.5**2 + 0.3**2 + 1)
    where = np.stack([x[seen], y[seen], depth[seen]], axis=1).astype(np.float32)
    area = np.full(len(where), 1 / (24 * 24) / -normal[2], np.float32)
    pieces = Surfels(where, np.tile(normal, (len(where), 1)).astype(np.float32), area)
    other = render(pieces, wall, time, retroreflective=falloff == 2).numpy()
    albedo = np.where(seen, -normal[2], 0).astype(np.float32)
    points = np.array([(0, 0), (3, 20), (12, 12), (23, 5)])
    own = surface_light(albedo, np.where(seen, depth, np.nan).astype(np.float32), wall, points, time, falloff)
    theirs = other[:, points[:, 0], points[:, 1]]
    ratio = own.sum(axis=0) / theirs.sum(axis=0)
    inner = ratio / ratio.mean()  # the outermost pixels' slopes are one-sided, everything else is exact
    assert np.abs(inner - 1).max() < 0.02
    assert np.corrcoef(own.ravel(), theirs.ravel())[0, 1] > 0.999


def test_the_parts_are_independent_poisson_scans() -> None:
    rng = np.random.default_rng(0)
    counts = rng.poisson(np.broadcast_to([0.3, 4.0, 90.0], (60, 60, 3))).astype(np.float32).transpose(2, 0, 1).copy()
    parts = split(Transient(counts, np.ones((60, 60)), WallGrid(1, 1, 60, 60), TimeAxis(3, 1e-10)), CountNoise(1.0))
    seen, judging = parts.seen.counts, parts.judging.counts
    assert np.array_equal(seen + judging, counts)
    assert (judging == np.rint(judging)).all()
    for k, mean in enumerate((0.3, 4.0, 90.0)):
        for part, share in ((seen[k], KEPT), (judging[k], 1 - KEPT)):
            assert part.mean() == pytest.approx(share * mean, rel=0.06)
            assert part.var() == pytest.approx(share * mean, rel=0.12)
        assert abs(np.corrcoef(seen[k].ravel(), judging[k].ravel())[0, 1]) < 0.06


def test_noise_that_is_no_photons_is_split_as_well() -> None:
    rng = np.random.default_rng(1)
    mean = 100 + 50 * np.sin(np.arange(400) / 60)[:, None, None] * np.ones((400, 20, 20))
    noisy = (mean + np.sqrt(0.5 * mean) * rng.standard_normal(mean.shape)).astype(np.float32)
    scan = Transient(noisy, np.ones((20, 20)), WallGrid(1, 1, 20, 20), TimeAxis(400, 1e-10))
    unit = photon_unit(scan)
    assert unit == pytest.approx(0.5, rel=0.05)
    parts = split(scan, CountNoise(unit))
    rest = [part.counts - share * mean for part, share in ((parts.seen, KEPT), (parts.judging, 1 - KEPT))]
    assert abs(np.corrcoef(rest[0].ravel(), rest[1].ravel())[0, 1]) < 0.03


def subtracted(scan: Transient, ambient: float, seed: int = 5) -> Transient:
    """With ambient light as a raw scan has it, moved by parts of a bin, and its mean subtracted again."""
    rng = np.random.default_rng(seed)
    counts = scan.counts + rng.poisson(ambient, scan.counts.shape) * (scan.exposure_s > 0)
    part = rng.uniform(0, 1, scan.exposure_s.shape)
    moved = counts[:-1] * (1 - part) + counts[1:] * part - ambient * (scan.exposure_s > 0)
    bins, width_s = scan.time.bins - 1, scan.time.bin_width_s
    return replace(scan, counts=moved.astype(np.float32), time=TimeAxis(bins, width_s, -width_s / 2))


def test_noise_of_what_was_subtracted_is_known() -> None:
    scan = subtracted(drawn(20.0)[1], 8.0)
    noise = count_noise(scan)
    seconds = float(scan.exposure_s[scan.exposure_s > 0].mean())
    assert noise.unit * (noise.level * seconds) == pytest.approx(8 * 2 / 3, rel=0.1)  # of (1 - p)^2 + p^2 on average
    assert noise.beside == pytest.approx(0.25, abs=0.05)
    empty = subtracted(replace(scan, counts=np.zeros_like(scan.counts)), 8.0)
    parts = split(empty, count_noise(empty))
    rest = np.corrcoef(parts.seen.counts.ravel(), parts.judging.counts.ravel())
    assert abs(rest[0, 1]) < 0.03


@pytest.mark.parametrize(("peak", "ambient"), [(6.0, 0.05), (6.0, 0.3), (20.0, 0.05), (20.0, 0.3), (20.0, 8.0)])
def test_a_subtracted_background_leaves_explained_light_as_it_was(peak: float, ambient: float) -> None:
    """Faint ones, too: thinned counts are below nothing by chance, whose variance is not that of light."""
    made, scan = drawn(peak)
    albedo, depth = truth(made)
    half = albedo * (np.arange(albedo.shape[1]) < albedo.shape[1] // 2)
    for picture in (albedo, half):
        plain, other = (
            explained_light(each, lambda part, albedo=picture: (albedo, depth), (4.0,))  # type: ignore[misc]
            for each in (scan, subtracted(scan, ambient))
        )
        assert plain.share is not None
        assert other.share is not None
        assert other.share == pytest.approx(plain.share, abs=0.05)


def test_a_subtracted_background_alone_is_nothing_to_explain() -> None:
    made, scan = drawn(20.0)
    empty = subtracted(replace(scan, counts=np.zeros_like(scan.counts)), 8.0)
    told = explained_light(empty, lambda part: truth(made), (4.0,))
    assert told.nothing, str(told)


def test_points_are_added_up_and_an_odd_wall_grows_by_a_pixel() -> None:
    counts = np.random.default_rng(2).poisson(3, (5, 25, 30)).astype(np.float32)
    scan = Transient(counts, np.ones((25, 30)), WallGrid(3.0, 2.5, 25, 30), TimeAxis(5, 1e-10))
    half = coarser(scan)
    assert (half.wall.rows, half.wall.cols, half.wall.width_m) == (13, 15, 3.0)
    assert half.wall.height_m == pytest.approx(2.6)
    assert half.counts.sum() == counts.sum()
    assert half.exposure_s[0, 0] == 4
    assert half.exposure_s[12, 0] == 2


@pytest.mark.parametrize("peak", [1.0, 20.0])
def test_the_truth_explains_the_light_however_few_photons_and_wrong_pictures_do_not(peak: float) -> None:
    made, scan = drawn(peak)
    albedo, depth = truth(made)
    whole = explained_light(scan, lambda part: (albedo, depth), (4.0,))
    assert whole.share is not None
    assert whole.error is not None
    assert 0.88 < whole.share < 1.05 + 2 * whole.error
    assert not whole.nothing
    mirrored = explained_light(scan, lambda part: (albedo[:, ::-1], depth[:, ::-1]), (4.0,))
    farther = explained_light(scan, lambda part: (albedo, depth * np.float32(1.1)), (4.0,))
    noise = np.random.default_rng(3).random(albedo.shape, np.float32)
    drawn_by_chance = explained_light(scan, lambda part: (noise, np.full_like(depth, 1.9)), (4.0,))
    for wrong in (mirrored, farther, drawn_by_chance):
        assert wrong.share is not None
        assert wrong.share < whole.share - 0.1
    assert explained_light(scan, lambda part: (albedo * 0, depth), (4.0,)).nothing
    assert explained_light(scan, lambda part: (albedo, depth), (2.0, 4.0)).share == pytest.approx(whole.share, abs=0.03)


def test_light_that_hardly_stands_out_is_judged_by_what_both_parts_say() -> None:
    """Some thousand photons, or much ambient light: a right picture is not said to explain nothing."""
    made, scan = drawn(20.0)
    albedo, depth = truth(made)
    rng = np.random.default_rng(8)

    def judged(counts: npt.NDArray[np.float32], shown: npt.NDArray[np.float32] = albedo) -> Explained:
        return explained_light(replace(scan, counts=counts), lambda part: (shown, depth), (4.0,))

    few = rng.binomial(scan.counts.astype(int), 3000 / scan.counts.sum()).astype(np.float32)
    bright = scan.counts + rng.poisson(40.0, scan.counts.shape).astype(np.float32)
    for counts in (few, bright):
        told = judged(counts)
        assert told.share is not None
        assert told.error is not None
        assert abs(told.share - 0.9) < 3 * told.error < 0.9  # of much light this truth explains 0.9
        assert not told.nothing
        wrong = judged(counts, albedo[:, ::-1].copy())
        assert wrong.share is not None
        assert wrong.share < told.share - 0.1
    untold = judged(scan.counts + rng.poisson(600.0, scan.counts.shape).astype(np.float32))
    assert untold.share is None
    assert "too little light" in untold.note
    assert "unknown" in str(untold)
    for seed in range(8):
        noise = np.random.default_rng(seed).poisson(15.0, scan.counts.shape).astype(np.float32)
        assert judged(noise).nothing


@pytest.mark.parametrize("haze", [0.01, 0.1])
def test_haze_counts_but_not_by_depths_near_the_wall_where_it_would_outshine_everything(haze: float) -> None:
    """Noise pixels and the halo around an object get depths from anywhere; light fades with the fourth power."""
    made, scan = drawn(20.0)
    albedo, depth = truth(made)
    whole = explained_light(scan, lambda part: (albedo, depth), (4.0,)).share
    dark = albedo == 0
    veiled = np.where(dark, np.float32(haze * albedo.max()), albedo)
    near = explained_light(scan, lambda part: (veiled, np.where(dark, np.float32(0.1), depth)), (4.0,))
    without = explained_light(scan, lambda part: (veiled, np.where(dark, np.float32(np.nan), depth)), (4.0,))
    assert whole is not None
    assert near.share is not None
    assert near.share == without.share
    assert 0.4 < near.share < whole
    assert not near.nothing


def test_a_depth_is_believed_where_it_is_shown_and_not_far_in_front_of_all_that_is_bright() -> None:
    wall, albedo, depth = WallGrid(1.0, 1.0, 20, 20), np.full((20, 20), 0.001, np.float32), np.full((20, 20), 0.2)
    albedo[:8, :8], depth[:8, :8] = 1.0, 0.8  # bright
    albedo[12:, :8], depth[12:, :8] = 0.1, 1.4  # dim and behind it
    albedo[:8, 12:], depth[:8, 12:] = 0.1, 0.7  # dim, a little in front of it
    albedo[12:, 12:], depth[12:, 12:] = 0.1, 0.3  # dim, far in front of it: a halo
    albedo[10, 10], depth[10, 10] = 0.1, 1.1  # alone
    taken = with_haze(albedo, depth.astype(np.float32), wall)
    wanted = np.full((20, 20), 0.8, np.float32)
    wanted[12:, :8], wanted[:8, 12:] = 1.4, 0.7
    assert np.array_equal(taken, wanted)
    assert np.isnan(with_haze(albedo * 0, depth.astype(np.float32), wall)).all()


def test_a_noisy_picture_whose_bright_parts_are_right_does_not_explain_nothing() -> None:
    """The letter of `docs/notebooks/compare_methods.ipynb`, whose dimmest pixels by `phasor` lie next to the wall."""
    wall, time = WallGrid(1.0, 1.0, 32, 32), TimeAxis(192, 64e-12)
    bar, x_m, y_m = np.linspace(-0.25, 0.25, 12), wall.x_m(), wall.y_m()
    pieces = [(at, 0.25) for at in bar] + [(0.0, at) for at in bar]
    rates, (row, col) = np.full((192, 32, 32), 0.02), np.indices((32, 32))
    for at_x, at_y in pieces:
        distance = np.sqrt((x_m[None, :] - at_x) ** 2 + (y_m[:, None] - at_y) ** 2 + 0.6**2)
        np.add.at(rates, ((2 * distance / 299792458 / 64e-12).astype(int), row, col), 0.5 / distance**4)
    counts = np.random.default_rng(0).poisson(rates).astype(np.float32)
    told = reconstruct(Transient(counts, np.ones((32, 32)), wall, time), "phasor").explained
    assert told is not None
    assert told.share is not None
    assert told.share > 0.4
    assert not told.nothing


UNITS = [1e-30, 1e-12, 0.1, 2.0, 10.0, 1e10, 1e30]


@pytest.mark.parametrize("unit", UNITS)
def test_the_unit_of_counts_changes_nothing(unit: float) -> None:
    made, scan = drawn(5.0)
    albedo, depth = truth(made)
    rough = np.maximum(scan.counts + np.random.default_rng(7).normal(0, 0.1, scan.counts.shape), 0)
    for counts, whole in ((scan.counts, True), (rough, False)):
        told = [
            explained_light(
                replace(scan, counts=(counts * each).astype(np.float32)),
                lambda part: (albedo * np.float32(unit / 1e5), depth),
                (4.0,),
            )
            for each in (1.0, unit)
        ]
        assert told[1].share == pytest.approx(told[0].share, abs=1e-3)
        assert told[1].error == pytest.approx(told[0].error, abs=1e-3)
        assert told[0].share is not None
        assert told[0].share > 0.8
        assert [each.note == "" for each in told] == [whole, whole]


def test_photons_are_found_in_any_unit_and_not_where_there_are_none() -> None:
    counts = np.random.default_rng(8).poisson(3, (40, 6, 6)).astype(np.float32)
    scan = Transient(counts, np.ones((6, 6)), WallGrid(1, 1, 6, 6), TimeAxis(40, 1e-10))
    for unit in UNITS:
        assert counted_in(replace(scan, counts=counts * np.float32(unit))) == pytest.approx(unit)
    assert counted_in(replace(scan, counts=counts + 2)) == 1  # the smallest is 2, and 3 no multiple of it
    odd = counts.copy()
    odd[20, 3, 3] += 0.5
    assert counted_in(replace(scan, counts=odd + 1)) == 0
    assert counted_in(replace(scan, counts=(odd + 1) * np.float32(1e30))) == 0
    assert counted_in(replace(scan, counts=counts - 1)) == 0
    assert counted_in(replace(scan, counts=counts * 0)) == 1
    assert counted_in(replace(scan, counts=np.where(counts == 5, np.float32(3e8), counts))) == 1
    assert counted_in(replace(scan, counts=counts * np.float32(1e7) + np.float32(3e7))) == 0  # whole, as all such are


def test_photons_beyond_what_floats_tell_apart_are_no_more_noise() -> None:
    """A few bright bins made the whole scan one of unknown noise, and a right picture explained twice the light."""
    made, scan = drawn(6e4)
    brighter = np.random.default_rng(3).poisson(500 * scan.counts.astype(np.float64)).astype(np.float32)
    assert brighter.max() > 1 << 24
    albedo, depth = truth(made)
    scans = (scan, replace(scan, counts=brighter))
    told = [explained_light(each, lambda part: (albedo, depth), (4.0,)) for each in scans]
    assert told[0].share == pytest.approx(told[1].share, abs=0.01)
    assert told[0].error == pytest.approx(told[1].error, abs=0.01)


@pytest.mark.parametrize("wall_m", [60.0, 80.0, 100.0])
def test_a_wall_said_in_centimetres_claims_no_light(wall_m: float) -> None:
    """On half the grid a surface was seen, of which each point saw the one pixel in front of it: 85 %."""
    rates, wall = np.full((384, 32, 32), 0.02), WallGrid(1.0, 1.0, 32, 32)
    row, col = np.indices((32, 32))
    for at_x in np.linspace(-0.3, 0.1, 10):
        distance = np.sqrt((wall.x_m()[None, :] - at_x) ** 2 + (wall.y_m()[:, None] - 0.2) ** 2 + 0.55**2)
        np.add.at(rates, ((2 * distance / 299792458 / 32e-12).astype(int), row, col), 3 / distance**4)
    counts = np.random.default_rng(0).poisson(rates).astype(np.float32)
    right = Transient(counts, np.ones((32, 32)), wall, TimeAxis(384, 32e-12))
    told = reconstruct(right, "lct").explained
    assert told is not None
    assert told.share is not None
    assert told.share > 0.4
    result = reconstruct(replace(right, wall=WallGrid(wall_m, wall_m, 32, 32)), "lct")
    assert result.explained is not None
    assert result.explained.nothing
    assert "Check the wall's size" in result.explained.note or "nothing is seen" in result.explained.note


def test_a_right_picture_hardly_comes_from_the_pixels_in_front_of_the_points() -> None:
    """Not even of a small wall, a line of points, or an object that is as near as two points are to each other."""
    for rows, cols, z_m in ((20, 20, 1.0), (2, 2, 0.6), (1, 32, 0.5), (32, 1, 0.5), (20, 20, 0.05)):
        wall = WallGrid(cols / max(rows, cols), rows / max(rows, cols), rows, cols)
        albedo, depth = np.ones((rows, cols), np.float32), np.full((rows, cols), z_m, np.float32)
        points = np.argwhere(albedo > 0)
        for falloff in (4.0, 2.0):
            seen = (albedo, depth, wall, points, TimeAxis(512, 32e-12), falloff)
            own, everything = light_from_in_front(*seen), surface_light(*seen).sum(axis=0)
            assert (own <= everything * 1.0001).all()
            assert own.sum() < 0.8 * everything.sum()
    alone = np.zeros((20, 20), np.float32)
    alone[3, 4] = 2.0  # bright enough to be seen alone
    points = np.array([[3, 4]])
    seen = (alone, np.full((20, 20), 0.7, np.float32), WallGrid(1, 1, 20, 20), points, TimeAxis(512, 32e-12), 4.0)
    assert light_from_in_front(*seen) == pytest.approx(surface_light(*seen).sum(axis=0), rel=1e-5)


def test_what_is_only_seen_on_the_whole_grid_is_judged_there() -> None:
    """Half the grid of a near object's scan can be too coarse for any picture, or for a good one."""
    data = DatasetSettings(
        seed=41, degradations=1, detector=DetectorSettings(**PLAIN), **{**GRID, "rows": 24, "cols": 24}
    )  # type: ignore[arg-type]
    made = sample(data, 3)
    scan = Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), data.wall, data.time)
    albedo, depth = truth(made)
    grids = []

    def see(part: Transient) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        grids.append(part.wall.rows)
        coarse = part.wall.rows == 12
        return (np.zeros((12, 12), np.float32), np.full((12, 12), np.nan, np.float32)) if coarse else (albedo, depth)

    told = explained_light(scan, see, (4.0,))
    assert grids == [12, 24]
    assert told.share is not None
    assert told.share > 0.8

    def sees_nothing(part: Transient) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        return np.zeros(part.exposure_s.shape, np.float32), np.full(part.exposure_s.shape, np.nan, np.float32)

    told = explained_light(scan, sees_nothing, (4.0,))
    assert told.nothing
    assert "nothing is seen" in told.note

    def wrong(part: Transient) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        return np.ones(part.exposure_s.shape, np.float32), np.full(part.exposure_s.shape, 0.9, np.float32)

    told = explained_light(scan, lambda part: wrong(part) if part.wall.rows == 12 else (albedo, depth), (4.0,))
    assert told.share is not None
    assert told.share > 0.8
    assert explained_light(scan, wrong, (4.0,)).nothing


def test_a_right_picture_of_what_is_near_is_judged_on_the_whole_grid() -> None:
    """Half the grid is too coarse to render it, and said that the right picture explains nothing."""
    wall, time = WallGrid(0.6, 0.6, 32, 32), TimeAxis(384, 16e-12)
    x, y = np.meshgrid(0.004 * (np.arange(30) - 14.5) + 0.1, 0.004 * (np.arange(20) - 9.5) + 0.06)
    where = np.stack([x, y, np.full(x.shape, 0.1)], axis=-1).reshape(-1, 3).astype(np.float32)
    facing = np.tile(np.array([0, 0, -1], np.float32), (len(where), 1))
    rate = render(Surfels(where, facing, np.ones(len(where), np.float32)), wall, time).numpy()
    rate = scipy.ndimage.gaussian_filter1d(rate, 2, axis=0)  # a response of 75 ps
    counts = np.random.default_rng(3).poisson(400 * 1024 * rate / rate.sum() + 0.01).astype(np.float32)
    told = reconstruct(Transient(counts, np.ones((32, 32)), wall, time), "lct", {}).explained
    assert told is not None
    assert told.share is not None
    assert told.share > 0.5


def test_hot_points_that_hide_the_rest_are_named() -> None:
    _, scan = drawn(20.0)
    assert hot_points(scan, 1.0) == ""
    counts = scan.counts.copy()
    counts[:, 5, 6] += 20_000
    counts[:, 11, 2] += 30_000
    told = reconstruct(replace(scan, counts=counts), "lct").explained
    assert told is not None
    assert told.nothing
    assert re.search(r"2 of 400 points hold 9\d % of all counts.*\(11, 2\), \(5, 6\): mark", told.note)
    few = np.zeros_like(counts)
    few[100, 3, 3] = 5
    assert hot_points(replace(scan, counts=few), 1.0) == ""


def test_hot_points_are_those_of_high_rates_and_the_brightest_three_are_named() -> None:
    def told(hot: int, counts_each: float, seconds_each: float) -> str:
        counts, exposure_s = np.full((10, 20, 20), 2.0, np.float32), np.ones((20, 20))
        counts[:, 0, :hot] = counts_each * (1 + np.arange(hot)) / 10
        exposure_s[0, :hot] = seconds_each
        counts[:, 19, 19], exposure_s[19, 19] = 1e7, 0.0  # not measured
        return hot_points(Transient(counts, exposure_s, WallGrid(1, 1, 20, 20), TimeAxis(10, 1e-10)), 1.0)

    assert told(1, 1e6, 1.0).startswith("1 of 399 points hold 99 % of all counts, at (row, column) (0, 0): mark")
    assert "(0, 2), (0, 1), (0, 0): mark" in told(3, 1e6, 1.0)
    assert "(0, 3), (0, 2), (0, 1), ...: mark" in told(4, 1e6, 1.0)
    assert told(1, 1e6, 1e5) == ""  # as bright as the others, for so long
    assert told(1, 1e6, 1e-3) == told(1, 1e6, 1.0)


def test_noise_of_what_was_subtracted_is_added_to_that_of_the_light() -> None:
    """Of a scan that lasted 4 s a point, from each of whose bins 5 counts were taken."""
    noise = CountNoise(4.0)
    assert noise.deviation(np.array([9.0, -2.0]), 0.25) == pytest.approx([3.0, 2 * np.sqrt(0.5)])
    assert noise.deviation(np.array([9.0])) == pytest.approx([6.0])
    assert noise.of_sums(3) == noise
    assert CountNoise(1.0, 2.0, 0.25).of_sums(4) == CountNoise(1.375, 8.0, 0.25 / 5.5)
    light = np.where(np.abs(np.arange(400) - 200) < 60, 20.0, 0.0)
    counts = np.random.default_rng(6).poisson(5.0 + light[:, None, None], (400, 20, 20)) - 5.0
    scan = Transient(
        counts.astype(np.float32) + 0.25, np.full((20, 20), 4.0), WallGrid(1, 1, 20, 20), TimeAxis(400, 1e-10)
    )
    found = count_noise(scan)
    assert found.unit == pytest.approx(1.0, rel=0.1)
    assert found.level == pytest.approx(5 / 4, rel=0.15)
    parts = split(scan, CountNoise(1.0, 5 / 4))
    drawn_there = parts.seen.counts[:100] - KEPT * scan.counts[:100]
    assert drawn_there.var() == pytest.approx(KEPT * (1 - KEPT) * 5.25, rel=0.05)


def test_light_moved_by_parts_of_a_bin_is_as_noisy_in_sums_as_it_was() -> None:
    counts = np.random.default_rng(7).poisson(20.0, (401, 20, 20))
    moved = (counts[1:] + counts[:-1]).astype(np.float32) / np.float32(2) + np.float32(0.1)
    scan = Transient(moved, np.ones((20, 20)), WallGrid(1, 1, 20, 20), TimeAxis(400, 1e-10))
    assert photon_unit_of_sums(scan, 4) == pytest.approx(0.5 + 2 * 0.25 * 3 / 4, rel=0.03)
    assert photon_unit(replace(scan, counts=-moved)) == 0.0


def test_one_point_alone_is_not_judged() -> None:
    time = TimeAxis(100, 64e-12)
    counts = np.random.default_rng(0).poisson(np.where(np.arange(100) == 40, 300.0, 0.1)).astype(np.float32)
    told = reconstruct(
        Transient(counts[:, None, None], np.ones((1, 1)), WallGrid(0.1, 0.1, 1, 1), time), "lct"
    ).explained
    assert told is not None
    assert told.share is None
    assert "one point" in told.note


@pytest.mark.parametrize(("share", "error", "nothing"), [(0.049, 0.0, True), (0.06, 0.021, True), (0.06, 0.019, False)])
def test_a_share_has_to_stand_out_of_its_error(share: float, error: float, nothing: bool) -> None:
    assert Explained(share, error).nothing is nothing


def test_a_scan_of_noise_is_explained_by_nothing_and_says_so(tmp_path: Path) -> None:
    _, scan = drawn(5.0)
    dark = replace(scan, counts=np.random.default_rng(4).poisson(0.3, scan.counts.shape).astype(np.float32))
    for method in ("lct", "fk"):
        result = reconstruct(dark, method)
        assert result.explained is not None
        assert result.explained.nothing
    assert "EXPLAINS NOTHING" in str(result.explained)
    figure: Figure = summary_figure(result)
    assert figure.get_suptitle() == NOTHING
    assert summary_figure(reconstruct(scan, "lct")).get_suptitle() == ""
    write_results(tmp_path / "dark", result)
    assert read_reconstruction(tmp_path / "dark" / "reconstruction.h5").explained == replace(
        result.explained, seconds=0.0
    )


@pytest.mark.parametrize(("fwhm_s", "blamed"), [(1e-10, False), (3e-9, True), (15e-9, True)])
def test_a_response_that_the_light_does_not_bear_out_is_named(fwhm_s: float, blamed: bool) -> None:
    scan = replace(drawn(100.0)[1], response=gaussian(fwhm_s, "run.h5: response_fwhm_ps"))
    told = reconstruct(scan, "lct", elsewhere=True).explained
    assert told is not None
    assert told.nothing == (fwhm_s > 1e-8)
    said = re.search(
        r"without the response \(run.h5: response_fwhm_ps\) it explains (\d+) .*--response none", str(told.note)
    )
    assert (said is not None and int(said[1]) > 50) == blamed, told


@pytest.mark.parametrize(
    ("found", "without", "blamed"),
    [
        ((0.03, 0.02), (0.065, 0.02), False),  # both may be 5 %
        ((0.03, 0.005), (0.065, 0.005), True),
        ((-0.1, 0.02), (0.06, 0.01), True),
        ((-0.1, 0.02), (0.03, 0.001), False),  # explains nothing either
        ((0.2, 0.01), (0.35, 0.01), False),
        ((0.02, 0.01), (None, None), False),
    ],
)
def test_no_response_is_blamed_by_chance(
    found: tuple[float, float], without: tuple[float | None, float | None], blamed: bool
) -> None:
    told = blame_response(Explained(*found), Explained(*without), "constants.h5")
    assert ("--response none" in told.note) == blamed


def test_pictures_that_are_made_again_and_again_look_for_no_other_response(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a scan that has just begun each explains little; the page has no room for why, either."""
    scan, judged = replace(drawn(100.0)[1], response=gaussian(3e-9, "constants.h5")), list[bool]()

    def counted(transient: Transient, *given: Any, **more: Any) -> Explained:
        judged.append(transient.response is not None)
        return explained_light(transient, *given, **more)

    monkeypatch.setattr("nlos.recon.reconstruct.explained_light", counted)
    live = LiveReconstruction("lct")
    told = live.explained(live.update(scan, 64), scan).reconstruction.explained
    assert told is not None
    assert told.little
    assert judged == [True]
    reconstruct(scan, "lct")
    assert judged == [True, True]
    reconstruct(scan, "lct", elsewhere=True)
    assert judged == [True, True, True, False]


def test_what_cannot_be_judged_says_why() -> None:
    _, scan = drawn(5.0)
    few = np.zeros_like(scan.counts)
    few[100, 3, 3] = 1
    none = reconstruct(replace(scan, counts=few), "lct").explained
    assert none is not None
    assert none.share is None
    assert "too few photons" in none.note

    def fails(part: Transient) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        raise ReconstructionFailed("not today")

    assert "not today" in explained_light(scan, fails, (4.0,)).note


@pytest.mark.parametrize("method", [name for name in catalogue() if name not in ("nano", "lfe", "nlost", "faithful")])
def test_every_method_says_what_it_explains(method: str) -> None:
    _, scan = drawn(20.0)
    if method == "unet":
        pytest.skip("no weights ship")
    told = reconstruct(scan, method, {"iterations": 3} if method == "gradient_descent" else {}).explained
    assert told is not None
    assert told.share is not None
    assert -0.2 < told.share < 1.1


def test_the_command_line_tells_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from nlos.__main__ import run

    _, scan = drawn(20.0)
    dark = np.random.default_rng(5).poisson(0.2, scan.counts.shape)
    reversed_lines = scan.counts.copy()
    reversed_lines[:, 1::2] = reversed_lines[:, 1::2, ::-1]
    for name, counts in (("light", scan.counts), ("dark", dark), ("lines", reversed_lines)):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file["histograms"] = counts.transpose(1, 2, 0).astype(np.uint16)
            file.attrs["bin_width_s"], file.attrs["wall_size_m"], file.attrs["direct_cut_bins"] = 64e-12, 2.0, 0
        assert run(["reconstruct", str(tmp_path / f"{name}.h5"), "-o", str(tmp_path / name), "--json"]) == 0
        told = capsys.readouterr()
        (said,) = json.loads(told.out)["reconstructions"]
        with h5py.File(tmp_path / name / "reconstruction.h5") as file:
            assert said["explained"] == file.attrs["explained"]
            assert said["explained_error"] == file.attrs["explained_error"]
        doubt = Picture(read_reconstruction(tmp_path / name / "reconstruction.h5")).doubt
        assert doubt == said["explained_doubt"]
        assert ("every second line" in doubt) == ("geometry in doubt" in told.err) == (name == "lines")
        if name == "light":
            assert said["explained"] > 0.4
        elif name == "dark":
            assert Explained(said["explained"], said["explained_error"]).nothing
            assert "EXPLAINS NOTHING" in told.err


def test_the_report_warns_above_a_picture_that_explains_nothing() -> None:
    from nlos.report.page import _label

    _, scan = drawn(20.0)
    good = reconstruct(scan, "lct")
    assert _label(good) == ""
    bad = replace(good, explained=Explained(0.01, 0.002, "<b>"))
    assert "explains nothing" in _label(bad)
    assert "<b>" not in _label(bad)
