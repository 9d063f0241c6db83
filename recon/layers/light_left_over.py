"""What measured light says of a picture that explains most of it: pixel by pixel, brighter or darker, nearer or deeper.

The picture's surface is rendered, its gain, a flat background and the width of the response fitted, and what is left of
the light, over its variance, is gathered along the paths of every pixel: the gradient of the misfit, over its own
expectation, so that no unit of counts remains.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.surface_light import Axis, along, arriving, blocks, paths, surface_of

CHANNELS = (
    "albedo", "known", "asked", "depth", "ratio", "change", "step", "depth_step", "certainty", "slope",
    "misfit", "width", "kept",
)  # fmt: skip
FAINT = 0.01  # of the brightest pixel: fainter ones have no depth to start from
AROUND = 2  # pixels around those that are asked about as well
BIN = 0.31  # of a pixel's pitch: the depth of a bin, about
FEWEST_BINS = 8
FITTED = 192  # points that gain, background and width are fitted to
WIDTHS = (0.0, 0.6, 1.0, 1.6, 2.5, 4.0)  # tried for what the response is wider than told, standard deviations in bins
POWERS = (0.0, -0.5, 0.5, -1.0, 1.0, -2.0, 2.0)  # of depth, by which brightness as measured may be off: tried as well
SMOOTH = (0.1, 0.2, 0.4, 0.2, 0.1)
ROUGH = (1 - 0.4) ** 2 + 2 * (
    0.2**2 + 0.1**2
)  # of white noise's variance that is left when its smooth part is taken off
MOST_MISFIT = 100.0  # over what of it is noise
FLOOR = 0.3  # of the mean count: no variance is less
LARGEST = 4.0
MOST_POINTS = 1 << 14  # whose light is looked at: of finer scans not every point is
MOST_PAIRS = 1 << 24  # of such points and pixels: 64 x 64 of each


class LightLeftOver:
    """For scans of this wall and time axis."""

    def __init__(self, wall: WallGrid, time: TimeAxis, falloff: float):
        unit_m = max(wall.width_m, wall.height_m)
        self.falloff, self.pitch = falloff, wall.width_m / wall.cols / unit_m
        self.x = torch.from_numpy(wall.x_m() / unit_m).float()
        self.y = torch.from_numpy(wall.y_m() / unit_m).float()
        depth_per_s = SPEED_OF_LIGHT_M_PER_S / 2 / unit_m
        joined = round(BIN * self.pitch / (time.bin_width_s * depth_per_s))
        self.joined = max(1, min(joined, time.bins // FEWEST_BINS))
        self.axis = Axis(
            time.start_s * depth_per_s, time.bin_width_s * depth_per_s * self.joined, time.bins // self.joined
        )

    def __call__(
        self, counts: Tensor, exposure: Tensor, albedo: Tensor, depth: Tensor, response: Tensor | None
    ) -> Tensor | None:
        """counts (T, H, W), exposure (H, W), 0 = not measured, picture and depth (H, W) in wall widths, and shares of
        light a bin of the counts (K,), K odd, the middle on time -> (len(CHANNELS), H, W); None where there is nothing
        to render or no light that fits."""
        known = torch.isfinite(depth) & (depth > 0) & (albedo > FAINT * albedo.amax())
        if not bool(known.any()):
            return None
        albedo, depth = albedo.float(), depth.float()
        device, bins = counts.device, self.axis.bins
        asked = F.max_pool2d(known.to(albedo)[None], 2 * AROUND + 1, 1, AROUND)[0] > 0
        surface = surface_of(albedo, depth, known, asked, self.x.to(device), self.y.to(device))
        row, col = torch.nonzero(exposure > 0, as_tuple=True)
        measured, taken = len(row), _spread_out(row, col, min(MOST_POINTS, MOST_PAIRS / len(surface.x)))
        row, col = row[taken], col[taken]
        light = counts[: bins * self.joined, row, col].view(bins, self.joined, -1).sum(dim=1).T.contiguous()
        x, y, dwell = self.x.to(device)[col], self.y.to(device)[row], exposure[row, col]
        blur = light.new_tensor(SMOOTH)
        floor = FLOOR * light.mean() + 1e-30

        some = torch.linspace(0, len(row) - 1, min(len(row), FITTED), device=device).long()
        way = paths(surface, x[some], y[some], self.axis, self.falloff)
        farther = (surface.z / surface.z.median()).log()
        taps = light.new_ones(1) if response is None else _joined(response.to(light), self.joined)
        rendered = _spread(arriving(way, surface.albedo, self.axis) * dwell[some, None], taps)
        flat = dwell[some, None].expand_as(rendered)
        fitted = _fitted(
            light[some], [_spread(rendered, _gaussian(width, light)) for width in WIDTHS], flat, blur, floor
        )
        if fitted is None:
            return None
        width = WIDTHS[fitted.which]
        if width > 0:
            taps = _convolved(taps, _gaussian(width, light))
        shown = [
            _spread(arriving(way, surface.albedo * (power * farther).exp(), self.axis) * dwell[some, None], taps)
            for power in POWERS
        ]
        fitted = _fitted(light[some], shown, flat, blur, floor) or fitted
        gain, background = fitted.gain, fitted.background
        shade = (POWERS[fitted.which] * farther).exp()

        missing, expected, information, deeper, certain = (torch.zeros_like(surface.x) for _ in range(5))
        misfit, noise = light.new_zeros(()), light.new_zeros(())
        for part in blocks(len(row), len(surface.x)):
            way = paths(surface, x[part], y[part], self.axis, self.falloff)
            way = way._replace(light=way.light * (dwell[part, None] * shade))
            model = gain * _spread(arriving(way, surface.albedo, self.axis), taps) + background * dwell[part, None]
            weight = 1 / (0.5 * model + 0.5 * _spread(light[part], blur).clamp(min=0) + floor)
            left = light[part] - model
            misfit += (weight * left.square()).sum()
            noise += (weight * (left - _spread(left, blur)).square()).sum() / ROUGH
            back = taps.flip(0)
            here, growth = along(way, _spread(weight * left, back))
            missing += (way.light * here).sum(dim=0)
            expected += (way.light * along(way, _spread(weight * model, back))[0]).sum(dim=0)
            sure = _spread(weight, back).reshape(-1)[way.place]
            information += (way.light.square() * sure).sum(dim=0)
            longer = way.light * way.deeper
            deeper += (longer * growth).sum(dim=0)
            certain += 2 * (longer.square() * sure).sum(dim=0)
        bright = surface.albedo.clamp(min=0.02)
        ratio = missing / expected.clamp(min=1e-30)
        found = {
            "ratio": ratio.clamp(-1, 3),
            "change": (ratio * surface.albedo).clamp(-1, 1),
            "step": (missing / (gain * information).clamp(min=1e-30)).clamp(-LARGEST, LARGEST) / 4,
            "depth_step": (deeper / (gain * bright * certain).clamp(min=1e-30)).clamp(-LARGEST, LARGEST) / 4,
            "certainty": (1e-3 + bright * gain * (information * light.numel() / misfit.clamp(min=1e-30)).sqrt()).log10()
            / 2,
            "slope": (surface.across.square() + surface.up.square()).sqrt().clamp(max=2),
            "depth": surface.z - 0.5,
        }
        flat = torch.ones_like(albedo)
        whole = {
            "albedo": albedo, "known": known.to(albedo), "asked": asked.to(albedo),
            "misfit": flat * (misfit / noise.clamp(min=1e-30)).clamp(0.01, MOST_MISFIT).log10(),
            "width": flat * (width / 4),
            "kept": flat * (math.log2(measured / albedo.numel()) / 6),
        }  # fmt: skip
        for name, values in found.items():
            whole[name] = albedo.new_zeros(albedo.shape).index_put((surface.row, surface.col), values)
        return torch.stack([whole[name] for name in CHANNELS]).nan_to_num(0.0).clamp(-LARGEST, LARGEST)


class Fitted(NamedTuple):
    """Which of several models fits best, and how."""

    which: int
    gain: float
    background: float


def _fitted(light: Tensor, models: Sequence[Tensor], flat: Tensor, blur: Tensor, floor: Tensor) -> Fitted | None:
    """Gain and background of the best by weighted least squares, all (N, T); None where no gain above 0 fits."""
    smooth = _spread(light, blur).clamp(min=0)
    weight = 1 / (0.5 * smooth + 0.5 * smooth.mean(dim=0) + floor)
    best, least = None, math.inf
    for which, shown in enumerate(models):
        power, both, flats = (float((weight * a * b).sum()) for a, b in ((shown, shown), (shown, flat), (flat, flat)))
        of_light, of_flat = float((weight * light * shown).sum()), float((weight * light * flat).sum())
        if not power > 0:
            continue
        determinant = power * flats - both * both
        gain = (of_light * flats - of_flat * both) / determinant if determinant > 1e-9 * power * flats else 0.0
        background = (of_flat - gain * both) / flats
        if background < 0 or gain <= 0:
            gain, background = of_light / power, 0.0
        misfit = float((weight * (light - gain * shown - background * flat).square()).sum())
        if gain > 0 and misfit < least:
            best, least = Fitted(which, gain, background), misfit
    return best


def _spread_out(row: Tensor, col: Tensor, most: float) -> Tensor:
    """Which of the points, so many at most, evenly over the wall: a lattice of the plastic number (Roberts 2018)."""
    share = min(1.0, most / len(row))
    return (row * 0.7548776662466927 + col * 0.5698402909980532) % 1 < share


def _spread(light: Tensor, taps: Tensor) -> Tensor:
    """(N, T) convolved with (K,), K odd, along time."""
    if taps.numel() == 1:
        return light
    kernel = taps.flip(0).to(light)[None, None]
    return F.conv1d(light[:, None], kernel, padding=taps.numel() // 2)[:, 0]


def _gaussian(width: float, like: Tensor) -> Tensor:
    if width == 0:
        return like.new_ones(1)
    half = max(1, math.ceil(3 * width))
    shares = torch.exp(-0.5 * (torch.arange(-half, half + 1, device=like.device) / width).square())
    return (shares / shares.sum()).to(like)


def _convolved(a: Tensor, b: Tensor) -> Tensor:
    """Of two responses, as long as both."""
    return F.conv1d(F.pad(a, (len(b) - 1, len(b) - 1))[None, None], b.flip(0)[None, None])[0, 0]


def _joined(response: Tensor, factor: int) -> Tensor:
    """Shares a bin, of bins so many times wider; the middle stays on time."""
    half = len(response) // 2
    at = (torch.arange(len(response), device=response.device) - half) / factor
    wide = math.ceil(half / factor)
    out = response.new_zeros(2 * wide + 2)
    lower = at.floor()
    place = lower.long() + wide
    out.scatter_add_(0, place, response * (1 - (at - lower))).scatter_add_(0, place + 1, response * (at - lower))
    return out[:-1]
