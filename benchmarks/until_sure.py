"""Whether `scan --until sure:LEVEL` ends where it says: the true error of drawn scenes against the level asked for.

Twenty scenes drawn at random (letters, a creature, panels; one to three of them), 32 x 32 points coarse to fine on the
simulated bench, dwells of 1 to 16 ms, pictures by NANO; level as argument, 0.35 unless told. True error: relative L2
of the front view against what was drawn, at the best scale. One JSON line a figure; cases go to stderr.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from drawn_scenes import CREATURE, bench, picture_of

import nlos
from nlos.acquisition.wall import WallGrid
from nlos.recon.predicted_error import relative_error

SCENES, POINTS, WALL_M = 20, 32, 1.0
SCAN = """\
wall: {{width_m: 1.0, height_m: 1.0, rows: 32, cols: 32}}
pattern: {{kind: coarse_to_fine, batch: 32}}
dwell_ms: {dwell_ms}
histogram: {{bins: 1024, bin_width_ps: 16, offset_ns: 10}}
"""
LETTERS = "ACEFHKLNSTUXZ"
DWELLS_MS = (1, 4, 16)


def drawn(seed: int) -> list[dict[str, Any]]:
    """One to three objects, as a bench file says them."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 4))
    made = []
    for k in range(count):
        x = (k - (count - 1) / 2) * 0.3 + rng.uniform(-0.05, 0.05)
        centre = [round(float(v), 3) for v in (x, rng.uniform(-0.15, 0.15), rng.uniform(0.35, 0.8))]
        tall = round(float(rng.uniform(0.25, 0.6) / (1 + 0.3 * (count - 1))), 3)
        kind = rng.random()
        if kind < 0.6:
            made.append({"letter": LETTERS[rng.integers(len(LETTERS))], "centre_m": centre, "height_m": tall})
        elif kind < 0.8:
            made.append({"bitmap": CREATURE, "centre_m": centre, "height_m": tall})
        else:
            made.append({"panel_m": [round(0.6 * tall, 3), tall], "centre_m": centre})
    return made


def case(seed: int, level: float) -> tuple[bool, float]:
    """Whether the level was reached, and the true error then."""
    objects, dwell_ms = drawn(seed), DWELLS_MS[seed % len(DWELLS_MS)]
    with tempfile.TemporaryDirectory() as folder:
        there = Path(folder)
        (there / "scan.yaml").write_text(SCAN.format(dwell_ms=dwell_ms))
        (there / "bench.yaml").write_text(bench(objects, seed + 1, 100e3))
        command = [sys.executable, "-m", "nlos", "scan", "scan.yaml", "--bench", "bench.yaml", "-o", "run.h5", "--json"]
        done = subprocess.run(
            [*command, "--until", f"sure:{level}"], cwd=there, capture_output=True, text=True, check=True, timeout=600
        )
        seen = nlos.reconstruct(nlos.load(there / "run.h5"), method="nano")
    answer = json.loads(done.stdout)
    true = relative_error(seen.albedo, picture_of(objects, WallGrid(WALL_M, WALL_M, POINTS, POINTS)))
    found = {"scene": seed, "objects": len(objects), "dwell_ms": dwell_ms, "points": answer["points"]}
    print(json.dumps({**found, **answer["until"], "true_error": round(true, 3)}), file=sys.stderr, flush=True)
    return bool(answer["until"]["reached"]), true


def figure(name: str, value: float, unit: str, target: str | None = None, met: bool | None = None) -> None:
    print(
        json.dumps({"figure": name, "value": round(value, 3), "unit": unit, "target": target, "met": met}), flush=True
    )


def main(level: float, scenes: int) -> None:
    cases = [case(seed, level) for seed in range(scenes)]
    true = np.array([error for reached, error in cases if reached])
    figure("until_sure_reached", len(true) / len(cases), f"of the scenes at {level}")
    if not len(true):
        return
    below = float(np.mean(true <= 1.1 * level))
    figure("until_sure_holds", below, "true error at most 1.1 levels", ">= 0.9", below >= 0.9)
    close = float(np.mean(np.abs(true / level - 1) <= 0.1))
    figure("until_sure_close", close, "true error within 10 % of the level", ">= 0.9", close >= 0.9)
    figure("until_sure_median", float(np.median(true)) / level, "levels")


if __name__ == "__main__":
    main(float(sys.argv[1]) if sys.argv[1:] else 0.35, int(sys.argv[2]) if sys.argv[2:] else SCENES)
