"""What a pattern that adapts gains, and could gain: against coarse to fine in the same time.

`adaptive N`: N scenes of held-out kinds, scanned by the engine's own choice of batches and the adviser of `nlos scan`,
with the settling times of the simulated bench, against coarse to fine in batches of 64, in 5, 10 and 20 % of the bench
time of all 32 x 32 points of a whole dwell. `quick` and `slow`: whole dwells of 8 and of 80 ms; `dim` and `bright`: 4
counts in a point's highest bin in a whole dwell, and 54, as on the simulated bench in 8 ms. The adviser has dwells of
an eighth, a quarter, a half and a whole one. `short`: coarse to fine at an eighth; `even`: the adviser without any
picture.

`fit N`: the table of `recon/points_and_photons.py`, of N scenes of kinds that were learned on.

What somebody could gain who knows the truth: `oracles.py`.
"""

import json
import sys
from itertools import product

import numpy as np
import numpy.typing as npt
import torch

from nlos.acquiring import open_bench
from nlos.acquisition.planning.patterns.adaptive import Adaptive
from nlos.acquisition.planning.patterns.coarse_to_fine import CoarseToFine
from nlos.acquisition.planning.patterns.serpentine import Serpentine
from nlos.acquisition.planning.plan import ScanPlan
from nlos.acquisition.planning.preflight import aim_of
from nlos.acquisition.planning.timing import moves_s
from nlos.acquisition.sample import Sample, ScanPoint
from nlos.acquisition.scanning.advice import Batches
from nlos.acquisition.transient import Transient
from nlos.drivers.bench import Bench
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.tcspc.counter import Histogram, HistogramAxis, HistogramFlag
from nlos.live.where_next import WhereNext
from nlos.recon.live import LivePicture, LiveReconstruction
from nlos.recon.methods.nano import Settings, build
from nlos.recon.points_and_photons import PHOTONS, POINTS
from nlos.recon.predicted_error import relative_error
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import pulse, respond
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import front_view, make_scene, surfels

Floats = npt.NDArray[np.floating]
SIDE, PEAK, BACKGROUND, SEED = 32, 4.0, 0.02, 4242
DATA = DatasetSettings(rows=SIDE, cols=SIDE)
SHARES = (0.05, 0.1, 0.2)
LENGTHS, EIGHTH = 4, 1 / 8
WHOLE_MS = {"quick": 8.0, "slow": 80.0}
LIGHT = {"dim": 4.0, "bright": 54.0}
TRAINED = 777
WAYS = ("adaptive", "even", "short")


class Scene:
    """One hidden scene: what it is, and counts as often as they are asked for, the same for the same point."""

    def __init__(self, seed: int, number: int, held_out: bool) -> None:
        self.number, made = number, make_scene(seed, number, DATA.wall, held_out=held_out)
        self.truth = front_view(made, DATA.wall)
        clean = render(surfels(made, np.random.default_rng(number)), DATA.wall, DATA.time).numpy()
        clean = respond(clean.astype(np.float32), pulse(DATA.time, 60, 0, 150.0))
        self.clean = clean / clean.max(axis=0).mean() + BACKGROUND  # (T, H, W), 1 in a point's highest bin

    def counts(self, point: ScanPoint, peak_hz: float) -> npt.NDArray[np.int64]:
        """Of a visit, with so many counts a second in the highest bin."""
        draw = np.random.default_rng((self.number, point.number, point.pass_))
        return draw.poisson(self.clean[:, point.row, point.col] * (peak_hz * point.dwell_s))


class Taken:
    """Samples of one scan, added up; makes pictures of them."""

    def __init__(self, scene: Scene, peak_hz: float) -> None:
        self.scene, self.peak_hz, self.numbers = scene, peak_hz, {}
        self.counts, self.dwell_s = np.zeros((DATA.bins, SIDE, SIDE)), np.zeros((SIDE, SIDE))

    def take(self, point: ScanPoint) -> Sample:
        """One visit; the sample that an adviser sees has direct light, as much as came from behind the wall."""
        counts = self.scene.counts(point, self.peak_hz)
        self.numbers[point.number] = 0
        self.counts[:, point.row, point.col] += counts
        self.dwell_s[point.row, point.col] += point.dwell_s
        seen = counts.astype(np.uint32)
        seen[0] += np.uint32(counts.sum())
        axis = DATA.time
        histogram = Histogram(seen, axis.bin_width_s, 0.0, point.dwell_s, 1, int(seen.sum()), HistogramFlag(0), 0.0)
        return Sample(point, histogram, 0.0)

    def transient(self) -> Transient:
        """What is known so far."""
        return Transient(self.counts.astype(np.float32), self.dwell_s, DATA.wall, DATA.time)

    def error(self, network: torch.nn.Module) -> float:
        """Of its picture."""
        with torch.inference_mode():
            given = (torch.tensor(each, dtype=torch.float32)[None] for each in (self.counts[None], self.dwell_s))
            seen = network(*given).albedo[0].numpy()
        return relative_error(seen, self.scene.truth.intensity)


class Drawn:
    """`Looks` at what was drawn."""

    def __init__(self, taken: Taken) -> None:
        self.taken, self.live = taken, LiveReconstruction("nano")

    def add(self, sample: Sample) -> None:
        """It is in `taken` already."""

    def picture(self, kind: str) -> LivePicture:
        """By NANO with its intervals."""
        return self.live.update(self.taken.transient(), len(self.taken.numbers))


def moving_s(bench: Bench, points: list[ScanPoint]) -> Floats:
    """Of every step of a path, as the simulated bench's mirror settles."""
    x_m, y_m = (np.array([getattr(point, axis) for point in points]) for axis in ("x_m", "y_m"))
    x_rad, y_rad = aim_of(bench).angles_rad(x_m * BENCH_WALL, y_m * BENCH_WALL)
    return moves_s(bench, [MirrorAngles(*each) for each in zip(x_rad.tolist(), y_rad.tolist(), strict=True)])


BENCH_WALL = 1.0 / DATA.wall.width_m
"""The simulated bench reaches a wall of a metre: the same angles, so the same times."""


def coarse(bench: Bench, taken: Taken, dwell_ms: float, total_s: float) -> float:
    """Takes what fits the time, coarse to fine; returns the time it took."""
    places = CoarseToFine(batch=64).points(DATA.wall)
    plan = ScanPlan(
        DATA.wall, AXIS, places, np.full(SIDE**2, dwell_ms * 1e-3), np.zeros(SIDE**2, dtype=np.int32)
    )  # fmt: skip
    points = list(plan)
    ends_s = np.cumsum(moving_s(bench, points) + dwell_ms * 1e-3)
    for point in points[: int(np.searchsorted(ends_s, total_s))]:
        taken.take(point)
    return float(min(ends_s[len(taken.numbers) - 1], total_s))


def advised(bench: Bench, taken: Taken, shortest_ms: float, total_s: float, looks: Drawn | None) -> tuple[float, float]:
    """Takes what the engine would, in the same time; returns how long that was, and what the advice took."""
    step_ms = 1.3
    for _ in range(2):  # what a step takes depends on the batch, and that on what a step takes
        pattern = Adaptive(seconds=total_s, step_ms=step_ms, lengths=LENGTHS)
        places = pattern.points(DATA.wall)
        visits = pattern.visits(places, shortest_ms * 1e-3)
        batch = pattern.budget(visits).batch
        in_batches = ScanPlan(
            DATA.wall, AXIS, CoarseToFine(batch=batch).points(DATA.wall), visits.dwell_s[: SIDE**2],
            visits.pass_[: SIDE**2],
        )  # fmt: skip
        step_ms = float(moving_s(bench, list(in_batches)).mean()) * 1e3
    plan = ScanPlan(
        DATA.wall, AXIS, places.take(visits.index), visits.dwell_s, visits.pass_, budget=pattern.budget(visits)
    )  # fmt: skip
    adviser = WhereNext(plan, looks)
    batches = Batches(plan, taken.numbers, adviser, lambda kind, text: None)
    path: list[ScanPoint] = []
    while numbers := batches.numbers(plan.most_together):
        for number in numbers:
            path.append(plan[number])
            adviser.add(taken.take(plan[number]))
    took_s = float((moving_s(bench, path) + [point.dwell_s for point in path]).sum())
    return took_s, adviser.seconds


def adaptive(scenes: int) -> None:
    """The ratios of errors, and what they cost."""
    network = build(Settings(symmetries=False), DATA.wall, DATA.time)
    ratios: dict[str, list[float]] = {}
    planner: dict[str, list[float]] = {}
    with open_bench("simulated") as bench:
        for number in range(scenes):
            scene = Scene(SEED, number, True)
            for (pace, whole_ms), (light, peak), share in product(WHOLE_MS.items(), LIGHT.items(), SHARES):
                by = {way: Taken(scene, peak / whole_ms * 1e3) for way in ("coarse_to_fine", *WAYS)}
                total_s = share * full_s(bench, whole_ms)
                coarse(bench, by["coarse_to_fine"], whole_ms, total_s)
                coarse(bench, by["short"], whole_ms * EIGHTH, total_s)
                advised(bench, by["even"], whole_ms * EIGHTH, total_s, None)
                took_s, planned_s = advised(bench, by["adaptive"], whole_ms * EIGHTH, total_s, Drawn(by["adaptive"]))
                error = {way: each.error(network) for way, each in by.items()}
                case = f"{pace}_{light}_{share:.0%}"
                for way in WAYS:
                    ratios.setdefault(f"{way}_{case}", []).append(error[way] / error["coarse_to_fine"])
                ratios.setdefault(f"time_{case}", []).append(took_s / total_s)
                planner.setdefault(case, []).append(planned_s / float(by["adaptive"].dwell_s.sum()))
            print(json.dumps({"scene": number, **{n: round(r[-1], 3) for n, r in ratios.items()}}), file=sys.stderr)
    for name, each in ratios.items():
        if name.startswith("time"):
            line = {"figure": f"bench_{name}", "value": round(float(np.median(each)), 3), "unit": "of the time given"}
            print(json.dumps(line))
            continue
        for what, value, target in (("median", float(np.median(each)), 0.85), ("worst", max(each), 1.03)):
            line = {"figure": f"{what}_error_{name}", "value": round(value, 3), "unit": "of coarse to fine"}
            print(json.dumps({**line, "target": f"<= {target}", "met": value <= target, "scenes": scenes}))
    for case, each in planner.items():
        cost = float(np.median(each))
        line = {"figure": f"planner_time_{case}", "value": round(cost, 3), "unit": "of the dwell it plans"}
        print(json.dumps({**line, "target": "<= 0.1", "met": cost <= 0.1}))


def full_s(bench: Bench, dwell_ms: float) -> float:
    """Bench time of every point, row by row."""
    points = Serpentine().points(DATA.wall)
    plan = ScanPlan(DATA.wall, AXIS, points, np.full(SIDE**2, dwell_ms * 1e-3), np.zeros(SIDE**2, dtype=np.int32))
    return float((moving_s(bench, list(plan)) + plan.dwell_s).sum())


def fit(scenes: int) -> None:
    """Geometric means over scenes of the errors of pictures by number of points and photons a point."""
    network = build(Settings(symmetries=False), DATA.wall, DATA.time)
    places = CoarseToFine().points(DATA.wall)
    order, peaks = places.row.astype(np.intp) * SIDE + places.col, np.array(PHOTONS) / PHOTONS[3]
    error, light = np.zeros((scenes, len(POINTS), len(PHOTONS))), []
    for number in range(scenes):
        scene = Scene(TRAINED, number, False)
        light.append(float((scene.clean - BACKGROUND).sum(axis=0).mean()))
        for i, count in enumerate(POINTS):
            made = np.zeros(SIDE**2)
            made[order[:count]] = 1
            for j, peak in enumerate(peaks):
                taken = Taken(scene, 1.0)
                taken.dwell_s = made.reshape(SIDE, SIDE)
                taken.counts = np.random.default_rng(number).poisson(scene.clean * peak * taken.dwell_s)
                error[number, i, j] = taken.error(network)
        print(json.dumps({"scene": number, "light": round(light[-1], 2)}), file=sys.stderr)
    print(json.dumps({"figure": "photons_at_a_peak_of_1", "value": round(float(np.mean(light)), 2)}))
    for count, row in zip(POINTS, np.exp(np.log(error).mean(axis=0)).round(3).tolist(), strict=True):
        print(json.dumps({"figure": f"error_of_{count}_points", "value": row, "photons": PHOTONS}))


AXIS = HistogramAxis(DATA.bins, DATA.time.bin_width_s, 0.0)

if __name__ == "__main__":
    words = {"adaptive": adaptive, "fit": fit}
    if len(sys.argv) < 2 or sys.argv[1] not in words:
        sys.exit(f"one of {', '.join(words)}, and how many scenes")
    words[sys.argv[1]](int(sys.argv[2]) if sys.argv[2:] else 30)
