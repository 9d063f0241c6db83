"""What ordering points is worth, and what planning costs.

Settling time of uniformly random points over a 2 m wall at 2 m, in boustrophedon strips, against the peer: the same
points after 2-opt (`order: two_opt`); and the time to plan 16,384 jittered points, strips included.
"""

import itertools
import json
import time

import numpy as np

from nlos.acquisition.planning.aim import Aim
from nlos.acquisition.planning.ordering import strips, two_opt
from nlos.acquisition.planning.scan_settings import ScanSettings
from nlos.drivers.galvo.mirror import MirrorAngles
from nlos.drivers.galvo.settle import SettleModel

SEEDS = range(5)
AIM, SETTLE = Aim(2.0), SettleModel()
DENSE = {
    "wall": {"width_m": 2.0, "height_m": 2.0, "rows": 256, "cols": 256},
    "pattern": {"kind": "jittered", "rows": 128, "cols": 128},
    "dwell_ms": 8,
    "histogram": {"bins": 512, "bin_width_ps": 32, "offset_ns": 10},
}


def figure(name: str, value: float, unit: str, target: float | None = None) -> None:
    met = None if target is None else bool(value <= target)
    print(json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": target, "met": met}))


def settle_s(x_m: np.ndarray, y_m: np.ndarray) -> float:
    """Time that the mirror needs for the whole path."""
    x_rad, y_rad = AIM.angles_rad(x_m, y_m)
    angles = [MirrorAngles(x, y) for x, y in zip(x_rad.tolist(), y_rad.tolist(), strict=True)]
    return sum(SETTLE.settle_s(a, b) for a, b in itertools.pairwise(angles))


def main() -> None:
    for count in (1024, 4096):
        drawn, in_strips, improved = [], [], []
        for seed in SEEDS:
            draw = np.random.default_rng(seed)
            x_m, y_m = draw.uniform(-1, 1, count), draw.uniform(-1, 1, count)
            strip, best = strips(x_m, y_m), two_opt(x_m, y_m)
            drawn.append(settle_s(x_m, y_m))
            in_strips.append(settle_s(x_m[strip], y_m[strip]))
            improved.append(settle_s(x_m[best], y_m[best]))
        figure(f"settle_over_2opt_{count}", float(np.mean(in_strips) / np.mean(improved)), "ratio", 1.1)
        figure(f"settle_as_drawn_over_strips_{count}", float(np.mean(drawn) / np.mean(in_strips)), "ratio")
        figure(f"settle_strips_{count}", float(np.mean(in_strips)), "s")
    settings = ScanSettings.model_validate(DENSE)
    times_s = []
    for _ in range(5):
        started = time.perf_counter()
        plan = settings.plan()
        times_s.append(time.perf_counter() - started)
    assert len(plan) == 16384
    figure("plan_s_16384", min(times_s), "s", 0.2)


if __name__ == "__main__":
    main()
