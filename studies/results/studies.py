"""What is measured of NANO alone: its noise estimate, its grids, its convergence, its speed."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import fmean
from typing import Any

import torch

from studies import noise_figure
from studies.grid_study import COARSEST, GRIDS, study
from studies.results.kept import Kept, kept, of_files, of_method
from studies.results.tables import table
from studies.results.targets import Target

SCENES_A_GRID = 12
BENCHMARK = Path("benchmarks/nano.py")


def grids(method: str, scenes: int = SCENES_A_GRID) -> list[dict[str, Any]]:
    """One set of weights of a method on several grids and bin widths."""

    def measure(_: Path) -> tuple[Any, dict[str, Any]]:
        return [asdict(reached) for reached in study(method, scenes)], {}

    name = "grids" if method == "nano" else f"grids-{method}"
    depends = of_method(method) | {"grids": GRIDS, "scenes": scenes, "coarsest": COARSEST}
    found: list[dict[str, Any]] = kept(name, depends, measure).figures
    return found


def grid_table(found: dict[str, list[dict[str, Any]]]) -> str:
    """PSNR on each grid and on the coarsest one's pixels, and against the trained grid, by method."""
    head = ["points along the wall", "bins"]
    for method in found:
        head += [f"{method}, dB", "against the trained grid", f"on {COARSEST} x {COARSEST} pixels, dB", "depth MAD, mm"]
    body = []
    for k, grid in enumerate(next(iter(found.values()))):
        line = [str(grid["points"]), str(grid["bins"])]
        for own in found.values():
            psnr, coarse, mad_mm = own[k]["psnr"], own[k]["psnr_coarse"], 1e3 * own[k]["depth_mad_m"]
            line += [f"{psnr:.2f}", f"{psnr - own[0]['psnr']:+.2f}", f"{coarse:.2f}", f"{mad_mm:.1f}"]
        body.append(line)
    return table(head, body)


def speed() -> list[dict[str, Any]]:
    """What benchmarks/nano.py prints."""

    def measure(_: Path) -> tuple[Any, dict[str, Any]]:
        run = subprocess.run([sys.executable, str(BENCHMARK)], capture_output=True, text=True, check=True, timeout=900)
        return [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{")], {}

    depends = of_method("nano") | {"benchmark": of_files([BENCHMARK])}
    found: list[dict[str, Any]] = kept("speed", depends, measure).figures
    return found


def drawn(name: str, measure: Callable[[Path], dict[str, Any]], pictures: Path, more: Sequence[Path] = ()) -> Kept:
    """A study of NANO with one drawing, put beside the page."""
    depends = of_method("nano") | {"more": of_files(more)}
    found = kept(name, depends, lambda path: (measure(path), {}))
    shutil.copyfile(found.drawing, pictures / f"{name}.png")
    return found


def targets(levels: Kept, grid: list[dict[str, Any]], fast: list[dict[str, Any]]) -> list[Target]:
    """Targets that are not about the rendered scenes."""
    fit = levels.figures
    found = [Target("nle", "noise level, R² on held-out kinds, photon noise", 0.98, True, fit["r_squared"], "", 4)]
    rising = float(noise_figure.monotone(fit["beyond"]))
    found.append(Target("nle", "noise level monotone beyond the training range (1 = yes)", 1, True, rising, "", 0))
    trained_psnr = grid[0]["psnr"]
    for one in grid[1:]:
        what = f"PSNR lost at {one['points']} x {one['points']} points and {one['bins']} bins"
        found.append(Target("grids", what, 1, False, trained_psnr - one["psnr"], "dB"))
    for one in fast:
        wanted = float(str(one["target"]).removeprefix("<= "))
        what = f"`{one['figure']}` of benchmarks/nano.py"
        found.append(Target("speed", what, wanted, False, one["value"], one["unit"]))
    if not torch.cuda.is_available():
        found.append(
            Target(
                "speed",
                '`gpu_ms` of benchmarks/nano.py (no GPU here; on another machine 76, see "Speed and size")',
                50,
                False,
                None,
                "ms",
            )
        )
    return found


def spread(values: Sequence[float]) -> str:
    """Mean, least and most."""
    return f"{fmean(values):.2f} ({min(values):.2f} to {max(values):.2f})"


def convergence_text(found: Kept) -> str:
    """The estimates as a table, one column a network."""
    scans = len(next(iter(found.figures.values()))["whole_passes"])
    rows: dict[str, Callable[[dict[str, Any]], str]] = {
        "C_l, lifting": lambda one: f"{one['lifting']:.2f}",
        "I - dt S, largest of the iterations": lambda one: f"{max(one['iterations']):.2f}",
        "I - dt S, each": lambda one: " ".join(f"{value:.2f}" for value in one["iterations"]),
        "C_p, projection": lambda one: f"{one['projection']:.2f}",
        "C_p C_B^K C_l, C_B the largest": lambda one: f"{one['product']:.3g}",
        "the same with each iteration's own": lambda one: f"{one['own_product']:.3g}",
        f"whole pass u(1) -> u(2), {scans} scans: mean (least to most)": lambda one: spread(one["whole_passes"]),
        "relative change of each iteration, log10": lambda one: " ".join(f"{v:.2f}" for v in one["changes"]),
        f"relative change after pass 1, 2, 4, 8, 11, log10, mean of {scans} scans": lambda one: " ".join(
            f"{fmean(changes[k] for changes in one['log10_changes']):.1f}" for k in (0, 1, 3, 7, 10)
        ),
        f"a change over the one before, of the last five, {scans} scans": lambda one: (
            spread(one["ratios"]) if one["lifting"] else "-"
        ),
    }
    found_by = list(found.figures.items())
    body = [[what, *(show(one) for _, one in found_by)] for what, show in rows.items()]
    return table(["", *(name for name, _ in found_by)], body)
