"""Intervals: the figures that judge them, their calibration, and those of NANO on scans that nobody trained on."""

import shutil
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon import intervals
from nlos.recon.interval_scores import ause, calibration_error, interval_scores
from nlos.recon.intervals import CALIBRATED, NOISE, RESPONSE, TRAITS, UNCALIBRATED, adjusted, head_for, traits_of
from nlos.recon.layers.evidence import NAMES, UNTOLD
from nlos.recon.layers.interval_head import ALBEDO_UNIT, DEPTH_UNIT, IntervalHead, pinball
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.reconstruct import reconstruct
from nlos.recon.refined import REFINEMENT
from nlos.recon.results import read_reconstruction, write_results
from nlos.recon.seen import depth_opacity
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.interval_calibration import PIXELS, Seen, calibrate, calibrated, judge
from nlos.recon.training.interval_set import CALIBRATION, Judged, scan, seen_by
from nlos.recon.training.intervals import head_to_calibrate as read_back
from nlos.recon.training.intervals import save_draft
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import Surfels
from nlos.recon.view3d import solid_points
from nlos.recon.volume import Intervals, Reconstruction
from nlos.recon.weights.files import OWN_FOLDER, read_weights, save

CLEAN = DetectorSettings(sparse=0.0, noiseless=0.0, uniform=0.0, peak_counts_least=8, peak_counts_most=8.01)


def test_doubt_that_orders_as_the_error_does_leaves_no_area() -> None:
    error = np.random.default_rng(0).exponential(size=2000)
    assert ause(error, 3 * error) == pytest.approx(0, abs=1e-12)
    by_chance = ause(error, np.random.default_rng(1).random(2000))
    assert 0.03 < by_chance < ause(error, -error) < 0.5
    assert np.isnan(ause(np.zeros(5), np.ones(5)))


def test_probabilities_that_hold_have_no_calibration_error() -> None:
    told = np.random.default_rng(2).random((300, 300)).astype(np.float32)
    there = np.random.default_rng(3).random((300, 300)) < told
    assert calibration_error(told, there) < 0.01
    assert calibration_error(np.sqrt(told), there) > 0.1


def test_coverage_and_width_are_of_the_surface_in_the_pictures_units() -> None:
    truth = np.zeros((10, 10), np.float32)
    truth[2:8, 2:8] = 0.5
    picture, depth, mask = truth * 0.6, np.where(truth > 0, 1.0, np.nan).astype(np.float32), truth > 0
    low, high = picture - 0.03, picture + 0.03
    low[2, 2:8] = picture[2, 2:8] + 0.01  # one row of six misses
    true_m = np.where(mask, 1.0, 0).astype(np.float32)
    true_m[7, 2:8] = 1.2
    sure = Intervals(low, high, depth * 0 + 0.95, depth * 0 + 1.05, mask.astype(np.float32))
    scores = interval_scores(picture, depth, sure, truth, true_m, mask)
    assert scores["albedo_coverage"] == pytest.approx(5 / 6)
    assert scores["depth_coverage"] == pytest.approx(5 / 6)
    assert scores["depth_width_m"] == pytest.approx(0.1, rel=1e-4)
    assert scores["seen_ece"] == 0
    assert all(np.isnan(x) for x in interval_scores(picture, depth, None, truth, true_m, mask).values())


def test_the_pinball_loss_is_least_at_its_quantile() -> None:
    x = torch.randn(20000, generator=torch.Generator().manual_seed(0))
    ends = torch.linspace(-3, 3, 601)
    losses = torch.stack([pinball(x - end, 0.95).mean() for end in ends])
    assert float(ends[losses.argmin()]) == pytest.approx(1.645, abs=0.05)


def constant(value: float) -> tuple[float, ...]:
    """Coefficients of what does not depend on a scan's traits."""
    return (value, *(0.0,) * len(TRAITS))


def test_a_calibration_widens_and_the_interval_always_holds_the_picture() -> None:
    evidence = torch.rand(3, len(NAMES), 8, 8)
    raw = IntervalHead()(evidence)
    traits = traits_of(evidence)
    none, wide, narrow = (
        adjusted(raw, replace(UNCALIBRATED, albedo=constant(np.log(by)), depth=constant(np.log(by))), traits)
        for by in (1.0, 2.0, 0.01)
    )
    torch.testing.assert_close(none.albedo_high - raw.albedo, raw.brighter)
    torch.testing.assert_close(none.seen, torch.sigmoid(raw.seen))
    assert (wide.depth_low <= none.depth_low).all()
    assert (wide.depth_high > none.depth_high).all()
    picture, depth = evidence[:, NAMES.index("albedo")], evidence[:, NAMES.index("depth")] + 0.5
    for made in (none, wide, narrow):
        assert (made.depth_low <= depth).all()
        assert (depth <= made.depth_high).all()
        assert (made.albedo_low >= 0).all()
        assert (made.albedo_low <= picture).all()
        assert (picture <= made.albedo_high).all()


def test_width_and_line_of_seen_follow_the_traits_of_a_scan_as_far_as_they_were_calibrated() -> None:
    evidence = torch.rand(3, len(NAMES), 8, 8)
    evidence[1:] = evidence[0]
    evidence[:, NOISE] = torch.tensor([0.0, 1.0, 5.0])[:, None, None]
    raw = IntervalHead()(evidence)
    steps = [0.0] * (1 + len(TRAITS))
    steps[1 + TRAITS.index("noise")] = 0.7
    slopes = list(steps)
    slopes[0] = 1.0
    most = tuple(2.0 if name == "noise" else np.inf for name in TRAITS)
    made = adjusted(raw, replace(UNCALIBRATED, most=most, albedo=(*steps,), slope=(*slopes,)), traits_of(evidence))
    for which, noise in enumerate((0.0, 1.0, 2.0)):  # and not 5
        wider = (made.albedo_high[which] - raw.albedo[which]) / raw.brighter[which]
        torch.testing.assert_close(wider, torch.full_like(wider, float(np.exp(0.7 * noise))), rtol=1e-3, atol=0)
        torch.testing.assert_close(made.seen[which], torch.sigmoid((1 + 0.7 * noise) * raw.seen[which]))


def test_a_calibration_finds_the_factor_by_which_a_head_is_too_sure() -> None:
    """Scans whose truth lies at 2 to 8 sides of the head's, the more the noisier, normally spread: 1.645 times that
    holds nine of ten."""
    head, rng = IntervalHead(), np.random.default_rng(4)
    scans, factors = [], []
    for k in range(60):
        evidence = np.zeros((len(NAMES), 32, 32), np.float32)
        noise = rng.uniform(-1, 1)
        evidence[NAMES.index("albedo")], evidence[RESPONSE], evidence[NOISE] = 1.0, UNTOLD, noise
        off = 4 * 2**noise * rng.standard_normal((2, 32, 32)).astype(np.float32)
        factors.append(1.645 * 4 * 2**noise)
        scans.append(
            Judged(
                evidence,
                1 + ALBEDO_UNIT * off[0],
                0.5 + DEPTH_UNIT * off[1],
                np.ones((32, 32), np.float32),
                {"points": f"{k}", "rows": 32, "noise": 10 ** (noise - 1)},
            )
        )
    found = calibrate(head, scans)
    traits = traits_of(torch.from_numpy(np.stack([made.evidence for made in scans])))
    for coefficients in (found.albedo, found.depth):
        by = found.of(traits, coefficients).exp()[:, 0, 0].detach()
        np.testing.assert_allclose(by, factors, rtol=0.12)
    judged = judge(head, scans, found)["all"]
    assert judged[0] == pytest.approx(0.9, abs=0.005)
    assert judged[3] == pytest.approx(0.9, abs=0.005)


def test_a_calibration_mends_the_line_of_seen() -> None:
    """Logits that are twice too sure, of scans with a lone pixel of evidence each."""
    draw = torch.Generator().manual_seed(5)
    true = 2 * torch.randn(40, PIXELS, generator=draw)
    there = (torch.rand(40, PIXELS, generator=draw) < torch.sigmoid(true)).float()
    traits = torch.randn(40, len(TRAITS), generator=draw)
    none = torch.zeros(PIXELS)
    found = calibrated([Seen(trait, none, none, 2 * x - 1, y) for trait, x, y in zip(traits, true, there, strict=True)])
    slope, offset = (found.of(traits, each)[:, 0, 0] for each in (found.slope, found.offset))
    assert float(slope.mean()) == pytest.approx(0.5, abs=0.03)
    assert float(offset.mean()) == pytest.approx(0.5, abs=0.06)
    assert float(slope.std() + offset.std()) < 0.2, "nothing depends on traits"


def test_a_head_that_was_trained_is_kept_as_safetensors_and_is_the_one_that_is_calibrated(tmp_path: Path) -> None:
    torch.manual_seed(4)
    trained = IntervalHead()
    torch.nn.init.normal_(trained.network.head.weight)
    save_draft(trained, tmp_path)
    with safe_open(tmp_path / "head.safetensors", framework="pt") as file:
        assert set(file.keys()) == set(trained.state_dict())
    evidence = torch.rand(1, len(NAMES), 8, 8)
    with torch.inference_mode():
        for one, other in zip(astuple(trained.eval()(evidence)), astuple(read_back(tmp_path)(evidence)), strict=True):
            assert torch.equal(one, other)


def test_what_it_is_calibrated_on_is_the_refined_picture_that_nano_shows() -> None:
    made, data, _ = scan(CALIBRATION, 0)
    network = build(Settings(), data.wall, data.time)
    assert isinstance(network, Nano)
    picture, evidence = seen_by(network, made)
    counts, exposure = made.counts.astype(np.float32), made.exposure.astype(np.float64)
    shown = reconstruct(Transient(counts, exposure, data.wall, data.time), "nano", explain=False)
    np.testing.assert_allclose(picture.numpy(), shown.albedo, atol=1e-5)
    torch.testing.assert_close(evidence[NAMES.index("albedo")], picture)
    seen = np.isfinite(shown.depth_m)
    depth = evidence[NAMES.index("depth")].numpy() + 0.5
    np.testing.assert_allclose(depth[seen] * data.wall_width_m, shown.depth_m[seen], atol=1e-4)
    assert float(evidence[NAMES.index("brightened")].abs().amax()) > 0.01
    assert float(evidence[NAMES.index("left_asked")].amax()) == 1


def scans(count: int) -> list[tuple[np.ndarray, np.ndarray, Transient]]:
    data = DatasetSettings(seed=977, rows=20, cols=20, degradations=1, held_out=True, detector=CLEAN)
    found = []
    for index in range(count):
        made = sample(data, index)
        scan = Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), data.wall, data.time)
        found.append((made.intensity, made.depth_m, scan))
    return found


@pytest.fixture(scope="module")
def nano() -> list[tuple[np.ndarray, np.ndarray, Transient, Reconstruction]]:
    if head_for("nano") is None:
        pytest.skip("the intervals that ship belong to other weights of NANO: calibrate them anew")
    return [(*known, reconstruct(known[2], "nano", explain=False)) for known in scans(4)]


def test_nanos_intervals_hold_on_scenes_of_kinds_never_seen(
    nano: list[tuple[np.ndarray, np.ndarray, Transient, Reconstruction]],
) -> None:
    scores = []
    for intensity, depth_m, _, made in nano:
        assert made.intervals is not None
        for values in vars(made.intervals).values():
            assert values.shape == (20, 20)
            assert np.isfinite(values).all()
        scores.append(interval_scores(made.albedo, made.depth_m, made.intervals, intensity, depth_m, depth_m > 0))
    for name, least in (("albedo_coverage", 0.7), ("depth_coverage", 0.7)):
        assert least < np.mean([score[name] for score in scores]) <= 1
    assert np.mean([score["depth_width_m"] for score in scores]) < 0.3
    assert np.mean([score["seen_ece"] for score in scores]) < 0.1


@pytest.mark.parametrize(("share", "behind_m"), [(0.3, 0.4), (0.5, 0.15)])
def test_two_surfaces_along_one_line_never_show_as_a_narrow_interval_in_between(share: float, behind_m: float) -> None:
    """A fence that covers a part of each pixel, before a panel: an interval holds one of them, and is wide where both
    are alike bright."""
    if head_for("nano") is None:
        pytest.skip("the intervals that ship belong to other weights of NANO: calibrate them anew")
    wall, time, near_m = WallGrid(2.0, 2.0, 32, 32), TimeAxis(256, 64e-12), 0.7
    x, y = (each.ravel() for each in np.meshgrid(np.linspace(-0.4, 0.4, 96), np.linspace(-0.4, 0.4, 96)))
    where = [np.stack([x, y, np.full_like(x, z)], axis=1) for z in (near_m, near_m + behind_m)]
    area = np.concatenate([np.full_like(x, share), np.full_like(x, 1 - share)]) * (0.8 / 96) ** 2
    facing = np.tile(np.array([0.0, 0.0, -1.0], np.float32), (len(area), 1))
    light = render(
        Surfels(np.concatenate(where).astype(np.float32), facing, area.astype(np.float32)), wall, time
    ).numpy()
    counts = np.random.default_rng(0).poisson(20 * (light / light.max(axis=0).mean() + 0.02)).astype(np.float32)
    made = reconstruct(Transient(counts, np.ones((32, 32)), wall, time), "nano", explain=False).intervals
    assert made is not None
    inside = (np.abs(wall.x_m()) < 0.3)[None, :] & (np.abs(wall.y_m()) < 0.3)[:, None]
    low_m, high_m = made.depth_low_m[inside], made.depth_high_m[inside]
    holds = [(low_m < z + 0.02) & (high_m > z - 0.02) for z in (near_m, near_m + behind_m)]
    assert np.mean(holds[0] | holds[1]) > 0.95
    if share == 0.5:
        assert np.median(high_m - low_m) > behind_m / 2


def test_intervals_are_written_drawn_and_read_back(
    nano: list[tuple[np.ndarray, np.ndarray, Transient, Reconstruction]], tmp_path: Path
) -> None:
    made = nano[0][3]
    assert made.intervals is not None
    paths = write_results(tmp_path / "out", made)
    assert tmp_path / "out" / "uncertainty.png" in paths
    held = read_reconstruction(tmp_path / "out" / "reconstruction.h5").intervals
    assert held is not None
    for name, values in vars(made.intervals).items():
        np.testing.assert_array_equal(getattr(held, name), values)
    doubted = replace(made, intervals=replace(made.intervals, seen=np.zeros_like(made.intervals.seen)))
    assert depth_opacity(made).max() > 0.5
    assert depth_opacity(doubted).max() == 0
    sure = replace(made, intervals=replace(made.intervals, seen=np.ones_like(made.intervals.seen)))
    assert solid_points(sure)[1].max() > 0.9
    assert solid_points(doubted)[1].max() == 0  # faint in 3D, too
    half = np.where(made.wall.x_m() < 0, 1.0, 0.5) * np.ones_like(made.albedo)
    points_m, shade = solid_points(replace(made, intervals=replace(made.intervals, seen=half.astype(np.float32))))
    assert np.allclose(shade, solid_points(sure)[1] * np.where(points_m[:, 0] < 0, 1.0, 0.5))
    write_results(tmp_path / "out", replace(made, intervals=None), overwrite=True)
    assert not (tmp_path / "out" / "uncertainty.png").exists()


def test_intervals_go_with_the_weights_and_the_refinement_whose_pictures_they_were_calibrated_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("nano.safetensors", REFINEMENT, CALIBRATED)
    for name in names:
        shutil.copy(OWN_FOLDER / name, tmp_path / name)
    weights = str(tmp_path / names[0])
    monkeypatch.setattr(intervals, "OWN_FOLDER", tmp_path)
    head_for.cache_clear()
    assert head_for(weights) is not None
    for name in names[:2]:
        held = read_weights(tmp_path / name)
        save(tmp_path / name, {key: x * 1.001 for key, x in held.tensors.items()}, held.about)
        head_for.cache_clear()
        assert head_for(weights) is None, name
        shutil.copy(OWN_FOLDER / name, tmp_path / name)
    (tmp_path / REFINEMENT).unlink()
    head_for.cache_clear()
    assert head_for(weights) is None
    monkeypatch.undo()
    head_for.cache_clear()


def test_noise_alone_is_no_surface_anywhere(
    nano: list[tuple[np.ndarray, np.ndarray, Transient, Reconstruction]],
) -> None:
    scan = nano[0][2]
    for seed, level in ((0, 0.05), (1, 1.0)):
        counts = np.random.default_rng(seed).poisson(level, scan.counts.shape).astype(np.float32)
        made = reconstruct(replace(scan, counts=counts), "nano", explain=False)
        assert made.intervals is not None
        assert float((made.intervals.seen > 0.5).mean()) <= 0.001


def test_what_the_calibration_does_not_cover_has_no_intervals(
    nano: list[tuple[np.ndarray, np.ndarray, Transient, Reconstruction]],
) -> None:
    scan = nano[0][2]
    assert reconstruct(scan, "nano", {"symmetries": False}, explain=False).intervals is None
    assert reconstruct(scan, "nano", {"refine": False}, explain=False).intervals is None
    assert reconstruct(scan, "lct", explain=False).intervals is None
    assert head_for(None) is None
