"""How much of the light a picture explains: of light that it was not made from, by what its surface would send.

The scan is thinned into two parts with independent noise. The same method sees one of them, on half the grid; the
surface that it finds is rendered, with the response where one is known; its gain, a flat background and what the
response is wider are fitted to that part, and the other part judges: 1 - |light - rendered|^2 / |light - background|^2,
each over its variance, with what photon noise adds to either taken off. 1 is all there is to explain, 0 no better than
an empty scene. A pixel so near that it lights but the point in front of it explains that point, whatever the wall: such
pixels do not count where they outshine the rest. If nothing is left, or half the grid is so coarse that its picture
explains little, the picture is judged again on the whole grid.
"""

import time as clock
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy

from nlos.acquisition.transient import Transient
from nlos.acquisition.wall import WallGrid
from nlos.recon.count_noise import count_noise
from nlos.recon.errors import NO_PICTURE, InvalidData, ReconstructionFailed
from nlos.recon.explained_hot import hot_points
from nlos.recon.explained_parts import KEPT, Parts, coarser, counted_in, split
from nlos.recon.explained_share import LITTLE, Explained
from nlos.recon.explained_surface import light_from_in_front, surface_light, with_haze
from nlos.recon.gate import open_bins
from nlos.recon.other_geometry import Judged, better_wall
from nlos.recon.points_in_order import out_of_order

POINTS = 256  # of the wall at which light is compared
STRETCHES = 128  # of the time axis in which it is
WIDTHS = (0.0, 0.5, 1.0, 2.0)  # tried for the response, standard deviations in stretches
SURE = 3.0  # standard errors by which light must differ from a flat background, or there is nothing to explain
MOST_OWN = 0.9  # of the light that points get, from the pixel in front of each: more tells nothing of the others
UNSEEN = "nothing is seen in a picture of a part of the scan"
APART = (
    "what is seen lies so near, for points so far apart, that each point sees the one pixel in front of it: no test of "
    "the picture. Check the wall's size, the bin width and time zero"
)
FAINT = "too little light to hold a picture against: its points are not told from a flat background, one by one"
NEAR = 3.0  # pixels of half the grid: a surface nearer than this sends its points other light than its pixels do
OTHERS = np.array([0.25, 0.25, 0.0, 0.25, 0.25])  # the neighbours of a stretch, whose noise is not its own
SEED = 5
Floats = npt.NDArray[np.float64]
Seen = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]


def explained_light(
    transient: Transient,
    see: Callable[[Transient], Seen],
    falloffs: tuple[float, ...],
    prepare: Callable[[Transient], Transient] = lambda same: same,
    *,
    elsewhere: bool = False,
) -> Explained:
    """What `see`, which makes a picture and a depth map (H, W) of a scan, explains of `transient`.

    Of several `falloffs` the one that fits the seen part best is taken; `prepare` is done to the coarser scan first.
    With `elsewhere` two more pictures tell whether another wall explains more (`other_geometry.py`). Never raises:
    where there is no answer, the note says why.
    """
    began = clock.perf_counter()
    noise, whole = count_noise(transient), counted_in(transient) > 0

    def judged(scan: Transient) -> tuple[Parts, Judged, bool]:
        prepared = prepare(scan)
        joined = round(prepared.time.bin_width_s / scan.time.bin_width_s)
        parts = split(prepared, noise.of_sums(joined))
        for part in (parts.seen, parts.judging):
            if not part.counts.sum(dtype=np.float64) > 0:
                raise InvalidData("too few photons to hold some out")
        try:
            seen = see(parts.seen)
        except NO_PICTURE as error:
            raise ReconstructionFailed(f"no picture of a part of the scan: {error}") from error
        return parts, _judge(parts, *seen, falloffs), _is_near(*seen, scan.wall)

    try:
        if np.count_nonzero(transient.exposure_s > 0) == 1:
            raise InvalidData("one point of the wall alone explains itself")
        thinned = coarser(transient)
        parts, told, near = judged(thinned)
        poor = told.note in (UNSEEN, APART) or (not told.note and (told.share or 0.0) < LITTLE)
        if (near or poor) and thinned is not transient:
            again = judged(transient)
            parts, told = (parts, told) if again[1].note else again[:2]
    except NO_PICTURE as error:
        return Explained(None, None, str(error), clock.perf_counter() - began)

    def with_wall(scale: float) -> Judged | None:
        wall = parts.seen.wall
        wall = WallGrid(scale * wall.width_m, scale * wall.height_m, wall.rows, wall.cols)
        seen = replace(parts.seen, wall=wall)
        try:
            other = _judge(replace(parts, seen=seen), *see(seen), falloffs)
        except NO_PICTURE:
            return None
        return None if other.note in (UNSEEN, APART) else other

    found = Explained(told.share, None if told.share is None else told.error, told.note)
    hot = hot_points(transient, noise.unit) if found.nothing or found.share is None else ""
    if hot and found.share is None:  # it is them that nobody should believe
        found = replace(found, share=0.0, error=0.0)
    doubt = out_of_order(transient)
    if elsewhere and not doubt and told.share is not None and not found.nothing:
        doubt = better_wall(transient, told, with_wall)
    words = [
        told.note,
        hot,
        "" if whole else "after corrections these are no whole photons: their noise is estimated",
    ]
    note = "; ".join(word for word in words if word)
    return replace(found, note=note, doubt=doubt, seconds=clock.perf_counter() - began)


def _is_near(albedo: npt.NDArray[np.float32], depth_m: npt.NDArray[np.float32], wall: WallGrid) -> bool:
    """Whether what is seen lies only a few pixels in front of the wall."""
    depths = with_haze(albedo, depth_m, wall)[albedo > 0.5 * albedo.max()]
    pixel_m = max(wall.width_m / wall.cols, wall.height_m / wall.rows)
    return bool(depths.size and np.median(depths) < NEAR * pixel_m)


def _judge(
    parts: Parts, albedo: npt.NDArray[np.float32], depth_m: npt.NDArray[np.float32], falloffs: tuple[float, ...]
) -> Judged:
    seen, judging = parts.seen, parts.judging
    albedo = albedo / max(float(albedo.max()), float(np.finfo(np.float32).tiny))
    measured = np.argwhere(seen.exposure_s > 0)
    points = measured[np.sort(np.random.default_rng(SEED).permutation(len(measured))[:POINTS])]
    row, col = points.T
    dwell = seen.exposure_s[row, col] / seen.exposure_s[row, col].mean()
    first = int(np.flatnonzero(seen.counts.any(axis=(1, 2)))[0])
    joined = max(1, round((seen.time.bins - first) / STRETCHES))

    def stretches(x: npt.NDArray[np.floating]) -> Floats:
        used = (len(x) - first) // joined * joined
        return np.asarray(x[first : first + used].reshape(used // joined, joined, -1).sum(axis=1), dtype=np.float64)

    had, left = stretches(seen.counts[:, row, col]), stretches(judging.counts[:, row, col])
    of_sums = parts.noise.of_sums(joined)
    least = 1e-12 * float(np.abs(judging.counts).mean(dtype=np.float64))
    of_sums = replace(of_sums, unit=max(of_sums.unit, least))
    flat = stretches(_opened(seen)) / joined * dwell
    taken = of_sums.level * seen.exposure_s[row, col].mean() * flat  # put back, the flat background explains it
    had, left = had + KEPT * taken, left + (1 - KEPT) * taken
    profile = np.maximum(scipy.ndimage.uniform_filter1d((had / dwell).mean(axis=1), 3), 0)
    floor = max(float(np.quantile(profile, 0.1)), 0.0) + 0.02 * float(profile.max())
    near = np.maximum(scipy.ndimage.uniform_filter1d(had, 5, axis=0), 0)
    lights: list[tuple[Floats, str]] = []  # by every falloff and width of the response, and why it is no test, or ""
    for falloff in falloffs:
        sent, alone = _sent(albedo, depth_m, seen, points, falloff)
        light = stretches(sent * dwell)
        if seen.response is not None:
            taps = seen.response.taps(joined * seen.time.bin_width_s)
            light = scipy.ndimage.convolve1d(light, taps, axis=0, mode="constant")
        for width in WIDTHS:
            wider = scipy.ndimage.gaussian_filter1d(light, width, axis=0, mode="constant") if width else light
            lights.append((wider, alone))
    rest, count = (1 - KEPT) / KEPT, len(points)

    def fitted(around: Floats) -> tuple[Floats, Floats, Floats, str]:
        """Weights, the model and the flat background that come closest to the light, and why it is no test, or ""."""
        weight = 1 / (floor * dwell + 0.5 * profile[:, None] * dwell + 0.5 * around)
        models = [(_fitted(had, light, flat, weight), alone) for light, alone in lights]
        model, alone = min(models, key=lambda each: float((weight * (had - each[0]) ** 2).sum()))
        background = max(float((weight * had * flat).sum()), 0.0) / float((weight * flat * flat).sum())
        return weight, rest * model, rest * background * flat, alone

    weight, model, empty, alone = fitted(near)
    noise = of_sums.unit * left  # its expected value is the variance, whatever the mean
    missed = (weight * ((left - model) ** 2 - noise)).sum(axis=0)  # (N,)
    there = (weight * ((left - empty) ** 2 - noise)).sum(axis=0)
    if parts.noise.level or float(there.sum()) < SURE * float(np.sqrt(count * there.var())):
        # Of so little light each part is mostly noise, or how much of it is an estimate, but theirs are independent:
        # what both say there is, there is.
        weight, model, empty, alone = fitted(np.maximum(scipy.ndimage.convolve1d(had, OTHERS, axis=0), 0))
        there = (weight * (rest * had - empty) * (left - empty)).sum(axis=0)
        missed = there - (weight * (model - empty) * (2 * left - model - empty)).sum(axis=0)
    total = float(there.sum())
    if total < SURE * float(np.sqrt(count * there.var())):
        note = FAINT if _comes_in_time(parts) else "nothing to explain: no light but a flat background"
        return Judged(None if note == FAINT else 0.0, 0.0, note, missed, there)
    if alone:
        return Judged(0.0, 0.0, alone, missed, there)
    share = 1 - float(missed.sum()) / total
    error = float(np.sqrt(count * (missed - (1 - share) * there).var())) / total
    return Judged(share, error, "", missed, there)


def _opened(part: Transient) -> Floats:
    """1 in the bins (T,) in which there may be a background, 0 where a gate was shut."""
    opened = open_bins(part.counts[:, part.exposure_s > 0])
    return np.ones(part.time.bins) if opened is None else opened.astype(np.float64)


def _comes_in_time(parts: Parts) -> bool:
    """Whether the light of all points together is no flat background, by the time at which it comes."""
    taken = parts.noise.level * float(parts.seen.exposure_s.sum())
    seen, judging = (
        part.counts.sum(axis=(1, 2), dtype=np.float64) + share * taken
        for part, share in ((parts.seen, KEPT), (parts.judging, 1 - KEPT))
    )
    opened = _opened(parts.seen) > 0
    opened[: np.flatnonzero(parts.seen.counts.any(axis=(1, 2)))[0]] = False
    seen, judging = seen[opened], judging[opened]
    both = (seen - seen.mean()) * (judging - judging.mean())
    noise = parts.noise.unit * parts.noise.unit * seen.mean() * judging.mean() * len(both)
    return float(both.sum()) > SURE * float(np.sqrt(max(noise, 0.0)))


def _sent(
    albedo: npt.NDArray[np.float32], depth_m: npt.NDArray[np.float32], seen: Transient, points: npt.NDArray[np.intp],
    falloff: float,
) -> tuple[npt.NDArray[np.float32], str]:  # fmt: skip
    """`surface_light`, (T, N), and why it is no test of the picture, or "". Pixels that light but the point in front of
    them are excluded where they outshine the others: they are no test, the others may be."""
    wall = seen.wall
    far = with_haze(albedo, depth_m, wall) > min(wall.width_m / wall.cols, wall.height_m / wall.rows)
    why = UNSEEN
    for shade in (albedo, np.where(far, albedo, 0).astype(np.float32)):
        sent = surface_light(shade, depth_m, wall, points, seen.time, falloff)
        own = light_from_in_front(shade, depth_m, wall, points, seen.time, falloff).sum(dtype=np.float64)
        total = float(sent.sum(dtype=np.float64))
        if total > 0 and own <= MOST_OWN * total:
            return sent, ""
        why = APART if total > 0 else why
    return sent, why


def _fitted(data: Floats, rendered: Floats, flat: Floats, weight: Floats) -> Floats:
    """gain x `rendered` + background x `flat`, neither below 0, that comes closest to `data`."""
    background = max(float((weight * data * flat).sum()), 0.0) / float((weight * flat * flat).sum())
    power = float((weight * rendered * rendered).sum())
    if not power > 0:
        return background * flat
    both = float((weight * rendered * flat).sum())
    flats = float((weight * flat * flat).sum())
    of_light, of_flat = float((weight * data * rendered).sum()), float((weight * data * flat).sum())
    determinant = power * flats - both * both
    gain = (of_light * flats - of_flat * both) / determinant if determinant > 1e-12 * power * flats else 0.0
    if gain <= 0:
        return background * flat
    background = (of_flat - gain * both) / flats
    if background < 0:
        gain, background = max(of_light / power, 0.0), 0.0
    return gain * rendered + background * flat
