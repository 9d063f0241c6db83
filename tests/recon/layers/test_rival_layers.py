"""Layers of LFE and NLOST against their formulas."""

import math

import pytest
import torch
import torch.nn.functional as F

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.light_cone_layer import LightConeLayer
from nlos.recon.layers.noise_adapted import piecewise
from nlos.recon.layers.renderer import Renderer, depth_of, nearness, projected, where_seen
from nlos.recon.layers.space_depth_attention import Attention, CompactNonLocal, CrossDecoder, LocalEncoder
from nlos.recon.layers.transient_encoder import LearnedAverage, TransientEncoder
from nlos.recon.layers.wiener_features import WienerFeatures, background_rate, counted, unit


def test_the_learned_average_begins_as_a_plain_one() -> None:
    x = torch.rand(2, 1, 8, 6, 4)
    torch.testing.assert_close(LearnedAverage(1, 1, (2, 2, 2))(x), F.avg_pool3d(x, 2))
    torch.testing.assert_close(LearnedAverage(1, 1, (2, 1, 1))(x), F.avg_pool3d(x, (2, 1, 1)))
    assert TransientEncoder(3, (2, 1, 1))(x).shape == (2, 4, 4, 6, 4)


def test_the_renderer_begins_with_its_base() -> None:
    maps = torch.rand(1, 8, 6, 5)
    for base, chosen in ((0, 0), (1, 4)):
        renderer = Renderer(8, base)
        torch.nn.init.zeros_(renderer.fine[-1].weight)
        torch.nn.init.zeros_(renderer.fine[-1].bias)
        torch.testing.assert_close(renderer(maps, (6, 5)), maps[:, chosen])


def test_published_width_gives_the_published_parameter_count() -> None:
    # 28,413 in all with C = 3 (lfe.md): encoder 1,095, two renderers of 13,659 each
    assert sum(p.numel() for p in TransientEncoder(3, (2, 2, 2)).parameters()) == 1_095
    assert sum(p.numel() for p in Renderer(8, 0).parameters()) == 13_659


def test_projection_finds_the_brightest_voxel_softly_and_hard() -> None:
    volume = torch.zeros(1, 1, 11, 1, 1)
    volume[0, 0, 2] = 1.0
    place = nearness(torch.linspace(0.5, 1.5, 11), (0.5, 1.5))
    hard = projected(volume, None, place)
    assert hard.flatten().tolist() == pytest.approx([1.0, 0.8])
    soft = projected(volume, torch.tensor([50.0]), place)
    assert soft.flatten().tolist() == pytest.approx([1.0, 0.8], abs=1e-6)
    assert float(depth_of(place[2], (0.5, 1.5))) == pytest.approx(0.7)


def test_depth_is_nowhere_where_the_picture_is_dark() -> None:
    albedo, depth = torch.tensor([[[1.0, 0.001]]]), torch.ones(1, 1, 2)
    assert torch.isnan(where_seen(albedo, depth, training=False))[0, 0].tolist() == [False, True]
    assert torch.isfinite(where_seen(albedo, depth, training=True)).all()


def test_attention_is_softmax_of_scaled_products_and_relative_bias() -> None:
    torch.manual_seed(0)
    attention = Attention(8, 2, (3, 4))
    x = torch.randn(5, 6, 8)  # windows of 2 x 3, smaller than the table's
    q, k, v = attention.qkv(x).reshape(5, 6, 3, 2, 4).permute(2, 0, 3, 1, 4)
    bias = torch.empty(2, 6, 6)
    for a in range(6):
        for b in range(6):
            i, j = a // 3 - b // 3 + 2, a % 3 - b % 3 + 3
            bias[:, a, b] = attention.table[i * 7 + j]
    expected = torch.softmax(q @ k.transpose(-1, -2) / math.sqrt(4) + bias, dim=-1) @ v
    torch.testing.assert_close(attention(x, (2, 3)), attention.out(expected.transpose(1, 2).reshape(5, 6, 8)))


def test_windows_do_not_see_each_other() -> None:
    torch.manual_seed(0)
    encoder = LocalEncoder(8, 2, window=4)
    x = torch.randn(1, 8, 3, 8, 10)
    changed = x.clone()
    changed[..., :4, :4] += 1
    same = encoder(x) - encoder(changed)
    assert same[..., :4, :4].abs().max() > 1e-3
    assert same[..., 4:, :].abs().max() < 1e-5
    assert same[..., :4, 4:].abs().max() < 1e-5
    with pytest.raises(ValueError, match="depth tokens"):
        encoder(torch.randn(1, 8, 65, 4, 4))


def test_the_cross_decoder_begins_without_the_other_branch() -> None:
    own, other = torch.randn(1, 8, 3, 4, 4), torch.randn(1, 8, 3, 4, 4)
    block = CompactNonLocal(8, 2)
    assert not block(torch.randn(2, 8, 5), torch.randn(2, 8, 5)).any()
    decoder = CrossDecoder(8, 2)
    value = decoder.norm_own(own.permute(0, 2, 3, 4, 1)).permute(0, 4, 1, 2, 3)
    torch.testing.assert_close(decoder(own, other), decoder(own, -other))
    del value
    assert not torch.equal(CrossDecoder(8, 2, doubled=True)(own, other), own)


WALL, TIME = WallGrid(2.0, 2.0, 16, 16), TimeAxis(128, 128e-12)


def test_features_mirror_with_the_scan_and_keep_a_points_place() -> None:
    layer = LightConeLayer(WALL, TIME)
    torch.manual_seed(0)
    x = torch.rand(1, 1, 128, 16, 16)
    exponent, snr = torch.tensor([2.0]), torch.tensor([[0.3]])
    flipped = layer(x.flip(3, 4), exponent, snr).flip(3, 4)
    torch.testing.assert_close(flipped, layer(x, exponent, snr), rtol=1e-3, atol=1e-5)


def test_the_layer_has_the_gradient_of_its_formula() -> None:
    layer = LightConeLayer(WallGrid(2.0, 2.0, 6, 6), TimeAxis(32, 512e-12))
    torch.manual_seed(0)
    x = torch.rand(1, 2, 32, 6, 6, requires_grad=True)
    exponent, snr = torch.tensor([2.5]), torch.tensor([[0.3, 1.0]])
    weight = torch.randn_like(layer(x, exponent, snr))
    (layer(x, exponent, snr) * weight).sum().backward()
    assert x.grad is not None
    direction = torch.randn_like(x)
    with torch.no_grad():
        slope = ((layer(x + direction, exponent, snr) - layer(x, exponent, snr)) * weight).sum()  # linear
    assert float((x.grad * direction).sum()) == pytest.approx(float(slope), rel=1e-3)


def test_features_do_not_depend_on_bin_width_or_wall_unit() -> None:
    torch.manual_seed(0)
    fine = torch.poisson(torch.rand(1, 1, 256, 16, 16))
    coarse = fine.reshape(1, 1, 128, 2, 16, 16).sum(dim=3)
    wide = WienerFeatures(WALL, TIME)(coarse, None).volumes
    half = WienerFeatures(WallGrid(1.0, 1.0, 16, 16), TimeAxis(128, 64e-12))(coarse, None).volumes
    torch.testing.assert_close(half, wide, rtol=1e-3, atol=1e-3)
    assert WienerFeatures(WALL, TimeAxis(512, 32e-12)).together == 2
    assert WienerFeatures(WALL, TimeAxis(256, 64e-12))(fine, None).volumes.shape == wide.shape


def test_background_is_found_beside_a_signal_and_cut_bins() -> None:
    torch.manual_seed(0)
    rate = torch.full((1, 1, 256, 16, 16), 0.4)
    rate[:, :, 100:180] += 5
    rate[:, :, :16] = 0
    counts = torch.poisson(rate)
    assert float(background_rate(counts, torch.ones(1, 16, 16))[0]) == pytest.approx(0.4, rel=0.1)
    seen = counted(counts, None)
    assert float(seen.net[0]) == pytest.approx(400, rel=0.05)


def test_a_transient_in_other_units_is_taken_as_noiseless_and_counts_are_not() -> None:
    torch.manual_seed(0)
    rate = torch.zeros(1, 1, 256, 16, 16)
    rate[:, :, 100:110] = torch.hann_window(10)[:, None, None]
    assert float(unit(rate)[0]) == pytest.approx(20_000 / float(rate.max()))
    for level in (0.3, 3.0, 300.0):
        assert float(unit(torch.poisson(rate * level + 0.01))[0]) == 1


def test_interpolation_is_constant_beyond_its_knots() -> None:
    x = torch.tensor([-1.0, 0.0, 0.5, 1.5, 9.0])
    assert piecewise(x, (0.0, 1.0, 2.0), (1.0, 3.0, 4.0)).tolist() == pytest.approx([1.0, 1.0, 2.0, 3.5, 4.0])
