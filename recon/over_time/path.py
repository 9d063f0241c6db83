"""The path of what moves, from how pairs of frames are displaced against each other."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

BENDING = 0.2
"""How much a path that bends counts, over a pair of successive frames that disagrees with it."""
ROUNDS = 5
LEAST_SCATTER_M = 0.01
"""Pairs that disagree by less than this are all taken for good."""


def path_through(
    pairs: dict[tuple[int, int], tuple[Floats, float]],  # (before, now) -> displacement (3,), height
    frames: list[int],
) -> Floats:
    """Places (F, 3) of what `frames` show, the last one's being 0: the least squares of all pairs' displacements and of
    bending, in rounds that trust pairs the less the more they disagree with the others (Cauchy's weights).

    A pair counts by its height, and less the farther apart its frames are: what turns or changes is not just
    displaced."""
    count = len(frames)
    index = {frame: place for place, frame in enumerate(frames)}
    known = [(index[a], index[b], *pairs[a, b]) for a, b in pairs if a in index and b in index and pairs[a, b][1] > 0]
    if count < 2 or not known:
        return np.zeros((count, 3))
    before, now = (np.array([each[k] for each in known]) for k in (0, 1))
    by_m = np.stack([each[2] for each in known])  # (P, 3)
    heights = np.array([each[3] for each in known])
    base = np.minimum(heights / np.median(heights), 1.5) / (now - before)
    differences = np.zeros((len(known), count))
    differences[np.arange(len(known)), now] += 1
    differences[np.arange(len(known)), before] -= 1
    bends = np.zeros((max(count - 2, 0), count))
    for k in range(len(bends)):
        bends[k, k : k + 3] = 1, -2, 1
    fixed = BENDING * bends.T @ bends + 1e-6 * np.eye(count)
    fixed[-1, -1] += 1e6
    trust = np.ones(len(known))
    for _ in range(ROUNDS):
        weighted = differences.T * (base * trust)
        places: Floats = np.linalg.solve(weighted @ differences + fixed, weighted @ by_m)
        off_m = np.linalg.norm(differences @ places - by_m, axis=1)
        trust = 1 / (1 + (off_m / max(1.5 * float(np.median(off_m)), LEAST_SCATTER_M)) ** 2)
    return np.asarray(places - places[-1], dtype=np.float64)


def along(path_m: Floats, moments_s: Floats, at_s: Floats) -> Floats:
    """Places (N, 3) at moments (N,) of a path (F, 3) that is straight between its own moments (F,) and beyond them."""
    if len(path_m) < 2:
        return np.zeros((len(at_s), 3))
    return np.asarray(weights_along(moments_s, at_s) @ path_m, dtype=np.float64)


def weights_along(moments_s: Floats, at_s: Floats) -> Floats:
    """(N, F): how much each place of such a path, of two or more, counts at moments (N,)."""
    before = np.clip(np.searchsorted(moments_s, at_s, side="right") - 1, 0, len(moments_s) - 2)
    later = (at_s - moments_s[before]) / np.diff(moments_s)[before]
    weights, row = np.zeros((len(at_s), len(moments_s))), np.arange(len(at_s))
    weights[row, before], weights[row, before + 1] = 1 - later, later
    return weights
