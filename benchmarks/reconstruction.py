"""How fast the physics methods are, against the FFTs that no light-cone transform can do without.

Prints one JSON line a figure. The floor is one pruned forward and one pruned inverse real FFT at twice the size on each
axis, measured in turns with the method in one process. Memory is the peak of a process of its own that only runs the
method. With --table: every method at three sizes; on a GPU too where there is one; y-tal beside them if installed.
"""

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.fft
import torch
from torch import nn

from nlos.acquisition.transient import TimeAxis
from nlos.acquisition.wall import WallGrid
from nlos.recon.methods import find, parse_settings

SIZES = ((64, 512), (128, 512), (256, 1024))
METHODS = ("lct", "fk", "phasor", "backprojection", "gram")
OVER_FLOOR = {"lct": 1.6, "fk": 4.0, "phasor": 10.0}
GIGABYTES = {"lct": 1.0, "fk": 1.6, "phasor": 2.0}
ROUNDS = 7


def counts(points: int, bins: int, device: str = "cpu") -> torch.Tensor:
    """A noisy transient of (1, 1, T, H, W): what is in it makes no difference to the time."""
    rate = torch.linspace(0.1, 2.0, bins)[:, None, None].expand(bins, points, points)
    return torch.poisson(rate, generator=torch.Generator().manual_seed(0))[None, None].to(device)


def build(method: str, points: int, bins: int) -> nn.Module:
    """The method at its defaults for a wall of 2 m and 32 ps bins."""
    settings = parse_settings(method, {})
    return find(method).build(settings, WallGrid(2.0, 2.0, points, points), TimeAxis(bins, 32e-12)).eval()


def floor_seconds(points: int, bins: int) -> float:
    """One pruned forward and one pruned inverse real FFT at (2 T, 2 H, 2 W)."""
    data = np.ones((bins, points, points), dtype=np.float32)
    workers = torch.get_num_threads()
    began = time.perf_counter()
    spectrum = scipy.fft.rfft(data, n=2 * bins, axis=0, workers=workers)
    spectrum = scipy.fft.fft(spectrum, n=2 * points, axis=2, workers=workers)
    spectrum = scipy.fft.fft(spectrum, n=2 * points, axis=1, workers=workers)
    spectrum = scipy.fft.ifft(spectrum, axis=1, overwrite_x=True, workers=workers)[:, :points]
    spectrum = scipy.fft.ifft(spectrum, axis=2, workers=workers)[:, :, :points]
    scipy.fft.irfft(spectrum, n=2 * bins, axis=0, workers=workers)
    return time.perf_counter() - began


def timed(call: Callable[[], Any]) -> float:
    """Seconds of one call, until a GPU has finished it."""
    began = time.perf_counter()
    call()
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    return time.perf_counter() - began


def measure(method: str, points: int, bins: int, device: str, rounds: int) -> dict[str, float]:
    """First and best later call, best floor, in seconds."""
    data = counts(points, bins, device)
    with torch.inference_mode():
        floors = [floor_seconds(points, bins)]
        first = timed(lambda: build(method, points, bins).to(device).volume(data))
        module = build(method, points, bins).to(device)
        module.volume(data)
        calls = []
        for _ in range(rounds):
            floors.append(floor_seconds(points, bins))
            calls.append(timed(lambda: module.volume(data)))
    return {"first": first, "cached": min(calls), "floor": min(floors)}


def peak(method: str, points: int, bins: int) -> dict[str, float]:
    """Peak memory of this process, which does nothing else, in GB."""
    module, data = build(method, points, bins), counts(points, bins)
    with torch.inference_mode():
        module.volume(data)
    return {"gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6}


def ytal(points: int, bins: int) -> float:
    """y-tal's LCT, one call with its set-up, in seconds. Raises ImportError where it is not installed."""
    import tal  # optional peer, never a dependency

    capture = tal.io.capture.NLOSCaptureData()
    edges = (np.arange(points) + 0.5) / points * 2 - 1
    grid = np.stack([*np.meshgrid(edges, edges, indexing="ij"), np.zeros((points, points))], axis=-1).astype(np.float32)
    capture.H = counts(points, bins)[0, 0].numpy()
    capture.H_format = tal.enums.HFormat.T_Sx_Sy
    capture.sensor_xyz = capture.laser_xyz = np.array([0.0, 0.0, 1.0], dtype=np.float32)
    capture.sensor_grid_xyz = capture.laser_grid_xyz = grid
    normals = np.zeros_like(grid)
    normals[..., 2] = 1
    capture.sensor_grid_normals = capture.laser_grid_normals = normals
    capture.sensor_grid_format = capture.laser_grid_format = tal.enums.GridFormat.X_Y_3
    capture.delta_t, capture.t_start, capture.t_accounts_first_and_last_bounces = 32e-12 * 299_792_458.0, 0.0, False
    began = time.perf_counter()
    tal.reconstruct.lct.solve(capture)
    return time.perf_counter() - began


def alone(*arguments: str) -> dict[str, float]:
    """This script in a process of its own."""
    done = subprocess.run([sys.executable, __file__, *arguments], capture_output=True, text=True, check=True)
    result: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return result


def tell(figure: str, value: float, unit: str, target: float) -> None:
    line = {"figure": figure, "value": round(value, 4), "unit": unit, "target": target, "met": value <= target}
    print(json.dumps(line), flush=True)


def figures() -> None:
    """Every figure with its target."""
    for method in ("lct", "fk", "phasor"):
        times = alone("--measure", method, "128", "512", "--rounds", str(ROUNDS))
        tell(f"{method}_over_floor", times["cached"] / times["floor"], "ratio", OVER_FLOOR[method])
        tell(f"{method}_gb", alone("--peak", method, "128", "512")["gb"], "GB", GIGABYTES[method])
        tell(f"{method}_first_call", times["first"] / times["cached"], "ratio", 3.0)
    for method in ("lct", "fk"):
        small = alone("--measure", method, "64", "512", "--rounds", str(ROUNDS))["cached"] / (64 * 64 * 512)
        large = alone("--measure", method, "256", "1024", "--rounds", "3")["cached"] / (256 * 256 * 1024)
        tell(f"{method}_growth", large / small, "ratio", 2.0)


def table() -> None:
    """Every method at every size: a JSON line each."""
    for device in ("cpu", "cuda") if torch.cuda.is_available() else ("cpu",):
        for points, bins in SIZES:
            for method in METHODS:
                size = (str(points), str(bins))
                times = alone("--measure", method, *size, "--rounds", "3", "--device", device)
                row = {"method": method, "device": device, "size": f"{points} x {points} x {bins}"}
                row |= {f"{key}_s": round(value, 4) for key, value in times.items()}
                row["over_floor"] = round(times["cached"] / times["floor"], 2)
                if device == "cpu":
                    row["gb"] = round(alone("--peak", method, *size)["gb"], 3)
                print(json.dumps(row), flush=True)
    try:
        for points, bins in SIZES[:2]:
            row = {"method": "y-tal lct", "device": "cpu", "size": f"{points} x {points} x {bins}"}
            print(json.dumps(row | {"cached_s": round(ytal(points, bins), 3)}), flush=True)
    except ImportError:
        print("y-tal is not installed; without it there is no row for it (pip install y-tal)", file=sys.stderr)


def main() -> None:
    """Figures, and the table if asked for; the other options are for the processes that this one starts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--table", action="store_true", help="every method at three sizes")
    parser.add_argument("--measure", nargs=3, metavar=("METHOD", "POINTS", "BINS"), help=argparse.SUPPRESS)
    parser.add_argument("--peak", nargs=3, metavar=("METHOD", "POINTS", "BINS"), help=argparse.SUPPRESS)
    parser.add_argument("--rounds", type=int, default=3, help=argparse.SUPPRESS)
    parser.add_argument("--device", default="cpu", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.measure:
        method, points, bins = chosen.measure
        print(json.dumps(measure(method, int(points), int(bins), chosen.device, chosen.rounds)))
    elif chosen.peak:
        method, points, bins = chosen.peak
        print(json.dumps(peak(method, int(points), int(bins))))
    else:
        figures()
        if chosen.table:
            table()


if __name__ == "__main__":
    main()
