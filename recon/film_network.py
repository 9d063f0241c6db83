"""The network for films that comes with NANO's weights, and how it goes along a film."""

from collections import deque
from contextlib import nullcontext
from dataclasses import replace
from functools import lru_cache

import numpy as np
import torch

from nlos.recon.layers.film_network import Carried, FilmNetwork, Shown
from nlos.recon.layers.in_bfloat16 import bfloat16_is_fast
from nlos.recon.over_time.given import Given, depth_everywhere
from nlos.recon.over_time.half_grid import HalfGrid
from nlos.recon.transport.fourier import on_one_core
from nlos.recon.volume import Reconstruction, Volume
from nlos.recon.weights.companions import companion

VIDEO = "nano.video"
POINTS = 64
"""A side of the pictures that it learned from."""
FEWEST, MOST = 128, 512
"""Points of a frame that it may be shown: it learned from frames of 256."""
MOST_GAP = 4
"""Frames without a picture, one less at most: after more of them it begins anew."""


@lru_cache(maxsize=4)
def film_network_for(weights: str | None) -> FilmNetwork | None:
    """The network that was fitted to pictures made by these weights of NANO; None for others. Raises WeightsError."""
    return companion(FilmNetwork, VIDEO, weights)


def takes(seen: HalfGrid) -> bool:
    """Whether it is a frame of a film as the network learned from: on a square wall of 64 x 64 points, some of them,
    halved."""
    wall, given = seen.wall, seen.given
    square = (wall.rows, wall.cols) == (POINTS, POINTS) and wall.width_m == wall.height_m and seen.light.wall != wall
    return given is not None and square and FEWEST <= given.points <= MOST


class FilmFinish:
    """Shown the frames of one film in the order of time; what it has seen it carries from picture to picture."""

    def __init__(self, network: FilmNetwork) -> None:
        self._network = network
        self._carried: deque[tuple[float, Carried]] = deque(maxlen=2)

    @torch.inference_mode()
    def __call__(self, given: Given, picture: Reconstruction, volume: Volume | None) -> Reconstruction:
        """`picture` on the whole grid, and the `volume` it was made with, finished. One of the same frame again, or of
        an earlier one, takes the place of the last."""
        while self._carried and self._carried[-1][0] >= given.moment_s:
            self._carried.pop()
        before_s, before = self._carried[-1] if self._carried else (given.moment_s, None)
        gap = int((given.moments_s > before_s).sum())
        if gap > MOST_GAP:
            before = None
        width_m, depth_m = picture.wall.width_m, depth_everywhere(picture.albedo, picture.depth_m)
        own = given.own(depth_m[::2, ::2], width_m, None if volume is None else volume.albedo)
        fields = (picture.albedo, depth_m / width_m - 0.5, own, given.told())
        shown = Shown(*(torch.from_numpy(np.ascontiguousarray(x, dtype=np.float32))[None] for x in fields))
        way = torch.from_numpy(given.way_m(before_s) / width_m).float()[None]
        quick = torch.autocast("cpu", torch.bfloat16) if bfloat16_is_fast() else nullcontext()
        with on_one_core(), quick:
            albedo, depth, carried = self._network(shown, before, way, torch.tensor([float(max(gap, 1))]))
        self._carried.append((given.moment_s, carried))
        bright = albedo[0].clamp(0, 1).float().numpy()
        there = bright >= 0.003 * bright.max(initial=0.0)
        deep_m = np.where(there & (bright > 0), (depth[0].float().numpy() + 0.5) * width_m, np.nan)
        return replace(picture, albedo=bright, depth_m=deep_m.astype(np.float32))
