"""Explained light: what it costs, and whether it ranks pictures as their truth does.

Prints one JSON line a figure: the CPU time it adds to a picture of 64 x 64 points and 512 bins, by method, with the
look at other walls that NANO takes (on eight scans of kinds that it never saw, on average and at most); and of the
folder of data that is the argument (default ../shared/data, skipped where it is not there)

- of scenes with a truth, `synthetic/`, the rank correlation of explained light with PSNR within each scene, over
  methods and conditions at their defaults;
- of measured scenes, `real/`, how often it is higher with the right exponent of the falloff, size of the wall and time
  zero than with one that is 20 %, 10 % or 100 ps off, either way (NANO knows the exponents 2 and 4); and how often the
  light-cone transform is sharper with the right wall. Half of them would be chance.
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

if sys.path and Path(sys.path[0] or ".").resolve() == Path(__file__).resolve().parent:
    sys.path.pop(0)  # or a file here would be taken for the package of its name

import numpy as np
from scipy.stats import spearmanr

from nlos.acquisition.transient import TimeAxis, Transient
from nlos.acquisition.wall import WallGrid
from nlos.chain import calibrate_scan
from nlos.loaded import load_scan
from nlos.recon.evaluate import evaluate
from nlos.recon.methods import find
from nlos.recon.physics_settings import PhysicsSettings
from nlos.recon.reconstruct import explained, reconstruct
from nlos.recon.sharpness import sharpness
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.rendering import render
from nlos.recon.training.scenes import make_scene, surfels
from nlos.response import AUTO, with_response

METHODS = ("lct", "fk", "phasor", "backprojection", "lfe", "nano")
CONDITIONS = ("transient", "counts_p20", "counts_p5", "counts_p1", "counts_p5@16x16")
MEASURED = (
    "otoole_s_u", "otoole_resolution_40cm", "otoole_dots_65cm", "otoole_mannequin_directcut", "ahn_2019", "ahn_toy",
    "statue_full", "letter_2", "letter_4",
)  # fmt: skip
WALL, TIME = WallGrid(2.0, 2.0, 64, 64), TimeAxis(512, 32e-12)


def figure(name: str, value: float, unit: str, target: str, met: bool) -> None:
    """One line of the result."""
    print(
        json.dumps({"figure": name, "value": round(value, 3), "unit": unit, "target": target, "met": met}), flush=True
    )


def scan() -> Transient:
    """A scan of one of the training scenes, about 10 counts in the brightest bin of a point."""
    expected = render(surfels(make_scene(5, 0, WALL), np.random.default_rng(0)), WALL, TIME).numpy()
    expected = 10 * expected / expected.max(axis=0).mean() + 0.1
    counts = np.random.default_rng(0).poisson(expected).astype(np.float32)
    return Transient(counts, np.ones((64, 64)), WALL, TIME)


def never_seen(number: int) -> Transient:
    """A scan of a scene of a kind that NANO never saw."""
    detector = DetectorSettings(sparse=0.0)
    data = DatasetSettings(
        seed=519, rows=64, cols=64, bins=512, bin_width_ps=32, degradations=1, scenes=1000, held_out=True,
        detector=detector,
    )  # fmt: skip
    made = sample(data, number)
    return Transient(made.counts.astype(np.float32), made.exposure.astype(np.float64), data.wall, data.time)


def cost(made: Transient, method: str, *, elsewhere: bool = False, rounds: int = 6) -> float:
    """CPU time with explained light over that without, the least of some rounds in turn, less 1."""
    least = {True: float("inf"), False: float("inf")}
    for _ in range(rounds):
        for explain in least:
            begun = process_time()
            reconstruct(made, method, explain=explain, elsewhere=elsewhere)
            least[explain] = min(least[explain], process_time() - begun)
    return least[True] / least[False] - 1


def ranks(folder: Path) -> None:
    """Within each scene of `folder`, and on average."""
    rows = evaluate([folder], METHODS, CONDITIONS, fixed=True, say=lambda text: None).rows
    found = []
    for scene in dict.fromkeys(row.scene for row in rows):
        of = [row for row in rows if row.scene == scene]
        rank = float(spearmanr([row.explained for row in of], [row.psnr for row in of])[0])
        found.append(rank)
        figure(f"explained_ranks_{scene}", rank, "rank correlation with PSNR", ">= 0.8", rank >= 0.8)
    mean = float(np.mean(found))
    figure("explained_ranks_mean", mean, "rank correlation with PSNR", ">= 0.8", mean >= 0.8)


def preferences(folder: Path) -> None:
    """Of the scenes in `folder`, by every method: how often what is right explains more than what is not."""
    right: dict[str, list[bool]] = {"falloff": [], "wall": [], "time_zero": []}
    sharper: list[bool] = []
    for name in MEASURED:
        loaded = load_scan(folder / f"{name}.h5")
        scan, falloff = with_response(calibrate_scan(loaded), AUTO), float(loaded.falloff or 4)
        sharper += [sharpness(scan, 1.0) > sharpness(scan, scale) for scale in (0.9, 1.1)]
        for method in METHODS:
            best = share(scan, method, falloff)
            if method == "nano":
                right["falloff"].append(best > share(scan, method, 6 - falloff))
            for way in (-1, 1):
                wide = 1 + 0.1 * way
                wall = WallGrid(scan.wall.width_m * wide, scan.wall.height_m * wide, scan.wall.rows, scan.wall.cols)
                right["wall"].append(best > share(replace(scan, wall=wall), method, falloff))
                right["time_zero"].append(best > share(later(scan, way * 100e-12), method, falloff))
                if by_physics(method):
                    right["falloff"].append(best > share(scan, method, falloff * (1 + 0.2 * way)))
    for name, each in right.items():
        rate = float(np.mean(each))
        figure(f"explained_prefers_right_{name}", rate, f"of {len(each)}", "1", rate == 1)
    rate = float(np.mean(sharper))
    figure("sharper_on_the_right_wall", rate, f"of {len(sharper)}", "1", rate == 1)


def share(scan: Transient, method: str, falloff: float) -> float:
    """What a picture of `scan` by `method` explains, told the exponent where any may be told."""
    told: dict[str, object] = {"falloff": falloff} if by_physics(method) else {}
    return explained(scan, method, {"falloff": int(falloff)} if method == "nano" else told).share or 0.0


def by_physics(method: str) -> bool:
    """Methods that know any exponent."""
    return issubclass(find(method).Settings, PhysicsSettings)


def later(scan: Transient, by_s: float) -> Transient:
    """The same light, by a bin at least; what leaves the time axis is gone."""
    bins = round(by_s / scan.time.bin_width_s) or (1 if by_s > 0 else -1)
    counts = np.roll(scan.counts, bins, axis=0)
    counts[slice(0, bins) if bins > 0 else slice(bins, None)] = 0
    return replace(scan, counts=counts)


def main(folder: Path) -> None:
    made = scan()
    for method in ("lct", "fk", "nano"):
        part = cost(made, method)
        figure(f"explained_costs_{method}", part, "of the picture's time", "<= 0.3", part <= 0.3)
    parts = [cost(never_seen(number), "nano", elsewhere=True, rounds=3) for number in range(8)]
    mean = float(np.mean(parts))
    figure("explained_and_another_wall_costs_nano", mean, "of the picture's time", "<= 0.3", mean <= 0.3)
    figure("explained_and_another_wall_costs_nano_at_most", max(parts), "of the picture's time", "", True)
    if (folder / "synthetic").is_dir():
        ranks(folder / "synthetic")
    if (folder / "real").is_dir():
        preferences(folder / "real")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else Path("../shared/data"))
