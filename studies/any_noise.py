"""Fits the estimate of noise of any kind that comes with NANO's weights, on simulated scans of known noise.

`python -m studies.any_noise gather FOLDER` draws the scans (an hour of a core),
`python -m studies.any_noise fit FOLDER recon/weights/nano.noise [KEPT.noise [SET,...]]` fits the networks to them, all
or those sets of KEPT.noise that are named. What ships was fitted a set at a time: many points first, for another fit of
these was a little worse on measured scans. Scenes are of the kinds that NANO is trained on; those that are held out,
and everything measured, are never seen.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from safetensors.torch import load_file
from torch import Tensor, nn

from nlos.recon.layers.any_noise import FEW, MIDDLE, OWN, PEAK, POINTS, AnyNoise, noise_traits
from nlos.recon.layers.counts import added
from nlos.recon.layers.rates import rates_of
from nlos.recon.layers.wiener_volumes import rebinned_axis
from nlos.recon.methods.nano import Nano, Settings, build
from nlos.recon.training.dataset import _transient
from nlos.recon.training.dataset_settings import DatasetSettings
from nlos.recon.training.detector import Measurement, measure
from nlos.recon.training.scenes import make_scene
from nlos.recon.weights.files import save, sha256_of
from studies.noise_figure import KINDS

STEPS, BATCH, RATE, DECAY = 8000, 512, 2e-3, 0.1
EVERY = 10  # one scene in so many is kept for validation
AROUND = 0.02  # noise of the inputs, in their standard deviations


@dataclass(frozen=True)
class Part:
    """Scans of scenes of one seed: (rows, columns, bins, bin in ps, wall in m, weight) of the grids, kinds of noise,
    share of sparse scans and of slow detectors, and the set of networks that it is for alone, if any."""

    seed: int
    scenes: int
    grids: tuple[tuple[int, int, int, float, float, float], ...]
    kinds: tuple[str, ...]
    sparse: float
    slow: float
    alone: str = ""


ALIKE = ("photons", "uniform", "grain", "grain", "uniform")
PARTS = (
    Part(
        5, 562,
        (
            (64, 64, 256, 64.0, 2.0, 0.28), (32, 32, 256, 64.0, 2.0, 0.30), (24, 40, 128, 100.0, 2.0, 0.12),
            (16, 16, 256, 64.0, 2.0, 0.12), (48, 48, 256, 32.0, 1.0, 0.10), (40, 40, 300, 32.0, 0.7, 0.08),
        ),
        ("photons", "uniform", "grain", "photons and uniform", "photons and grain", "photons"), 0.3, 0.2,
    ),
    Part(6, 383, ((64, 64, 256, 64.0, 2.0, 0.8), (32, 32, 256, 64.0, 2.0, 0.2)), ALIKE, 0.45, 0.0),
    Part(7, 258, ((64, 64, 256, 64.0, 2.0, 0.8), (32, 32, 256, 64.0, 2.0, 0.2)), ALIKE, 0.45, 0.0),
    Part(
        8, 2000,
        ((32, 32, 256, 64.0, 2.0, 0.25), (16, 16, 256, 64.0, 2.0, 0.4), (8, 8, 256, 64.0, 2.0, 0.35)),
        ("photons", "uniform", "grain", "photons", "uniform", "grain"), 0.25, 0.0, "few",
    ),
    Part(
        9, 2400,
        (
            (32, 32, 256, 64.0, 2.0, 0.40), (32, 32, 256, 32.0, 1.0, 0.10), (24, 40, 128, 100.0, 2.0, 0.08),
            (40, 25, 256, 64.0, 2.0, 0.05), (20, 20, 256, 64.0, 2.0, 0.07), (16, 16, 256, 64.0, 2.0, 0.20),
            (8, 8, 256, 64.0, 2.0, 0.10),
        ),
        ("photons", "uniform", "grain", "photons", "uniform", "grain", "photons and uniform", "photons and grain"),
        0.0, 0.0, "middle",
    ),
)  # fmt: skip
Counts = npt.NDArray[np.float32]


def with_more(got: Measurement, kind: str, draw: np.random.Generator) -> tuple[Counts, float]:
    """Counts and noise level of a measurement; where `kind` says so, with noise of another kind on top of the photons',
    from a tenth of theirs to three times it."""
    counts, seen = got.counts.astype(np.float32), got.exposure > 0
    if " and " not in kind:
        return counts, got.noise_level
    photons = counts.mean(axis=0)
    deviation = 10 ** draw.uniform(-1, 0.5) * np.sqrt(photons[seen].mean())
    if kind.endswith("uniform"):
        added_noise = draw.uniform(0, 1, counts.shape).astype(np.float32) * np.float32(deviation * 12**0.5)
        variance = np.full_like(photons, deviation**2)
        counts = counts + added_noise * seen
    else:
        grain = min(deviation / np.sqrt(np.square(counts[:, seen]).mean()), 0.5)
        variance = (np.square(counts) * grain**2).mean(axis=0)
        counts = np.maximum(counts * (1 + grain * draw.standard_normal(counts.shape, dtype=np.float32)), 0)
    own, both = (np.mean((what / got.exposure**2)[seen]) for what in (photons, photons + variance))
    return counts, float(got.noise_level * np.sqrt(both / own))


def scans(part: Part, network: Nano) -> Iterator[tuple[list[npt.NDArray[np.float32]], list[float]]]:
    """Of each scene the traits of its scans and log10 of their noise levels."""
    rng = np.random.default_rng(part.seed)
    weights = np.array([grid[-1] for grid in part.grids])
    for scene in range(1, part.scenes + 1):
        rows, cols, bins, bin_ps, width_m, _ = part.grids[rng.choice(len(part.grids), p=weights / weights.sum())]
        data = DatasetSettings(
            seed=part.seed, scenes=100_000, degradations=1, rows=rows, cols=cols, bins=bins, bin_width_ps=bin_ps,
            wall_width_m=width_m,
        )  # fmt: skip
        shown = make_scene(part.seed, scene, data.wall, held_out=False, kinds=())
        transient = _transient(data, shown, np.random.default_rng((part.seed, scene)))
        traits, levels = [], []
        for number, kind in enumerate(part.kinds if transient.max() > 0 else ()):
            detector = KINDS[kind.split(" and ")[0]].model_copy(update={"sparse": part.sparse, "slow": part.slow})
            draw = np.random.default_rng((part.seed, scene, number))
            try:
                got = measure(transient, data.time, detector, draw)
            except ValueError:  # no light inside the time axis
                continue
            counts, level = with_more(got, kind, draw)
            traits.append(traits_of(network, data, counts, got.exposure))
            levels.append(float(np.log10(level)))
        yield traits, levels


@torch.no_grad()
def traits_of(network: Nano, data: DatasetSettings, counts: Counts, exposure: Counts) -> npt.NDArray[np.float32]:
    """(INPUTS,) of one scan."""
    factor, axis = rebinned_axis(data.wall, data.time)
    rates = rates_of(added(torch.from_numpy(counts)[None, None], factor, axis.bins), torch.from_numpy(exposure)[None])
    photons, _, known = network.noise_level.with_statistics(rates.raw, rates.exposure)
    size_m = data.wall.height_m, data.wall.width_m
    found: npt.NDArray[np.float32] = noise_traits(rates, known, photons, size_m, axis.bin_width_s)[0].numpy()
    return found


def gather(folder: Path) -> None:
    """A file a part."""
    folder.mkdir(parents=True, exist_ok=True)
    data = DatasetSettings()
    network = build(Settings(), data.wall, data.time)
    for part in PARTS:
        path = folder / f"{part.seed}.npz"
        if path.exists():
            continue
        traits: list[Any] = []
        levels: list[float] = []
        scenes: list[int] = []
        for scene, (more, true) in enumerate(scans(part, network), 1):
            traits += more
            levels += true
            scenes += [scene] * len(true)
        np.savez(path, traits=np.array(traits), levels=np.array(levels), scenes=np.array(scenes))


def fit(folder: Path, weights: Path, kept: Path | None = None, anew: str = "corrections,middle,few") -> None:
    """Fits, prints the error in decades on held-out scenes, and stores. `kept`: weights of before, of which all sets of
    networks stay as they are but those that are named in `anew`."""
    sets = anew.split(",")
    chosen = [part for part in PARTS if {"corrections", "few"} & set(sets) or part.alone in sets]
    parts = [np.load(folder / f"{part.seed}.npz") for part in chosen]
    traits, levels = (
        torch.from_numpy(np.concatenate([p[name] for p in parts])).float() for name in ("traits", "levels")
    )
    left_out = torch.from_numpy(np.concatenate([p["scenes"] for p in parts]) % EVERY == 0)
    alone = np.concatenate([np.full(len(p["levels"]), part.alone) for part, p in zip(chosen, parts, strict=True)])
    network = AnyNoise()
    if kept is not None:
        network.load_state_dict(load_file(kept), strict=False)
    points = 10 ** traits[:, POINTS]
    seen_by = {
        "corrections": torch.from_numpy(alone == ""),
        "middle": torch.from_numpy(alone == "middle") & (points >= MIDDLE[0]),
        "few": torch.from_numpy(alone != "middle") & (points < FEW[1]),
    }
    usable = torch.isfinite(traits).all(dim=1) & torch.isfinite(levels)
    wanted = levels - (traits[:, 0] - traits[:, OWN + PEAK])
    for name in sets:
        here = usable & seen_by[name]
        for seed, member in enumerate(getattr(network, name)):
            torch.manual_seed(seed)
            fit_one(cast(nn.Sequential, member), traits[here & ~left_out], wanted[here & ~left_out])
        with torch.no_grad():
            error = (network(traits[here & left_out]) - levels[here & left_out]).numpy()
        print(f"{name}: {len(error)} scans held out, bias {error.mean():+.3f}, scatter {error.std():.3f} decades")
    about = {"of": sha256_of("nano"), "anew": anew, "scans": int((usable & ~left_out).sum()), "steps": STEPS}
    save(weights, dict(network.named_parameters()), about)


def fit_one(member: nn.Sequential, traits: Tensor, wanted: Tensor) -> None:
    """Fits a network to corrections `wanted` (N,) of traits (N, INPUTS); Huber's loss, for a few scans
    are far off."""
    mean, deviation = traits.mean(dim=0), traits.std(dim=0).clamp(min=1e-3)
    inputs = (traits - mean) / deviation
    optimiser = torch.optim.AdamW(member.parameters(), lr=RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, STEPS)
    for _ in range(STEPS):
        batch = torch.randint(len(inputs), (BATCH,))
        seen = inputs[batch]
        found = member(seen + AROUND * torch.randn_like(seen))[:, 0]
        optimiser.zero_grad()
        F.huber_loss(found, wanted[batch], delta=0.1).backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        schedule.step()
    first = cast(nn.Linear, member[0])
    with torch.no_grad():  # so that it takes traits as they are
        first.bias.sub_((first.weight * (mean / deviation)).sum(dim=1))
        first.weight.div_(deviation)


if __name__ == "__main__":
    if sys.argv[1] == "gather":
        gather(Path(sys.argv[2]))
    else:
        folder, to, *before = sys.argv[2:]
        fit(Path(folder), Path(to), Path(before[0]) if before else None, *before[1:])
