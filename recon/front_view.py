"""A volume as one sees it who looks towards the wall: its brightest voxels, and their depth."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

SAME = 5e-3  # of the maximum, by which planes of one cell may differ: the first or last may hold a little of the next
MOST_FADED = 3  # planes that a maximum is put back by
STANDING = 0.5  # of the maximum: what is brighter, and hangs together with it, is one surface
Floats = npt.NDArray[np.float64]
DepthBy = Callable[[npt.NDArray[np.float32], npt.NDArray[np.float64]], npt.NDArray[np.float32]]
"""(volume (D, H, W), depths_m (D,)) -> depth (H, W) in metres, NaN where only noise is."""

LEAST_SEEN, MOST_HIDDEN = 0.1, 0.3  # of the bright parts' level: darker has no depth, brighter always has one


def front_view(albedo: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """The maximum of a volume (D, H, W) along depth, (H, W)."""
    return np.asarray(albedo.max(axis=0), dtype=np.float32)


def depth_map(
    albedo: npt.NDArray[np.float32],
    depths_m: npt.NDArray[np.float64],
    fading_per_m: npt.NDArray[np.float64] | None = None,
) -> npt.NDArray[np.float32]:
    """Depth in metres of the maximum of a volume (D, H, W), planes at (D,), by a parabola; NaN where only noise is.

    Where several planes share the maximum, they are one cell of the light cone near the wall (`_top_of_cells`).
    A volume that shows one surface darker the deeper it lies has its maxima before the surfaces. They are put back, by
    `fading_per_m`, (D,), what the logarithm of that brightness falls by a metre, over what the volume's own bends by.
    """
    peak = albedo.argmax(axis=0)
    depth_m = depths_m[peak]
    if len(depths_m) > 2:
        middle = np.clip(peak, 1, len(depths_m) - 2)
        before, at, after = (
            np.take_along_axis(albedo, (middle + k)[None], 0)[0].astype(np.float64) for k in (-1, 0, 1)
        )
        pitch_m = (depths_m[-1] - depths_m[0]) / (len(depths_m) - 1)
        depth_m = depths_m[middle] + np.clip(_top(before, at, after), -1, 1) * pitch_m
        if fading_per_m is not None:
            curvature = before - 2 * at + after
            bend = np.divide(at, -curvature, out=np.zeros_like(at), where=curvature < 0) * pitch_m**2
            depth_m += np.minimum(fading_per_m[middle] * bend, MOST_FADED * pitch_m)
        wide = (peak == middle) & (after >= at * (1 - SAME)) & (at > 0)
        depth_m[wide] = depths_m[0] + _top_of_cells(albedo[:, wide], peak[wide]) * pitch_m
    return _seen(depth_m, albedo.max(axis=0))


def _top(before: Floats, at: Floats, after: Floats) -> Floats:
    """Where a parabola through three neighbours is highest, in steps from the middle one."""
    curvature = before - 2 * at + after
    return np.divide(0.5 * (before - after), curvature, out=np.zeros_like(at), where=curvature < 0)


def _top_of_cells(albedo: npt.NDArray[np.float32], peak: npt.NDArray[np.intp]) -> Floats:
    """Depth of the maximum in planes, (N,), of columns (D, N) resampled from cells several planes deep. Planes within a
    cell are equal; one across the border of two cells has the mean of both, weighted by what it meets of each, which
    says where the border is. `peak` is the first plane within the highest cell."""
    last = len(albedo) - 1
    lower = (albedo < albedo.max(axis=0) * (1 - SAME)) & (np.arange(last + 1)[:, None] > peak)
    end = np.where(lower.any(axis=0), lower.argmax(axis=0), last + 1)
    column = np.arange(len(peak))
    at = albedo[peak, column].astype(np.float64)

    def side(shared: npt.NDArray[np.intp], beyond: npt.NDArray[np.intp]) -> tuple[Floats, Floats]:
        other = albedo[np.clip(beyond, 0, last), column].astype(np.float64)
        met = albedo[np.clip(shared, 0, last), column] - other
        share = np.divide(met, at - other, out=np.zeros_like(at), where=at > other)
        return other, np.where((shared < 0) | (shared > last), 0.0, np.clip(share, 0, 1))

    (before, nearer), (after, farther) = side(peak - 1, peak - 2), side(end, end + 1)
    offset = np.clip(_top(before, at, after), -0.5, 0.5)
    return np.asarray((peak + end - 1 + farther - nearer) / 2 + offset * (end - peak + farther + nearer))


def middle_map(albedo: npt.NDArray[np.float32], depths_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Depth in metres of the middle of what stands about the maximum of a volume (D, H, W), planes at (D,); NaN where
    only noise is.

    For a wave, whose intensity is brightest at either edge of a pulse and not in between, where the surface lies.
    """
    front = albedo.max(axis=0)
    depth_m = depths_m[albedo.argmax(axis=0)]
    plane = np.arange(len(depths_m))[:, None]
    for row in range(albedo.shape[1]):  # one at a time, to save memory
        along = albedo[:, row]
        above = along - STANDING * front[row]
        peak = along.argmax(axis=0)
        first = np.where((above < 0) & (plane < peak), plane, -1).max(axis=0) + 1
        end = np.where((above < 0) & (plane > peak), plane, len(plane)).min(axis=0)
        weight = np.where((plane >= first) & (plane < end), above, 0).astype(np.float64)
        total = weight.sum(axis=0)
        np.divide(depths_m @ weight, total, out=depth_m[row], where=total > 0)
    return _seen(depth_m, front)


def _seen(depth_m: npt.NDArray[np.float64], front: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Depths where the picture holds more than noise."""
    return np.where(front > _floor(front), depth_m, np.nan).astype(np.float32)


def _floor(front: npt.NDArray[np.float32]) -> float:
    """The level above which a pixel holds more than noise, judged by the spread of the darkest third of the picture."""
    darkest, dark, bright = (float(level) for level in np.quantile(front, [0.1, 0.3, 0.99]))
    return min(max(darkest + 4 * (dark - darkest), LEAST_SEEN * bright), MOST_HIDDEN * bright)
