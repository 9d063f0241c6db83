"""What measured light says of a picture that explains most of it: pixel by pixel, brighter or darker, nearer or deeper.

The picture's surface is rendered, its gain, a flat background and the width of the response fitted, and what is left of
the light, over its variance, is gathered along the paths of every pixel: the gradient of the misfit, over its own
expectation, so that no unit of counts remains.
"""

import math
from collections.abc import Sequence
from functools import partial, reduce
from typing import NamedTuple

import torch
import torch.nn.functional as F
from torch import Tensor

from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S, TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.layers.response_taps import convolved, gaussian, joined_bins, spread
from nlos.recon.layers.side_by_side import side_by_side
from nlos.recon.layers.surface_light import Axis, Surface, along, arriving, blocks, paths, surface_of

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
WIDEST = 3.0  # wider ones: such light is not this surface's through the response that was told
POWERS = (0.0, -0.5, 0.5, -1.0, 1.0, -2.0, 2.0)  # of depth, by which brightness as measured may be off: tried as well
SMOOTH = (0.1, 0.2, 0.4, 0.2, 0.1)
ROUGH = (1 - 0.4) ** 2 + 2 * (0.2**2 + 0.1**2)  # of white noise's variance, left when its smooth part is taken off
MOST_MISFIT = 100.0  # over what of it is noise
FLOOR = 0.3  # of the mean count: no variance is less
LARGEST = 4.0
MOST_POINTS = 1 << 14  # whose light is looked at: of finer scans not every point is
MOST_PAIRS = 1 << 24  # of such points and pixels: 64 x 64 of each


class LightLeftOver:
    """For scans of this wall and time axis."""

    def __init__(self, wall: WallGrid, time: TimeAxis, falloff: float):
        unit_m = wall.longer_m
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
        asked = F.max_pool2d(known.to(albedo)[None], 2 * AROUND + 1, 1, AROUND)[0] > 0
        surface = surface_of(albedo, depth, known, asked, self.x.to(albedo), self.y.to(albedo))
        seen = self._seen(counts, exposure, MOST_PAIRS / len(surface.x))
        shown = self._fitted(surface, seen, response)
        if shown is None:
            return None
        sums = self._gathered(surface, seen, shown)
        everywhere = torch.ones_like(albedo)
        found = {
            "albedo": albedo, "known": known.to(albedo), "asked": asked.to(albedo),
            "misfit": everywhere * (sums.misfit / sums.noise.clamp(min=1e-30)).clamp(0.01, MOST_MISFIT).log10(),
            "width": everywhere * (shown.width / 4),
            "kept": everywhere * (math.log2(int((exposure > 0).sum()) / albedo.numel()) / 6),
        }  # fmt: skip
        for name, values in _on_surface(surface, shown.gain, sums, seen.light.numel()).items():
            found[name] = albedo.new_zeros(albedo.shape).index_put((surface.row, surface.col), values)
        return torch.stack([found[name] for name in CHANNELS]).nan_to_num(0.0).clamp(-LARGEST, LARGEST)

    def _seen(self, counts: Tensor, exposure: Tensor, most: float) -> "Seen":
        """What was measured at up to `most` points."""
        row, col = torch.nonzero(exposure > 0, as_tuple=True)
        taken = _spread_out(row, col, min(MOST_POINTS, most))
        row, col = row[taken], col[taken]
        bins = self.axis.bins
        light = counts[: bins * self.joined, row, col].view(bins, self.joined, -1).sum(dim=1).T.contiguous()
        return Seen(light, self.x.to(light)[col], self.y.to(light)[row], exposure[row, col])

    def _fitted(self, surface: Surface, seen: "Seen", response: Tensor | None) -> "Shown | None":
        """How bright the surface is rendered and through what response; None where no brightness fits, or only that of
        a much slower response."""
        light = seen.light
        some = torch.linspace(0, len(light) - 1, min(len(light), FITTED), device=light.device).long()
        way = paths(surface, seen.x[some], seen.y[some], self.axis, self.falloff)
        dwell, floor = seen.dwell[some, None], seen.floor()
        farther = (surface.z / surface.z.median()).log()
        taps = light.new_ones(1) if response is None else joined_bins(response.to(light), self.joined)

        def rendered(albedo: Tensor) -> Tensor:
            return spread(arriving(way, albedo, self.axis) * dwell, taps)

        quick = rendered(surface.albedo)
        background = dwell.expand_as(quick)
        models = [spread(quick, gaussian(width, light)) for width in WIDTHS]
        fitted = _best(light[some], models, background, floor)
        if fitted is None:
            return None
        width = WIDTHS[fitted.which]
        if width > WIDEST:
            return None
        if width > 0:
            taps = convolved(taps, gaussian(width, light))
        models = [rendered(surface.albedo * (power * farther).exp()) for power in POWERS]
        fitted = _best(light[some], models, background, floor) or fitted
        return Shown(taps, width, (POWERS[fitted.which] * farther).exp(), fitted.gain, fitted.background)

    def _gathered(self, surface: Surface, seen: "Seen", shown: "Shown") -> "Sums":
        """The light that is left, along the paths of every pixel."""
        points = blocks(len(seen.light), len(surface.x), seen.light.device)
        parts = side_by_side([partial(self._of_points, surface, seen, shown, part) for part in points], seen.light)
        return reduce(lambda one, other: Sums(*(a + b for a, b in zip(one, other, strict=True))), parts)

    def _of_points(self, surface: Surface, seen: "Seen", shown: "Shown", part: slice) -> "Sums":
        """The same of some points."""
        light, dwell, blur, back = seen.light[part], seen.dwell[part, None], seen.blur(), shown.taps.flip(0)
        way = paths(surface, seen.x[part], seen.y[part], self.axis, self.falloff)
        way = way._replace(light=way.light * (dwell * shown.shade))
        model = shown.gain * spread(arriving(way, surface.albedo, self.axis), shown.taps) + shown.background * dwell
        weight = 1 / (0.5 * model + 0.5 * spread(light, blur).clamp(min=0) + seen.floor())
        left = light - model
        here, growth = along(way, spread(weight * left, back))
        sure = spread(weight, back).reshape(-1)[way.place]
        longer = way.light * way.deeper
        return Sums(
            missing=(way.light * here).sum(dim=0),
            expected=(way.light * along(way, spread(weight * model, back))[0]).sum(dim=0),
            information=(way.light.square() * sure).sum(dim=0),
            deeper=(longer * growth).sum(dim=0),
            certain=2 * (longer.square() * sure).sum(dim=0),
            misfit=(weight * left.square()).sum(),
            noise=(weight * (left - spread(left, blur)).square()).sum() / ROUGH,
        )


class Seen(NamedTuple):
    """The light of some points, (N, T), where they are on the wall in its widths, and how long each was looked at."""

    light: Tensor
    x: Tensor
    y: Tensor
    dwell: Tensor

    def floor(self) -> Tensor:
        """Of a variance, counts."""
        return FLOOR * self.light.mean() + 1e-30

    def blur(self) -> Tensor:
        return self.light.new_tensor(SMOOTH)


class Shown(NamedTuple):
    """How the surface's light is rendered: response (K,), what it is wider than told in bins, what every pixel's
    brightness is multiplied by, (P,), and counts a unit of light and of exposure."""

    taps: Tensor
    width: float
    shade: Tensor
    gain: float
    background: float


class Sums(NamedTuple):
    """Over all points, weighted by their variance: of each pixel (P,), and of the whole scan."""

    missing: Tensor
    expected: Tensor
    information: Tensor
    deeper: Tensor
    certain: Tensor
    misfit: Tensor
    noise: Tensor


def _on_surface(surface: Surface, gain: float, sums: Sums, bins: int) -> dict[str, Tensor]:
    """The channels that only pixels of the surface have, (P,); `bins`: of all points together."""
    bright = surface.albedo.clamp(min=0.02)
    ratio = sums.missing / sums.expected.clamp(min=1e-30)
    certainty = bright * gain * (sums.information * bins / sums.misfit.clamp(min=1e-30)).sqrt()
    step = sums.missing / (gain * sums.information).clamp(min=1e-30)
    depth_step = sums.deeper / (gain * bright * sums.certain).clamp(min=1e-30)
    return {
        "ratio": ratio.clamp(-1, 3),
        "change": (ratio * surface.albedo).clamp(-1, 1),
        "step": step.clamp(-LARGEST, LARGEST) / 4,
        "depth_step": depth_step.clamp(-LARGEST, LARGEST) / 4,
        "certainty": (1e-3 + certainty).log10() / 2,
        "slope": (surface.across.square() + surface.up.square()).sqrt().clamp(max=2),
        "depth": surface.z - 0.5,
    }


class Fitted(NamedTuple):
    """Which of several models fits best, and how."""

    which: int
    gain: float
    background: float


def _best(light: Tensor, models: Sequence[Tensor], flat: Tensor, floor: Tensor) -> Fitted | None:
    """Gain and background of the best by weighted least squares, all (N, T); None where no gain above 0 fits. The sums
    that say so are brought from the device at once."""
    smooth = spread(light, light.new_tensor(SMOOTH)).clamp(min=0)
    weight = (1 / (0.5 * smooth + 0.5 * smooth.mean(dim=0) + floor)).double()
    shown, light, flat = torch.stack(list(models)).double(), light.double(), flat.double()
    pairs = ((shown, shown), (shown, flat), (flat, flat), (light, shown), (light, flat), (light, light))
    sums = [(weight * a * b).sum(dim=(-2, -1)).expand(len(models)) for a, b in pairs]
    best, least = None, math.inf
    for which, (power, both, flats, of_light, of_flat, whole) in enumerate(torch.stack(sums, dim=1).tolist()):
        if not power > 0:
            continue
        determinant = power * flats - both * both
        gain = (of_light * flats - of_flat * both) / determinant if determinant > 1e-9 * power * flats else 0.0
        background = (of_flat - gain * both) / flats
        if background < 0 or gain <= 0:
            gain, background = of_light / power, 0.0
        kept = gain * (gain * power - 2 * of_light) + background * (background * flats - 2 * of_flat)
        misfit = whole + kept + 2 * gain * background * both
        if gain > 0 and misfit < least:
            best, least = Fitted(which, gain, background), misfit
    return best


def _spread_out(row: Tensor, col: Tensor, most: float) -> Tensor:
    """Which of the points, so many at most, evenly over the wall: a lattice of the plastic number (Roberts 2018)."""
    share = min(1.0, most / len(row))
    return (row * 0.7548776662466927 + col * 0.5698402909980532) % 1 < share
