"""The noise level of measured scans against repeats of the same scan.

No scan here was measured twice, so its photons are dealt out: each goes into one half or the other at random, which
makes two independent scans of half the dwell, and half their mean square difference is the noise of either, whoever
estimates it. Uniform noise or grain may be added to both, drawn anew for each. The signal's mean peak is read off one
half where the other, smoothed, has it. `python -m studies.noise_repeats ../shared/data/real`.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from scipy.ndimage import uniform_filter

from nlos.recon.layers.rates import rates_of
from nlos.recon.methods.nano import Settings, build
from studies.added_noise import behind_direct_light
from studies.noise_figure import NoiseFit, best_of

SCENES = (
    "statue_full", "ahn_2019", "ahn_toy", "otoole_s_u", "otoole_resolution_40cm", "otoole_dots_65cm",
    "otoole_mannequin_directcut", "far_mannequin",
)  # fmt: skip
SHARES = (1.0, 0.25, 0.06)  # of the photons
UNIFORM = (0.01, 0.04)  # of the brightest bin; the paper's go up to 0.04
GRAIN = (0.1, 0.3)
Cube = npt.NDArray[np.float32]


def halves(counts: Cube, share: float, rng: np.random.Generator) -> tuple[Cube, Cube]:
    """Two independent scans of `share` / 2 of the photons each."""
    whole = counts.astype(np.int64)
    kept = whole if share == 1 else rng.binomial(whole, share)
    one = rng.binomial(kept, 0.5)
    return one.astype(np.float32), (kept - one).astype(np.float32)


def degraded(counts: Cube, kind: str, amount: float, rng: np.random.Generator) -> Cube:
    """With noise of another kind on top, where there is anything."""
    if kind == "uniform":
        return counts + np.float32(amount * counts.max()) * rng.random(counts.shape, dtype=np.float32) * _lit(counts)
    if kind == "grain":
        smooth = uniform_filter(counts, 3)
        return np.maximum(counts + np.float32(amount) * smooth * rng.standard_normal(counts.shape, dtype=np.float32), 0)
    return counts


def _lit(counts: Cube) -> npt.NDArray[np.bool_]:
    """Bins that were recorded at all."""
    return np.asarray(counts.any(axis=(1, 2), keepdims=True))


def peak_of(one: Cube, other: Cube) -> float:
    """The mean over the wall of the signal's highest bin, in scans (T, H, W) without added noise: where one of them,
    smoothed, has it, it is read off the other, so that its noise does not add."""
    background = float(np.quantile(uniform_filter(one.mean(axis=(1, 2)), 8), 0.1))
    read = [
        np.take_along_axis(b, uniform_filter(a, 3).argmax(axis=0)[None], axis=0)[0]
        for a, b in ((one, other), (other, one))
    ]
    return float(np.mean(read)) - background


def repeats(counts: Cube, share: float, rng: np.random.Generator) -> Iterator[tuple[str, Cube, Cube]]:
    """(kind of noise, one scan, the other) of a share of the photons."""
    one, other = halves(counts, share, rng)
    yield "photons", one, other
    for kind, amounts in (("uniform", UNIFORM), ("grain", GRAIN)):
        for amount in amounts:
            yield kind, degraded(one, kind, amount, rng), degraded(other, kind, amount, rng)


@torch.inference_mode()
def main(data: Path, seed: int = 1) -> None:
    found: dict[str, list[tuple[float, float, float]]] = {}
    for name in SCENES:
        transient, _ = behind_direct_light(data / f"{name}.h5")
        network = build(Settings(), transient.wall, transient.time)
        rng = np.random.default_rng(seed)
        peak = 0.0
        drawn = ((share, *pair) for share in SHARES for pair in repeats(transient.counts, share, rng))
        for at, kind, *pair in drawn:
            cubes = [network.physics.rebin(torch.from_numpy(cube)[None, None]) for cube in pair]
            one, other = (cube[0, 0].numpy() for cube in cubes)
            peak = peak or peak_of(one, other)
            noise = float(np.sqrt(np.mean(np.square(one - other, dtype=np.float64)) / 2))
            true = float(np.log10(noise / (at * peak)))
            rates = rates_of(cubes[0], None)
            if not float(rates.presence):
                print(f"{name} {kind} {at:g}: true {true:.2f}, no signal seen", flush=True)
                continue
            photons, _, any_kind = network.noise_of_all_kinds(rates)
            estimates = float(photons), float(best_of(photons, any_kind))
            found.setdefault(kind, []).append((true, *estimates))
            print(
                f"{name} {kind} {at:g}: true {true:.2f}, photons' {estimates[0]:.2f}, any kind's {estimates[1]:.2f}",
                flush=True,
            )
    for kind, values in found.items():
        columns = np.array(values).T
        for word, estimated in zip(("photons'", "any kind's"), columns[1:], strict=True):
            fit = NoiseFit(columns[0], estimated)
            print(
                f"{kind}, {word}: R^2 {fit.r_squared:.3f}, bias {fit.bias:+.3f}, scatter {fit.scatter:.3f} decades, "
                f"{len(values)} pairs"
            )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
