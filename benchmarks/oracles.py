"""What points chosen by somebody who knows the truth would gain, against coarse to fine at equal dwell: `oracles.py N`.

N scenes of held-out kinds, about 4 counts in a point's highest bin, pictures by NANO (without mirror images); error:
relative L2 of the front view at its best scale, over that of coarse to fine, of 5, 10 and 20 % of the full dwell.
Told the expected light: light: density of points as the root of the light they get; near: only the brighter 70 % of the
wall; short: four times the points at a quarter of the dwell; posterior: half coarse to fine, then greedily where the
Gaussian posterior of brightness over the light cones shrinks most, the true surface being its prior.
"""

import heapq
import json
import sys

import numpy as np
import numpy.typing as npt
import torch
from where_to_look import BACKGROUND, DATA, PEAK, SEED, SHARES, SIDE, Floats, Scene

from nlos.acquisition.planning.patterns.coarse_to_fine import CoarseToFine
from nlos.acquisition.transient import SPEED_OF_LIGHT_M_PER_S
from nlos.recon.methods.nano import Settings, build
from nlos.recon.predicted_error import relative_error
from nlos.recon.training.scenes import FrontView

NAMES = ("light", "near", "short", "posterior")
FAINT = 0.05  # of the brightest pixel: fainter ones are no part of the prior


class Posterior:
    """Of the brightness of every pixel of the true surface, Gaussian; its covariance shrinks with every point taken."""

    def __init__(self, truth: FrontView, light: Floats) -> None:
        bright = truth.intensity / truth.intensity.max()
        there = bright > FAINT
        x, y = np.meshgrid(DATA.wall.x_m(), DATA.wall.y_m())
        depth = truth.depth_m[there]
        depth = np.where(depth > 0, depth, np.median(depth[depth > 0]))
        away = (x.ravel()[:, None] - x[there]) ** 2 + (y.ravel()[:, None] - y[there]) ** 2 + depth**2
        time_s = 2 * np.sqrt(away) / SPEED_OF_LIGHT_M_PER_S
        self.bin = np.floor(time_s / DATA.time.bin_width_s).astype(int)  # (N, P)
        gain = 1 / away**2
        self.bright = bright[there]
        self.gain = gain * (light.mean() / (gain * self.bright).sum(axis=1).mean())
        self.covariance = np.diag(0.25 * self.bright**2 + 0.01)

    def _seen(self, point: int) -> tuple[Floats, Floats, Floats]:
        bins, which = np.unique(self.bin[point], return_inverse=True)
        matrix = np.zeros((len(self.bright), len(bins)))
        matrix[np.arange(len(self.bright)), which] = self.gain[point]
        return matrix, self.covariance @ matrix, matrix.T @ self.bright + BACKGROUND * PEAK

    def gained(self, point: int) -> float:
        """By how much the point's bins, each on its own, shrink the sum of variances."""
        matrix, spread, noise = self._seen(point)
        return float(((spread**2).sum(axis=0) / ((matrix * spread).sum(axis=0) + noise)).sum())

    def take(self, point: int) -> None:
        matrix, spread, noise = self._seen(point)
        self.covariance = self.covariance - spread @ np.linalg.solve(matrix.T @ spread + np.diag(noise), spread.T)


def greedy(truth: FrontView, light: Floats, order: npt.NDArray[np.intp], count: int) -> npt.NDArray[np.intp]:
    """The first half in `order`, then always the point that gains most."""
    chosen, posterior = [int(point) for point in order[: count // 2]], Posterior(truth, light)
    for point in chosen:
        posterior.take(point)
    queue = [(-posterior.gained(point), point) for point in range(SIDE**2) if point not in set(chosen)]
    heapq.heapify(queue)
    while len(chosen) < count:
        point = heapq.heappop(queue)[1]
        now = -posterior.gained(point)
        if queue and now > queue[0][0]:  # gains only fall: whoever is still first after being asked again is best
            heapq.heappush(queue, (now, point))
            continue
        posterior.take(point)
        chosen.append(point)
    return np.array(chosen)


def dwells(name: str, count: int, light: Floats, truth: FrontView, order: npt.NDArray[np.intp]) -> Floats:
    """(H, W) of dwell, `count` in all; `order`: of the points, coarse to fine."""
    points, each = order[:count], 1.0
    rank = np.empty(SIDE**2)
    rank[order] = np.arange(SIDE**2)
    if name == "light":
        points = np.argsort((rank + 0.5) / np.sqrt(light))[:count]
    elif name == "near":
        near = np.argsort(-light)[: round(0.7 * SIDE**2)]
        points = near[np.argsort(rank[near])][:count]
    elif name == "short":
        points = order[: 4 * count]
        each = count / len(points)
    elif name == "posterior":
        points = greedy(truth, light, order, count)
    made = np.zeros(SIDE**2)
    made[points] = each
    return made.reshape(SIDE, SIDE)


def oracles(scenes: int) -> None:
    """Who is told the truth, at equal dwell."""
    network = build(Settings(symmetries=False), DATA.wall, DATA.time)
    positions = CoarseToFine().points(DATA.wall)
    order = positions.row.astype(np.intp) * SIDE + positions.col
    ratios: dict[str, list[float]] = {}
    for number in range(scenes):
        scene = Scene(SEED, number, held_out=True)
        truth, expected = scene.truth, PEAK * scene.clean
        light = np.maximum(PEAK * (scene.clean - BACKGROUND).sum(axis=0).ravel(), 1e-3)
        for share in SHARES:
            found = {}
            for name in ("coarse_to_fine", *NAMES):
                dwell = dwells(name, round(share * SIDE**2), light, truth, order)
                counts = np.random.default_rng(number).poisson(expected * dwell)
                with torch.inference_mode():
                    seen = network(*(torch.tensor(x, dtype=torch.float32)[None] for x in (counts[None], dwell)))
                found[name] = relative_error(seen.albedo[0].numpy(), truth.intensity)
            for name in NAMES:
                ratios.setdefault(f"{name}_{share:.0%}", []).append(found[name] / found["coarse_to_fine"])
        print(json.dumps({"scene": number, **{name: round(r[-1], 3) for name, r in ratios.items()}}), file=sys.stderr)
    for name, each in ratios.items():
        for what, value, target in (("median", float(np.median(each)), 0.85), ("worst", max(each), 1.03)):
            line = {"figure": f"{what}_error_{name}", "value": round(value, 3), "unit": "of coarse to fine"}
            print(json.dumps({**line, "target": f"<= {target}", "met": value <= target}))


if __name__ == "__main__":
    oracles(int(sys.argv[1]) if sys.argv[1:] else 30)
