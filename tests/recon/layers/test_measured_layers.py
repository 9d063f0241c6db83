"""U-Nets, liftings, noise estimation and projection: shapes at odd sizes, and what each must never do."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers import wiener_volumes
from nlos.recon.layers.noise_level import NoiseLevel, averaged
from nlos.recon.layers.rates import fill, presence, rates_of
from nlos.recon.layers.transient_lifting import TransientLifting
from nlos.recon.layers.unet import UNet
from nlos.recon.layers.volume_projection import AttentionProjection, MaximumProjection, summed_along_depth
from nlos.recon.layers.wiener_volumes import VOLUMES, WienerVolumes

WALL = WallGrid(2.0, 2.0, 12, 12)
TIME = TimeAxis(64, 128e-12)


def counts(rate: float, shape: tuple[int, ...], seed: int = 0) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(seed).poisson(rate, shape).astype(np.float32))


def signal(photons: float = 5.0, seed: int = 0) -> torch.Tensor:
    """A shell of light whose delay grows away from one wall point, (1, 1, 64, 12, 12)."""
    row, col = np.indices((12, 12))
    distance = np.hypot(1.0, np.hypot(row - 4, col - 7) / 6)
    arrival = distance * 2 / 299792458.0 / 128e-12
    bins = np.arange(64)[:, None, None]
    rate = photons * np.exp(-0.5 * (bins - arrival) ** 2) + 0.05
    return torch.from_numpy(np.random.default_rng(seed).poisson(rate).astype(np.float32))[None, None]


@pytest.mark.parametrize(("dimensions", "size"), [(1, (13,)), (2, (9, 7)), (3, (9, 6, 5))])
def test_a_unet_gives_back_odd_sizes(dimensions: int, size: tuple[int, ...]) -> None:
    assert UNet(dimensions, 2, 3, (4, 6, 8))(torch.randn(1, 2, *size)).shape == (1, 3, *size)


def test_a_strided_unet_lives_on_the_coarser_grid() -> None:
    assert UNet(3, 1, 2, (4, 6), stride=(1, 2, 2))(torch.randn(1, 1, 8, 7, 9)).shape == (1, 2, 8, 4, 5)


@pytest.mark.parametrize("kind", ["mlp", "global", "local", "both"])
def test_every_lifting_makes_four_channels_on_half_the_wall(kind: str) -> None:
    lifting = TransientLifting(kind)  # type: ignore[arg-type]
    out = lifting(torch.randn(2, 1, 17, 7, 10))
    assert out.shape == (2, 4, 17, 4, 5)
    out.square().mean().backward()
    assert all(p.grad is not None for p in lifting.parameters())


def test_filling_leaves_a_whole_scan_alone_and_keeps_a_constant_over_gaps() -> None:
    whole = torch.ones(1, 12, 12)
    x = counts(3.0, (1, 1, 5, 12, 12))
    torch.testing.assert_close(fill(x, whole), x)
    sparse = torch.zeros(1, 12, 12)
    sparse[:, 1::4, 2::4] = 2.0
    torch.testing.assert_close(
        fill(6.0 * sparse[:, None, None].expand(1, 1, 5, 12, 12), sparse), torch.full((1, 1, 5, 12, 12), 6.0)
    )


def test_filling_does_not_move_anything() -> None:
    sparse = torch.zeros(1, 12, 12)
    sparse[:, ::3, ::3] = 1
    ramp = torch.arange(12.0)[None, None, None, :, None].expand(1, 1, 1, 12, 12) * sparse[:, None, None]
    filled = fill(ramp, sparse)[0, 0, 0]
    assert abs(float(filled[3:7].mean()) - 4.5) < 0.2


@pytest.mark.parametrize("rate", [0.01, 1.0, 30.0])
@pytest.mark.parametrize("unit", [1.0, 7.0, 1e-3])
def test_noise_alone_is_no_signal_in_any_count_unit(rate: float, unit: float) -> None:
    assert float(presence(unit * counts(rate, (1, 1, 64, 12, 12)), torch.ones(1, 12, 12))) == 0


@pytest.mark.parametrize("level", [0.1, 1.0, 10.0])
@pytest.mark.parametrize(("ramp", "piled_up"), [(0.03, 0.0), (0.0, 0.3), (0.02, 0.2)])
def test_background_that_changes_slowly_along_the_histogram_is_no_signal(
    level: float, ramp: float, piled_up: float
) -> None:
    t = torch.linspace(0, 1, 256)
    rate = level * (1 + ramp * (1 - 2 * t)) * torch.exp(-piled_up * t)
    noise = torch.poisson(rate[:, None, None].expand(256, 32, 32), generator=torch.Generator().manual_seed(4))
    assert float(presence(noise[None, None], torch.ones(1, 32, 32))) == 0


def test_a_signal_is_one_in_any_count_unit() -> None:
    for unit in (1.0, 7.0, 1e-3):
        assert float(presence(unit * signal(), torch.ones(1, 12, 12))) == 1


def test_rates_do_not_depend_on_the_units_of_counts_or_exposure() -> None:
    exposure = 0.5 + torch.rand(1, 12, 12)
    one, other = rates_of(signal(), exposure), rates_of(7 * signal(), 1000 * exposure)
    torch.testing.assert_close(one.net, other.net)
    torch.testing.assert_close(one.background, other.background)


def test_strong_background_behind_bins_that_were_cut_does_not_hide_the_signal() -> None:
    lit = 20 * signal(photons=20.0)
    ambient = torch.poisson(torch.full_like(lit, 30.0), generator=torch.Generator().manual_seed(2))
    cut = lit + ambient
    cut[:, :, :20] = 0
    rates = rates_of(cut, None)
    assert float(rates.presence) > 0.2
    assert float(rates.net.mean()) == pytest.approx(1.0, rel=1e-3)


def test_whatever_stands_where_nothing_was_measured_is_not_looked_at() -> None:
    exposure = torch.ones(1, 12, 12)
    exposure[:, ::3] = 0
    one = rates_of(signal() * (exposure > 0), exposure)
    for garbage in (1e6, torch.nan):
        held = torch.where(exposure > 0, signal(), garbage)
        other = rates_of(held, exposure)
        for name in ("net", "unfilled", "raw", "background", "presence"):
            torch.testing.assert_close(getattr(other, name), getattr(one, name))


@pytest.mark.parametrize(("share", "ambient"), [(0.2, 0.0), (0.6, 3.0)])
def test_background_is_what_is_there_without_light(share: float, ambient: float) -> None:
    """Of light that fills a part of the record, and of light alone. It comes to each row at its own time: to all at
    once and as level, between bins that are 0, it would be ambient light of a gated detector."""
    expected = torch.full((1, 1, 200, 12, 12), ambient)
    for row in range(12):
        first = 20 + 2 * row
        expected[:, :, first : first + round(200 * share), row] += 2.0
    rates = rates_of(torch.poisson(expected, generator=torch.Generator().manual_seed(1)), None)
    level = 2.0 * share  # the unit: of a voxel on average, without background
    assert float(rates.background) == pytest.approx(ambient / level, abs=0.1)


def test_an_empty_measurement_has_no_signal_and_finite_rates() -> None:
    rates = rates_of(torch.zeros(1, 1, 64, 12, 12), None)
    assert float(rates.presence) == 0
    assert torch.isfinite(rates.net).all()


def test_wiener_volumes_flip_with_the_wall_and_have_metric_depths() -> None:
    physics = WienerVolumes(WALL, TIME)
    rates, flipped = rates_of(signal(), None), rates_of(signal().flip(4), None)
    level = torch.tensor([-1.0])
    volume = physics(rates, level)
    assert volume.shape == (1, VOLUMES, physics.slices, 12, 12)
    torch.testing.assert_close(physics(flipped, level), volume.flip(4), rtol=1e-3, atol=1e-3)
    brightest = physics.depths[int(volume[0, 0].amax(dim=(1, 2)).argmax())] * physics.unit_m
    assert abs(float(brightest) - 1.0) < 0.05


def test_the_volume_of_unfilled_rates_differs_from_the_filled_one_where_points_are_missing_only() -> None:
    physics, level = WienerVolumes(WALL, TIME), torch.tensor([-1.0, -1.0])
    exposure = torch.ones(2, 12, 12)
    whole = physics(rates_of(signal().repeat(2, 1, 1, 1, 1), exposure), level)
    torch.testing.assert_close(whole[:, 2], whole[:, 1])
    exposure[1, :, 1::2] = 0
    rates = rates_of(signal().repeat(2, 1, 1, 1, 1), exposure)
    assert rates.unfilled[1, 0, :, :, 1::2].abs().max() == 0 < rates.net[1, 0, :, :, 1::2].abs().max()
    part = physics(rates, level)
    torch.testing.assert_close(part[0], whole[0], rtol=1e-4, atol=1e-5)
    assert (part[1, 2] - part[1, 1]).abs().max() > 0.1 * part[1, 1].abs().max()
    alike = physics(replace(rates, unfilled=rates.net), level)  # no more than the noise that gaps stand for
    assert (part[1, 2] - alike[1, 2]).abs().max() > 0.1 * alike[1, 2].abs().max()


@pytest.mark.parametrize("first", [0, 11])
def test_slices_reach_from_the_wall_or_the_first_bin_to_the_last(first: int) -> None:
    physics = WienerVolumes(WALL, TimeAxis(64, 128e-12, first * 128e-12))
    half = physics.pitch[0] / 2
    bin_depth = 299792458.0 * 128e-12 / 2 / 2.0
    assert float(physics.depths[0]) - half == pytest.approx(first * bin_depth, abs=1e-6)
    assert float(physics.depths[-1]) + half == pytest.approx((first + 64) * bin_depth, abs=1e-6)
    far = WienerVolumes(WALL, TimeAxis(4000, 32e-12, first * 1e-9))
    assert 2.0 <= float(far.depths[-1]) + far.pitch[0] / 2 < 2.0 + 0.01  # wall widths: no light comes from behind


def test_of_retroreflective_surfaces_less_is_undone() -> None:
    """Light that falls with r^2: the far one of two equal sheets is not made the brighter one."""
    rate = torch.full((1, 1, 64, 12, 12), 0.01)
    for bin_, metres in ((26, 0.5), (58, 1.1)):
        rate[:, :, bin_] += 40 / metres**2
    rates = rates_of(torch.poisson(rate, generator=torch.Generator().manual_seed(1)), None)

    def far_over_near(falloff: float) -> float:
        physics = WienerVolumes(WALL, TIME, falloff)
        volume = physics(rates, torch.tensor([-1.0]))[0, 1, :, 3:9, 3:9].mean(dim=(1, 2))
        near = physics.depths * physics.unit_m < 0.8
        return float(volume[~near].max() / volume[near].max())

    assert 1.0 < far_over_near(4.0) / far_over_near(2.0) < 10


def test_fine_bins_are_added_until_they_match_the_wall() -> None:
    physics = WienerVolumes(WallGrid(0.7, 0.7, 12, 12), TimeAxis(500, 4e-12))
    assert physics.factor == 5
    x = counts(1.0, (1, 1, 500, 12, 12))
    assert physics.rebin(x).sum() == x.sum()
    odd = WienerVolumes(WallGrid(0.7, 0.7, 12, 12), TimeAxis(498, 4e-12))
    torch.testing.assert_close(odd.rebin(x[:, :, :498])[:, :, :99], physics.rebin(x)[:, :, :99])
    assert odd.rebin(x[:, :, :498])[0, 0, 99].sum() == x[:, :, 495:498].sum()
    assert WienerVolumes(WallGrid(0.7, 0.7, 12, 12), TimeAxis(2000, 16e-12)).bins < 2000  # no light comes from there


def test_frequencies_held_a_few_at_a_time_change_no_volume(monkeypatch: pytest.MonkeyPatch) -> None:
    rates, level = rates_of(signal(), None), torch.tensor([-1.0])
    whole = WienerVolumes(WALL, TIME)(rates, level)
    monkeypatch.setattr(wiener_volumes, "SPECTRUM_BYTES", 5 * 16 * 12 * 12)
    tiled = WienerVolumes(WALL, TIME)
    assert tiled.inverse.cone.filter.tile == 5
    torch.testing.assert_close(tiled(rates, level), whole, rtol=1e-4, atol=1e-6 * float(whole.abs().max()))


def test_the_noise_map_is_infinite_where_nothing_was_measured_and_falls_with_dwell() -> None:
    network = NoiseLevel(widths=(4, 6, 8))
    exposure = torch.ones(1, 12, 12)
    exposure[:, :, 6:] = 4.0
    exposure[:, 3] = 0
    level, noise = network(signal(), exposure)
    assert level.shape == (1,)
    assert torch.isinf(noise[:, 3]).all()
    assert torch.isfinite(noise[:, 4]).all()


def test_the_maximum_projection_is_the_front_view() -> None:
    u = torch.rand(1, 5, 4, 4)
    seen = MaximumProjection(finish=False)(u, torch.arange(5.0))
    torch.testing.assert_close(seen.albedo, u.amax(dim=1))
    torch.testing.assert_close(seen.depth, u.argmax(dim=1).float())


def test_attention_is_one_along_depth_and_starts_at_the_prior() -> None:
    projection = AttentionProjection(2, 3, 1, widths=(4, 6))
    volumes = torch.zeros(1, 2, 8, 6, 6)
    volumes[:, :, 3] = 4.0
    logits, features = torch.zeros(1, 4, 3, 3), torch.randn(1, 3, 4, 3, 3)
    torch.testing.assert_close(projection.attention(logits, volumes).sum(dim=1), torch.ones(1, 6, 6))
    seen = projection(logits, features, volumes, torch.ones(1, 1, 6, 6), torch.arange(8.0))
    torch.testing.assert_close(seen.depth, torch.full((1, 6, 6), 3.0), atol=1e-2, rtol=0)
    torch.testing.assert_close(seen.albedo, torch.full((1, 6, 6), 3.2), atol=1e-2, rtol=0)
    assert seen.volume.shape == (1, 8, 6, 6)


def test_the_profile_is_the_volumes_around_the_most_attended_depth_and_stops_at_the_ends() -> None:
    projection = AttentionProjection(2, 3, 1, widths=(4, 6), reach=1)
    slices = torch.arange(5.0)[None, None, :, None, None]
    volumes = torch.cat((slices, 10 * slices), dim=1).expand(1, 2, 5, 6, 6)
    weight = torch.zeros(1, 5, 6, 6)
    weight[:, 2], weight[:, 2, 0, 0], weight[:, 4, 0, 0] = 1.0, 0.0, 1.0
    (profile,) = projection.profile(weight, volumes)
    assert profile.shape == (1, 6, 6, 6)
    assert profile[0, :, 3, 3].tolist() == [1, 2, 3, 10, 20, 30]
    assert profile[0, :, 0, 0].tolist() == [3, 4, 4, 30, 40, 40]
    assert AttentionProjection(2, 3, 1, widths=(4, 6)).profile(weight, volumes) == []


def test_box_averages_are_those_of_pooling() -> None:
    field = torch.rand(2, 1, 20, 9, 7, generator=torch.Generator().manual_seed(0))
    for bins, points in ((5, 3), (9, 5), (1, 1)):
        window, padding = (bins, points, points), (bins // 2, points // 2, points // 2)
        pooled = torch.nn.functional.avg_pool3d(field, window, stride=1, padding=padding)
        torch.testing.assert_close(averaged(field, bins, points), pooled)


@pytest.mark.parametrize("side", [6, 12])
def test_sums_along_depth_are_the_same_where_nothing_is_learned(side: int) -> None:
    weight, fields = torch.softmax(torch.randn(2, 10, 12, 12), dim=1), torch.randn(2, 3, 10, side, side)
    learned = summed_along_depth(weight.requires_grad_(), fields)
    with torch.inference_mode():
        plain = summed_along_depth(weight, fields.contiguous(memory_format=torch.channels_last_3d))
    torch.testing.assert_close(plain, learned.detach(), rtol=0, atol=1e-6)
    assert learned.requires_grad
