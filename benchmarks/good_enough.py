"""What `scan --until stable` saves: bench time of scans ended early and of whole ones, and their pictures' errors.

Simulated scenes, 64 x 64 points coarse to fine, pictures by NANO. One JSON line a figure.
error: relative L2 of the front view against the albedo that was drawn, at the best scale. Cases go to stderr.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
from drawn_scenes import CREATURE, bench, picture_of

from nlos.acquisition.wall import WallGrid

SCAN = """\
wall: {{width_m: 1.0, height_m: 1.0, rows: 64, cols: 64}}
pattern: {{kind: coarse_to_fine, batch: 64}}
dwell_ms: {dwell_ms}
histogram: {{bins: 1024, bin_width_ps: 16, offset_ns: 10}}
"""
SCENES = {
    "letters": [
        {"letter": "S", "centre_m": [-0.22, 0.0, 0.63], "height_m": 0.42},
        {"letter": "U", "centre_m": [0.22, 0.0, 1.0], "height_m": 0.42},
    ],
    "creature": [
        {
            "bitmap": CREATURE,
            "centre_m": [0.0, 0.0, 0.7],
            "height_m": 0.5,
        }
    ],
}
DWELLS_MS = (1, 8)


def main() -> None:
    early_s = whole_s = 0.0
    worse: list[float] = []
    for name, objects in SCENES.items():
        for dwell_ms in DWELLS_MS:
            with tempfile.TemporaryDirectory() as folder:
                there = Path(folder)
                (there / "scan.yaml").write_text(SCAN.format(dwell_ms=dwell_ms))
                (there / "bench.yaml").write_text(bench(objects, 1, 500e3))
                whole, early = scan(there, "whole.h5"), scan(there, "early.h5", "--until", "stable")
                errors = [
                    error(there / run, picture_of(objects, WallGrid(1.0, 1.0, 64, 64)))
                    for run in ("whole.h5", "early.h5")
                ]
            early_s, whole_s = early_s + early["bench_s"], whole_s + whole["bench_s"]
            worse.append(errors[1] / errors[0])
            case = {"scene": name, "dwell_ms": dwell_ms, "points": early["points"], "of": whole["points"]}
            times = {"bench_s": round(early["bench_s"], 2), "whole_s": round(whole["bench_s"], 2)}
            ended = {**case, **times, "error": round(errors[1], 3), "whole_error": round(errors[0], 3)}
            print(json.dumps(ended), file=sys.stderr)
    figure("until_stable_time_saved", 1 - early_s / whole_s, "of the bench time")
    figure("until_stable_error_ratio", float(np.median(worse)), "of the whole scan's error")


def scan(there: Path, name: str, *options: str) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, "-m", "nlos", "scan", "scan.yaml", "--bench", "bench.yaml", "-o", name, "--json", *options],
        cwd=there, capture_output=True, text=True, check=True, timeout=600,
    )  # fmt: skip
    answer = json.loads(done.stdout)
    return {"bench_s": float(answer["bench_s"]), "points": answer["points"]}


def error(run: Path, truth: npt.NDArray[np.float64]) -> float:
    subprocess.run(
        [sys.executable, "-m", "nlos", "reconstruct", str(run), "--method", "nano", "-o", str(run.with_suffix(""))],
        capture_output=True, check=True, timeout=600,
    )  # fmt: skip
    with h5py.File(run.with_suffix("") / "reconstruction.h5") as file:
        seen = np.asarray(file["albedo"], dtype=np.float64)
    scale = float(np.vdot(seen, truth) / np.vdot(seen, seen))
    return float(np.linalg.norm(scale * seen - truth) / np.linalg.norm(truth))


def figure(name: str, value: float, unit: str) -> None:
    print(json.dumps({"figure": name, "value": round(value, 4), "unit": unit, "target": None, "met": None}))


if __name__ == "__main__":
    main()
