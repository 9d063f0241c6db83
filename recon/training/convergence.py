"""Does algorithm 1 converge? Relative changes of its passes and iterations, and Lipschitz estimates of its parts.

`python -m recon.training.convergence FIGURE.png` measures the weights that come with the program on one simulated scan.
"""

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import cast

import torch
from torch import Tensor

from recon.layers.measurement import rates_of
from recon.layers.physical_unfolding import PhysicalUnfolding
from recon.methods.nano import Nano, Settings, build, conditions, confidence

Map = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Contraction:
    """Local Lipschitz estimates, and C_p C_B^K C_l, which theorem 2 of the paper asks to be below 1."""

    lifting: float  # B_l: features -> u^0
    projection: float  # B_p: u^K -> logits and features
    iterations: tuple[float, ...]  # I - dt S of each iteration, finest scale first
    whole_pass: float  # u^{s-1} -> u^s

    @property
    def product(self) -> float:
        """The bound of the theorem for this network: every factor at its own estimate."""
        return self.lifting * self.projection * float(torch.tensor(self.iterations).prod())


def lipschitz(function: Map, at: Tensor, steps: int = 12, seed: int = 0) -> float:
    """The largest singular value of the Jacobian of `function` at `at`, by power iteration on J^T J."""
    generator = torch.Generator().manual_seed(seed)
    direction = torch.randn(at.shape, generator=generator)
    value = 0.0
    for _ in range(steps):
        direction = direction / direction.norm().clamp(min=1e-30)
        pushed = torch.func.jvp(function, (at,), (direction,))[1]
        value = float(pushed.detach().norm())
        pull = torch.func.vjp(function, at)[1]
        direction = pull(pushed)[0].detach()
    return value


def relative_changes(states: list[Tensor]) -> list[float]:
    """log10 |u^{k+1} - u^k| / |u^{k+1}| of consecutive states (the paper's convergence curve)."""
    return [float((b - a).norm().div(b.norm().clamp(min=1e-30)).log10()) for a, b in pairwise(states)]


@torch.no_grad()
def passes(network: Nano, counts: Tensor, exposure: Tensor | None, count: int) -> list[Tensor]:
    """The volumes u^1 .. u^count of algorithm 1 on one measurement."""
    start, run = _one_pass(network, counts, exposure)
    states = [run(start)]
    for _ in range(1, count):
        states.append(run(states[-1]))
    return states


def contraction(network: Nano, counts: Tensor, exposure: Tensor | None = None, steps: int = 12) -> Contraction:
    """Lipschitz estimates at the states that one measurement runs through; for the physical reading."""
    unfolding = network.unfolding
    if not isinstance(unfolding, PhysicalUnfolding):
        raise ValueError("the estimates are made for the physical reading; build nano with reading=physical")
    start, run = _one_pass(network, counts, exposure)
    seen: list[tuple[torch.nn.Module, tuple[Tensor, ...]]] = []

    def note(module: torch.nn.Module, inputs: tuple[Tensor, ...]) -> None:
        seen.append((module, inputs))

    watched = [step for scale in unfolding.iterations for step in cast(torch.nn.ModuleList, scale)]
    hooks = [module.register_forward_pre_hook(note) for module in (*watched, unfolding.lift_u, network.head)]
    with torch.no_grad():
        run(start)
    for hook in hooks:
        hook.remove()
    values: dict[torch.nn.Module, float] = {}
    for module, (first, *others) in seen:

        def one(x: Tensor, module: torch.nn.Module = module, others: list[Tensor] = others) -> Tensor:
            out: Tensor = module(x, *others)
            return out

        values[module] = lipschitz(one, first.contiguous(), steps)
    return Contraction(
        lifting=values[unfolding.lift_u],
        projection=values[network.head],
        iterations=tuple(values[module] for module in watched),
        whole_pass=lipschitz(run, run(start).detach(), steps),
    )


def _one_pass(network: Nano, counts: Tensor, exposure: Tensor | None) -> tuple[Tensor, Map]:
    """u^0 = 0 and the map u^{s-1} -> u^s of one measurement."""
    with torch.no_grad():
        rates = rates_of(network.physics.rebin(counts), exposure)
        log_noise, noise_map = network.noise(rates)
        volumes = network.normalised(network.physics(rates.net, log_noise))
        eta = conditions(log_noise, rates)
        maps = confidence(log_noise, noise_map, rates.exposure)
        lifted = None if network.lifted is None else network.lifted(rates.net, log_noise)
        features = network.features(volumes, maps, lifted)

    def run(u: Tensor) -> Tensor:
        return network.operator(network.with_last(features, u), volumes, eta, maps).volume

    return torch.zeros_like(volumes[:, 0]), run


def figure(states: list[Tensor], found: Contraction, path: Path) -> None:
    """The curve of relative changes beside the Lipschitz estimates."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(9, 3.5), layout="constrained")
    left, right = drawing.subplots(1, 2)
    left.plot(range(1, len(states)), relative_changes(states), "o-")
    left.set(xlabel="pass s", ylabel="log10 |u(s+1) - u(s)| / |u(s+1)|", title="Algorithm 1")
    names = ["B_l", *(f"A_{k}" for k in range(len(found.iterations))), "B_p", "G"]
    right.bar(names, [found.lifting, *found.iterations, found.projection, found.whole_pass])
    right.axhline(1.0, color="k", lw=0.8)
    right.set(ylabel="local Lipschitz estimate", title=f"C_p C_B^K C_l = {found.product:.3g}")
    drawing.savefig(path)


def main(path: Path) -> None:
    """Measure, draw, and print the estimates as JSON."""
    from recon.training.dataset import DatasetSettings, collate, sample

    data = DatasetSettings(seed=2, scenes=1, degradations=1, held_out=True)
    batch = collate([sample(data, 0)])
    network = build(Settings(), data.wall, data.time)
    states = passes(network, batch["counts"], batch["exposure"], 12)
    found = contraction(network, batch["counts"], batch["exposure"])
    figure(states, found, path)
    print(json.dumps(asdict(found) | {"product": found.product, "log10_changes": relative_changes(states)}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
