"""How well the noise level is estimated: R^2 and bias of each kind of noise, order beyond the training range.

`python -m studies.noise_figure FIGURE.png [WEIGHTS]` measures the weights that come with the program, or others, on
held-out scenes. Photon noise, uniform noise and grain are judged apart: what holds for one need not for another.
`python -m studies.noise_figure points`: the same on 32 x 32 points, 16 x 16 and 8 x 8.
"""

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nlos.recon.layers.any_noise import unless_photons
from nlos.recon.layers.rates import rates_of
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.training.dataset import sample
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import DetectorSettings
from nlos.recon.training.training_sample import collate
from nlos.recon.weights.files import put_part

INSIDE = DetectorSettings(noiseless=0.0, uniform=0.0, peak_counts_least=0.4, peak_counts_most=200.0)
KINDS = {
    "photons": INSIDE,
    "uniform": DetectorSettings(noiseless=0.0, uniform=1.0),
    "grain": DetectorSettings(noiseless=1.0, uniform=0.0),
}
BEYOND = (0.05, 0.1, 0.2, 400.0, 1600.0)  # mean peak counts that no training sample has
WAYS = ("photon statistics", "any kind", "told")
"""Estimates: of photon statistics alone, of noise of any kind, and what NANO's operator is told, which is the former
unless the latter contradicts."""
SHOWN, TOLD = "any kind", "told"
SIDES = (32, 16, 8)  # points a side of coarser scans
SCANS = 60  # of held-out kinds, inside the training range


@dataclass(frozen=True)
class NoiseFit:
    """Estimated against true noise level, in decades."""

    true: npt.NDArray[np.float64]
    estimated: npt.NDArray[np.float64]

    @property
    def r_squared(self) -> float:
        """Share of the variance of the truth that the estimate explains."""
        residual = np.square(self.true - self.estimated).sum()
        return float(1 - residual / np.square(self.true - self.true.mean()).sum())

    @property
    def bias(self) -> float:
        """Mean of the estimate less the truth."""
        return float((self.estimated - self.true).mean())

    @property
    def scatter(self) -> float:
        """Standard deviation of the estimate about the truth and its bias."""
        return float((self.estimated - self.true).std())


def best_of(photons: Tensor, any_kind: Tensor) -> Tensor:
    """The estimate of noise of any kind, photon statistics where there is none."""
    return torch.where(torch.isfinite(any_kind), any_kind, photons)


def estimates(network: Nano, data: DatasetSettings, count: int) -> dict[str, NoiseFit]:
    """Of the first `count` samples of `data`, by `WAYS`."""
    true: list[float] = []
    estimated: dict[str, list[float]] = {way: [] for way in WAYS}
    for index in range(count):
        batch = collate([sample(data, index)])
        rates = rates_of(network.physics.rebin(batch["counts"]), batch["exposure"])
        with torch.no_grad():
            photons, _, any_kind = network.noise_of_all_kinds(rates)
        levels = photons, best_of(photons, any_kind), unless_photons(photons, any_kind)
        for way, level in zip(WAYS, levels, strict=True):
            estimated[way].append(float(level))
        true.append(float(batch["noise_level"].log10()))
    return {way: NoiseFit(np.asarray(true), np.asarray(values)) for way, values in estimated.items()}


def held_out(detector: DetectorSettings, scenes: int) -> DatasetSettings:
    """Scenes of kinds that no training saw."""
    return DatasetSettings(seed=3, scenes=scenes, degradations=1, held_out=True, detector=detector)


def with_noise_estimation(weights: str | None, data: DatasetSettings) -> Nano:
    """NANO as it ships, its noise estimation from other weights where those are given."""
    network = build(Settings(), data.wall, data.time)
    if weights is not None:
        put_part(network.noise_level, "noise_level.", weights)
    return network


def measure(path: Path, count: int = SCANS, weights: str | None = None) -> dict[str, Any]:
    """R^2 and bias of each kind, and the mean true and estimated level at each exposure beyond the training range;
    draws both to `path`."""
    from matplotlib.figure import Figure

    data = held_out(INSIDE, count)
    network = with_noise_estimation(weights, data)
    kinds = {name: estimates(network, held_out(detector, count), count) for name, detector in KINDS.items()}
    beyond = {}
    for peak in BEYOND:
        detector = INSIDE.model_copy(update={"peak_counts_least": peak, "peak_counts_most": peak * 1.001})
        beyond[peak] = estimates(network, held_out(detector, 8), 8)[SHOWN]
    drawing = Figure(figsize=(5, 4.5), layout="constrained")
    axes = drawing.subplots()
    outside = NoiseFit(
        np.concatenate([fit.true for fit in beyond.values()]),
        np.concatenate([fit.estimated for fit in beyond.values()]),
    )
    for name, ways in kinds.items():
        fit = ways[SHOWN]
        axes.plot(fit.true, fit.estimated, ".", label=f"{name}: R² {fit.r_squared:.3f}, bias {fit.bias:+.2f}")
    axes.plot(outside.true, outside.estimated, "x", label="photons, beyond the training range")
    ends = [-2.5, 0.5]
    axes.plot(ends, ends, "k", lw=0.8)
    axes.set(
        xlabel="true noise of a bin / mean peak (log10)",
        ylabel="estimated noise of a bin / mean peak (log10)",
        title="Noise level of scans of held-out kinds",
    )
    axes.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(path, dpi=80)
    levels = {f"{peak:g}": [float(fit.true.mean()), float(fit.estimated.mean())] for peak, fit in beyond.items()}
    found = {
        name: {way: {"r_squared": fit.r_squared, "bias": fit.bias, "scatter": fit.scatter} for way, fit in ways.items()}
        for name, ways in kinds.items()
    }
    return {"r_squared": kinds["photons"][SHOWN].r_squared, "kinds": found, "beyond": levels}


def monotone(levels: Mapping[str, Sequence[float]]) -> bool:
    """Whether the estimate falls as exposure grows, through all exposures beyond the training range."""
    estimated = [levels[peak][1] for peak in sorted(levels, key=float)]
    return all(a > b for a, b in pairwise(estimated))


def by_points(count: int = 80) -> Iterator[str]:
    """The same of whole scans on coarser grids, a line of Markdown each: R^2 and bias of the estimate of any kind and
    of what NANO is told."""
    for side in SIDES:
        cells = [f"{side} x {side}"]
        for way in (SHOWN, TOLD):
            for detector in KINDS.values():
                whole = held_out(detector.model_copy(update={"sparse": 0.0}), count)
                data = whole.model_copy(update={"rows": side, "cols": side})
                fit = estimates(with_noise_estimation(None, data), data, count)[way]
                cells.append(f"{fit.r_squared:.3f}, {fit.bias:+.2f}")
        yield f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    if sys.argv[1:] == ["points"]:
        print(*by_points(), sep="\n", flush=True)
    else:
        print(json.dumps(measure(Path(sys.argv[1]), weights=sys.argv[2] if len(sys.argv) > 2 else None)))
